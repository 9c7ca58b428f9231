"""`evaluate`, `learn` and `diagnose` on curves: a plate whose curves the engine has made, with noise."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import ROOT

import warpsar
from warpsar.cli.main import main
from warpsar.curves.search import TermSearch
from warpsar.diagnosis import curves
from warpsar.diagnosis.curve_folds import HeldBack, lost

HEAD = """
[scene]
mesh = "plate.obj"

[radar]
frequency_hz = 5e9
polarizations = ["HH", "VV"]
terms = ["single"]

[image]
shape = [4, 4]
spacing_m = [1.0, 1.0]

[materials.default]
{material}

[[views]]
name = "one"
azimuth_deg = 0.0
incidence_deg = 45.0
"""
PLATE = "v 0 -.15 -.1\nv 0 .15 -.1\nv 0 .15 .1\nv 0 -.15 .1\nf 1 2 3\nf 1 3 4\n"
SLAB = "eps_r = {eps}\nthickness_m = 0.002\nrms_height_m = 0.0"


def scene(folder: Path, material: str) -> warpsar.Scene:
    folder.mkdir(exist_ok=True)
    (folder / "plate.obj").write_text(PLATE)
    (folder / "scene.toml").write_text(HEAD.format(material=material))
    return warpsar.Scene.load(folder / "scene.toml")


def with_curves(folder: Path, material: str, truth: str, terms: tuple[str, ...], gain: float = 1.0) -> Path:
    """A scene file whose curves show `truth` times `gain`, by the engine, and complex noise 50 dB under the peak."""
    declared = scene(folder, material)
    shown = scene(folder.parent / "truth", truth)
    rng = np.random.default_rng(4)
    phi = np.arange(0.0, 80.0)
    text = (folder / "scene.toml").read_text()
    for frequency, role in ((5e9, "train"), (7e9, "test")):
        for p, pol in enumerate(declared.radar.polarizations):
            field = gain * np.sqrt(4 * np.pi) * _amplitude(shown, phi, frequency, terms)[:, p]
            noise = 3e-3 * np.abs(field).max() / np.sqrt(2) * (rng.normal(size=80) + 1j * rng.normal(size=80))
            rows = zip(phi, 10 * np.log10(np.abs(field + noise) ** 2), strict=True)
            name = f"{frequency:g}{pol}.csv"
            lines = [f"{frequency},90,{a},{v}" for a, v in rows]
            (folder / name).write_text("\n".join(["frequency_hz,theta_deg,phi_deg,rcs_dbsm", *lines]))
            text += f'\n[[curves]]\nfile = "{name}"\npolarization = "{pol}"\nrole = "{role}"\n'
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


def _amplitude(shown: warpsar.Scene, phi: np.ndarray, frequency: float, terms: tuple[str, ...]) -> np.ndarray:
    radar = shown.radar.model_copy(update={"terms": terms})
    return warpsar.rcs(replace(shown, radar=radar), 90.0 - phi, 90.0, [frequency]).amplitude_m[:, 0, 0]


def run(command: str, path: Path, out: Path) -> dict:
    done = CliRunner().invoke(main, [command, str(path), "-o", str(out), "--device", "cpu"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    name = {"evaluate": "evaluate", "learn": "learn", "diagnose": "diagnosis"}[command]
    return json.loads((out / f"{name}.json").read_text())


@pytest.mark.full
def test_diagnose_names_edges_and_its_scene_evaluates_better(tmp_path: Path) -> None:
    path = with_curves(tmp_path / "scene", "conductor = true", "conductor = true", ("single", "edges"))
    found = run("diagnose", path, tmp_path / "out")
    assert found["verdict"] == ["edge_diffraction"]
    assert warpsar.Scene.load(tmp_path / "out" / "scene.toml").radar.terms == ("single", "edges")
    before = run("evaluate", path, tmp_path / "before")
    after = run("evaluate", tmp_path / "out" / "scene.toml", tmp_path / "after")
    for old, new in zip(before["curves"], after["curves"], strict=True):
        assert new["error_db"]["model"] < 0.5 * old["error_db"]["model"]


@pytest.mark.full
def test_every_frequency_is_held_back_in_turn(tmp_path: Path) -> None:
    """5 GHz foretells 7 GHz, and 7 GHz 5 GHz: each finds the edges by itself. What one of them lacks is said."""
    path = with_curves(tmp_path / "scene", "conductor = true", "conductor = true", ("single", "edges"))
    path.write_text(path.read_text().replace('role = "test"', 'role = "train"'))
    words = ["diagnose", str(path), "-o", str(tmp_path / "out"), "--device", "cpu", "--folds"]
    done = CliRunner().invoke(main, [*words, "2"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["verdict"] == ["edge_diffraction"]
    assert [one["frequencies_hz"] for one in found["held_back"]] == [[5e9], [7e9]]
    for one in found["held_back"]:
        assert one["verdict"] == ["edge_diffraction"]
        assert one["error_db_after"] < 0.5 * one["error_db_before"]
    assert found["not_in_every_part"] == []
    assert "7 GHz held back: edge_diffraction" in (tmp_path / "out" / "report.html").read_text()

    few = CliRunner().invoke(main, [*words, "3"])
    assert few.exit_code == 2
    assert "--folds 3: found train curves of 2 frequencies; must be 3 or more" in few.output


@pytest.mark.unit
def test_a_name_that_one_part_lacks_is_said() -> None:
    def part(*names: str) -> HeldBack:
        return HeldBack(
            [5e9],
            curves.DiagnosedCurves(
                warpsar.Scene.__new__(warpsar.Scene), [], {"all": TermSearch((), names, (), ())}, [], []
            ),
        )

    both = "edge_diffraction", "multibounce"
    assert lost(both, [part(*both), part("edge_diffraction")]) == ["multibounce"]
    assert lost(both, [part(*both)]) == []


@pytest.mark.full
def test_diagnose_names_nothing_where_nothing_is_missing(tmp_path: Path) -> None:
    path = with_curves(tmp_path / "scene", "conductor = true", "conductor = true", ("single",))
    assert run("diagnose", path, tmp_path / "out")["verdict"] == []


@pytest.mark.full
def test_diagnose_gives_no_all_clear_where_noise_holds_the_power(tmp_path: Path) -> None:
    """A range that is 12 dB too high: no term and no material raises the level, and a fitted noise takes the rest."""
    path = with_curves(tmp_path / "scene", "conductor = true", "conductor = true", ("single",), gain=4.0)
    done = CliRunner().invoke(main, ["diagnose", str(path), "-o", str(tmp_path / "out")], catch_exceptions=False)
    assert done.exit_code == 4
    assert done.stdout.startswith("unexplained: train curves: ")
    found = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert found["unexplained"]
    assert "noise" in found["curves_verdict"]["train"]["findings"]


def slab_rcs(phi: np.ndarray, frequency: float, eps: float, thickness: float, pol: str) -> np.ndarray:
    """A thin slab of the size of `PLATE`: what its polarization currents send [m2], to first order in its thickness."""
    k, width, area = 2 * np.pi * frequency / 299792458.0, 0.3, 0.06
    angle = np.deg2rad(phi)
    pattern = np.sinc(k * width * np.sin(angle) / np.pi)
    field = np.ones_like(angle) if pol == "VV" else np.cos(angle) ** 2 + np.sin(angle) ** 2 / eps
    return 4 * np.pi * (k**2 * (eps - 1) * thickness * area / (4 * np.pi) * pattern * field) ** 2


@pytest.mark.full
@pytest.mark.parametrize(("eps", "thickness"), [(2.2, 4e-4), (3.0, 3e-4)])
def test_a_thin_sheet_of_plastic_that_was_declared_as_metal_is_named(
    tmp_path: Path, eps: float, thickness: float
) -> None:
    """By the closed form of weak scattering, which holds for k (eps_r - 1) d of 0.05 to 0.09; noise 30 dB under it.

    The field within the sheet is weaker by that share, so the product may be off by a few percent.
    """
    scene(tmp_path / "scene", "conductor = true")
    rng = np.random.default_rng(1)
    phi = np.arange(0.0, 70.0)
    text = (tmp_path / "scene" / "scene.toml").read_text()
    for frequency, role in ((5e9, "train"), (7e9, "test")):
        for pol in ("HH", "VV"):
            field = np.sqrt(slab_rcs(phi, frequency, eps, thickness, pol))
            noise = 0.03 * field.max() / np.sqrt(2) * (rng.normal(size=70) + 1j * rng.normal(size=70))
            rows = zip(phi, 10 * np.log10(np.abs(field + noise) ** 2), strict=True)
            name = f"{frequency:g}{pol}.csv"
            lines = [f"{frequency},90,{a},{v}" for a, v in rows]
            (tmp_path / "scene" / name).write_text("\n".join(["frequency_hz,theta_deg,phi_deg,rcs_dbsm", *lines]))
            text += f'\n[[curves]]\nfile = "{name}"\npolarization = "{pol}"\nrole = "{role}"\n'
    (tmp_path / "scene" / "scene.toml").write_text(text)
    found = run("diagnose", tmp_path / "scene" / "scene.toml", tmp_path / "out")
    assert found["verdict"][0] == "materials.default: dielectric"
    asked, *layers = found["materials"]
    outcomes = [("dielectric layer", "refused"), ("magnetic layer", "refused")]  # the curve left out is against both
    assert sorted((one["kind"], one["outcome"]) for one in layers) == outcomes
    product = (eps - 1) * thickness
    assert asked["eps_r"] is None
    assert asked["product_m"]["low"] < product < asked["product_m"]["high"]
    assert asked["product_m"]["value"] == pytest.approx(product, rel=0.1)
    written = warpsar.Scene.load(tmp_path / "out" / "scene.toml").materials["default"]
    assert written.thickness_m is not None
    assert written.eps_r is not None
    assert (np.real(written.eps_r[0]) - 1) * written.thickness_m == pytest.approx(asked["product_m"]["value"])


@pytest.mark.full
def test_learn_finds_the_permittivity_of_a_slab(tmp_path: Path) -> None:
    path = with_curves(tmp_path / "scene", SLAB.format(eps=2.6), SLAB.format(eps=3.0), ("single",))
    found = run("learn", path, tmp_path / "out")["materials"]["default.eps_r"]
    assert found["interval_95"][0] < 3.0 < found["interval_95"][1]
    assert found["value"] == pytest.approx(3.0, abs=0.05)
    learned = warpsar.Scene.load(tmp_path / "out" / "scene.toml")
    assert learned.materials["default"].eps_r == pytest.approx(found["value"])


def test_nothing_to_learn_is_said(tmp_path: Path) -> None:
    path = with_curves(tmp_path / "scene", "conductor = true", "conductor = true", ("single",))
    done = CliRunner().invoke(main, ["learn", str(path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "nothing to learn from curves" in done.stderr


@pytest.mark.measured
@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "verdict"),
    [
        ("plate", ["edge_diffraction"]),
        ("box", ["edge_diffraction"]),
        ("cobra", ["edge_diffraction"]),
        ("cylinder", ["edge_diffraction", "multibounce"]),
    ],
)
def test_measured_boxes_tell_what_each_has(
    measured_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, verdict: list[str]
) -> None:
    """The scene files of examples/measured/boxes, asked for terms alone: other materials take most of the time."""
    suite, folder = measured_data / "austin_rcs", tmp_path / "boxes"
    if not suite.is_dir():
        pytest.skip(f"no folder austin_rcs in {measured_data}")
    shutil.copytree(ROOT / "examples" / "measured" / "boxes", folder)
    for path in (suite / "measured").glob("meas_rcs.II*"):
        (folder / path.name).symlink_to(path)
    for path in suite.glob("*_duct_s6_stl.zip"):
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
    monkeypatch.setattr(curves, "ask", lambda *_: [])
    assert curves.diagnose_curves(warpsar.Scene.load(folder / f"{body}.toml"), tmp_path).verdict == verdict
