"""Curves of radar cross-section: read, imported, declared, refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import warpsar
from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.io import curves

pytestmark = pytest.mark.unit

SUITE = "5120000000.000000 90.000000 {phi:.6f} {dbsm:.6f} \n"
SCENE = """
[scene]
mesh = "plate.obj"

[radar]
frequency_hz = 5.12e9
polarizations = ["HH", "VV"]

[image]
shape = [4, 4]
spacing_m = [1.0, 1.0]

[materials.default]
conductor = true

[[views]]
name = "one"
azimuth_deg = 0.0
incidence_deg = 45.0
"""
PLATE = "v 0 -.1 -.1\nv 0 .1 -.1\nv 0 .1 .1\nv 0 -.1 .1\nf 1 2 3\nf 1 3 4\n"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "plate.obj").write_text(PLATE)
    (folder / "scene.toml").write_text(SCENE)
    return folder / "scene.toml"


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    path = tmp_path / "meas_rcs.II.B.sx1.f10.H.txt"
    path.write_text("".join(SUITE.format(phi=p, dbsm=-p / 2) for p in range(4)))
    return path


def test_the_suites_text_is_read(suite: Path) -> None:
    rows = curves.read(suite).select(None, None)
    assert rows.polarization == ("HH",) * 4
    np.testing.assert_allclose(rows.azimuth_deg, [90.0, 89.0, 88.0, 87.0])
    np.testing.assert_allclose(rows.incidence_deg, 90.0)
    np.testing.assert_allclose(10 * np.log10(rows.rcs_m2), [0.0, -0.5, -1.0, -1.5], atol=1e-12)


def test_a_csv_with_several_curves_is_chosen_from(tmp_path: Path) -> None:
    path = tmp_path / "rcs.csv"
    path.write_text(
        "azimuth_deg,incidence_deg,frequency_hz,polarization,rcs_dbsm\n"
        "0,90,1e9,HH,0\n0,90,1e9,VV,10\n0,90,2e9,HH,20\n0,90,2e9,VV,30\n"
    )
    table = curves.read(path)
    assert table.frequencies_hz() == [1e9, 2e9]
    assert table.select(2e9, "VV").rcs_m2 == pytest.approx([1000.0])
    for arguments, words in (((None, "VV"), "frequency_hz"), ((2e9, None), "polarization"), ((3e9, "VV"), "no row")):
        with pytest.raises(InputError, match=words):
            table.select(*arguments)


def test_what_is_written_is_what_is_read(suite: Path, tmp_path: Path) -> None:
    first = curves.read(suite)
    curves.write_csv(tmp_path / "again.csv", first)
    second = curves.read(tmp_path / "again.csv")
    for name in ("frequency_hz", "azimuth_deg", "incidence_deg", "rcs_m2"):
        np.testing.assert_allclose(getattr(second, name), getattr(first, name), rtol=1e-10)


def test_import_declares_curves_once_and_the_scene_loads(scene: Path, suite: Path) -> None:
    words = ["import", str(suite), "--scene", str(scene), "--role"]
    for role in ("train", "test"):
        done = CliRunner().invoke(main, [*words, role])
        assert done.exit_code == 0, done.output
    (curve,) = warpsar.Scene.load(scene).curves
    assert (curve.role, curve.polarization, curve.frequency_hz) == ("test", "HH", 5.12e9)
    assert curve.file.parent == scene.parent.resolve()


def test_a_saved_scene_keeps_its_curves_and_its_hash_knows_them(scene: Path, suite: Path, tmp_path: Path) -> None:
    bare = warpsar.Scene.load(scene).input_hash
    CliRunner().invoke(main, ["import", str(suite), "--scene", str(scene)])
    loaded = warpsar.Scene.load(scene)
    loaded.save(tmp_path / "other" / "scene.toml")
    again = warpsar.Scene.load(tmp_path / "other" / "scene.toml")
    assert again.curves == loaded.curves
    assert loaded.input_hash != bare


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no row|columns"),
        ("frequency_hz,theta_deg,phi_deg\n1e9,90,0\n", "rcs_dbsm must be there"),
        ("frequency_hz,theta_deg,phi_deg,rcs_dbsm\n1e9,90,x,0\n", "line 2"),
        ("1e9 90 0\n", "four numbers"),
        ("1e9 90 0 nan\n", "no number among"),
        ("1e9 200 0 0\n", "theta_deg = 200"),
        ("1e3 90 0 0\n", "frequency_hz = 1000"),
        ("1e9 90 0 400\n", "200 dBsm"),
    ],
)
def test_what_is_no_curve_is_refused_at_the_door(scene: Path, text: str, words: str) -> None:
    (scene.parent / "bad.txt").write_text(text)
    scene.write_text(SCENE + '\n[[curves]]\nfile = "bad.txt"\npolarization = "HH"\n')
    with pytest.raises(InputError, match=words) as refused:
        warpsar.Scene.load(scene)
    assert "curves[0]" in str(refused.value)
    assert "bad.txt" in str(refused.value)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ('polarization = "HV"', "radar.polarizations"),
        ('polarization = "HH"\nmask = [[0.0, 10.0]]', "leaves no row"),
        ('polarization = "HH"\nmask = [[10.0, 0.0]]', "from <= to"),
        ('polarization = "HH"\nfrequency_hz = 7e9', "no row at 7000000000 Hz"),
        ('polarization = "HH"\ncolour = "green"', "unknown key"),
    ],
)
def test_a_table_that_does_not_fit_its_file_is_refused(scene: Path, suite: Path, keys: str, words: str) -> None:
    (scene.parent / "curve.txt").write_text(suite.read_text())
    scene.write_text(SCENE + f'\n[[curves]]\nfile = "curve.txt"\n{keys}\n')
    with pytest.raises(InputError, match=words):
        warpsar.Scene.load(scene)
