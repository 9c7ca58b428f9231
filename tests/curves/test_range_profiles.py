"""Complex range profiles as curves: a level that one body tells and another one has, other meshes, and the band."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import warpsar
from warpsar import InputError
from warpsar.compare.curve import compare_curves
from warpsar.curves.observe import amplitudes
from warpsar.diagnosis.curves import diagnose_curves
from warpsar.world.frame import SPEED_OF_LIGHT

PLATE = "v {x} -{y} -.1\nv {x} {y} -.1\nv {x} {y} .1\nv {x} -{y} .1\nf 1 2 3\nf 1 3 4\n"
SCENE = """
[scene]
mesh = "small.obj"
reference_point_m = [0, 0, 0]

[radar]
frequency_hz = 10e9
polarizations = ["HH"]
terms = ["single"]

[materials.default]
conductor = true
"""
CURVE = """
[[curves]]
file = "{name}.bin"
polarization = "HH"
frequency_hz = 10e9
profiles = {{ bins = 3, bin = 1, azimuths_deg = [110.0, 70.0] }}
"""
BINS, COUNT, GAIN = 3, 81, 7.0


@pytest.fixture(scope="module")
def plates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small plate whose profiles are for training, and a large one of the same gain, which is to be foretold."""
    folder = tmp_path_factory.mktemp("plates")
    text = SCENE
    for name, half in (("small", 0.05), ("large", 0.15)):
        (folder / f"{name}.obj").write_text(PLATE.format(x=0, y=half))
        (folder / "bare.toml").write_text(SCENE.replace("small", name))
        bare = warpsar.Scene.load(folder / "bare.toml")
        azimuth = np.linspace(110.0, 70.0, COUNT)
        profiles = np.zeros((COUNT, BINS), "<c8")
        profiles[:, 1] = GAIN * amplitudes(bare, azimuth, 90.0, 10e9, device="cpu").of("HH")["single"]
        profiles.tofile(folder / f"{name}.bin")
        text += CURVE.format(name=name)
    (folder / "scene.toml").write_text(text + 'mesh = "large.obj"\nrole = "test"\n')
    return folder


@pytest.fixture
def path(plates: Path, tmp_path: Path) -> Path:
    """The scene file, in a folder of the test's own."""
    shutil.copytree(plates, tmp_path, dirs_exist_ok=True)
    return tmp_path / "scene.toml"


def test_one_body_tells_the_level_of_another(path: Path, tmp_path: Path) -> None:
    scene = warpsar.Scene.load(path)
    train, test = compare_curves(scene, device="cpu")
    assert train.content()["fitted_level_db"] == pytest.approx(-20.0 * np.log10(GAIN), abs=1e-3)  # complex64
    assert test.seen.fitted_level_db == train.seen.fitted_level_db
    assert test.error_db == pytest.approx(0.0, abs=1e-3)
    scene.save(tmp_path / "again.toml")
    again = warpsar.Scene.load(tmp_path / "again.toml")
    assert again.curves == scene.curves


@pytest.mark.parametrize("bins", [0.3, 1.0])
def test_a_bin_is_the_mean_over_the_band(tmp_path: Path, bins: float) -> None:
    """A plate nearer by some widths of a bin, c / 2B each: sinc. The plate's own k is 5 % off at the band's ends."""
    bandwidth = 1e9
    (tmp_path / "small.obj").write_text(PLATE.format(x=bins * SPEED_OF_LIGHT / (2.0 * bandwidth), y=0.05))
    (tmp_path / "scene.toml").write_text(SCENE)
    scene = warpsar.Scene.load(tmp_path / "scene.toml")
    narrow, wide = (
        abs(amplitudes(scene, np.array([90.0]), 90.0, 10e9, device="cpu", bandwidth_hz=b).of("HH")["single"][0])
        for b in (0.0, bandwidth)
    )
    assert wide / narrow == pytest.approx(abs(np.sinc(bins)), abs=0.05)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bins = 3", "bins = 4", "must be a multiple of 32"),
        ("bin = 1", "bin = 3", "must be less than bins"),
        ("frequency_hz = 10e9\nprofiles", "profiles", "must be stated beside profiles"),
        ('mesh = "large.obj"', 'mesh = "none.obj"', "none.obj"),
    ],
)
def test_what_does_not_fit_is_refused(path: Path, old: str, new: str, message: str) -> None:
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=message):
        warpsar.Scene.load(path)


def test_a_mesh_of_another_material_is_refused(path: Path, tmp_path: Path) -> None:
    (tmp_path / "large.obj").write_text("usemtl wood\n" + PLATE.format(x=0, y=0.15))
    with pytest.raises(InputError, match="'wood'"):
        warpsar.Scene.load(path)


def test_diagnose_takes_one_body(path: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"curves\[1\].mesh"):
        diagnose_curves(warpsar.Scene.load(path), tmp_path / "cache")
