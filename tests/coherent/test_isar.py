"""Range profiles and ISAR images against point scatterers, and the command `rcs` without an image or a scene file."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import warpsar
from warpsar.cli.main import main
from warpsar.coherent.command import closed
from warpsar.coherent.directions import Directions
from warpsar.coherent.isar import body_image, range_profiles
from warpsar.coherent.rcs import Rcs
from warpsar.world.frame import SPEED_OF_LIGHT

ROOT = Path(__file__).parents[2]
POINTS = np.array([[0.2, 0.1, 0.0], [-0.15, -0.25, 0.0]])
RCS_M2 = np.array([2.0, 0.5])
TABLES = {
    "image": "[image]\nshape = [4, 4]\nspacing_m = [1.0, 1.0]\n",
    "views": '[[views]]\nname = "one"\nazimuth_deg = 0.0\nincidence_deg = 45.0\n',
}


def scene_with(folder: Path, *tables: str) -> Path:
    """A scene file of the plate with some of TABLES."""
    (folder / "plate.obj").write_text((ROOT / "data" / "coherent" / "plate.obj").read_text())
    head = '[scene]\nmesh = "plate.obj"\n[radar]\nfrequency_hz = 1e10\npolarizations = ["HH"]\n'
    text = head + "[materials.body]\nconductor = true\n" + "".join(TABLES[one] for one in tables)
    (folder / "scene.toml").write_text(text)
    return folder / "scene.toml"


def sweep_of_points(azimuth: np.ndarray, frequency: np.ndarray) -> Rcs:
    """What two isotropic points send: their closed form, whatever the engine computes."""
    s = Directions.of(azimuth, np.full(azimuth.size, 90.0)).s
    k = 2.0 * np.pi * frequency / SPEED_OF_LIGHT
    phase = np.exp(2j * k[None, :, None] * (s @ POINTS.T)[:, None, :])
    amplitude = (phase * np.sqrt(RCS_M2 / (4.0 * np.pi))).sum(axis=2)[:, None, :, None]
    nothing = np.zeros(amplitude.shape)
    share = np.zeros((azimuth.size, 1))
    return Rcs(
        azimuth, np.array([90.0]), frequency, ("HH",), amplitude, {}, {}, nothing[..., 0], 0.001, nothing, nothing,
        share, share, 0, (),
    )  # fmt: skip


@pytest.mark.parametrize("azimuth", [np.arange(-20.0, 20.0, 0.5), np.arange(0.0, 360.0, 1.0)])
def test_points_stand_where_they_are_with_their_rcs(azimuth: np.ndarray) -> None:
    found = sweep_of_points(azimuth, np.arange(8e9, 12e9, 50e6))
    image = body_image(found, range_profiles(found), 0.3)
    power = 4.0 * np.pi * np.abs(image.amplitude_m[:, :, 0]) ** 2
    pixel = image.east_m[1] - image.east_m[0]
    for place, area in zip(POINTS, RCS_M2, strict=True):
        near = (np.abs(image.north_m - place[1]) < 0.05)[:, None] & (np.abs(image.east_m - place[0]) < 0.05)[None, :]
        row, column = np.unravel_index(np.where(near, power, 0.0).argmax(), power.shape)
        assert abs(image.north_m[row] - place[1]) <= pixel
        assert abs(image.east_m[column] - place[0]) <= pixel
        # a pixel of up to half a cell loses up to 1.0 dB beside the peak; the other point's sidelobes are -35 dB
        assert -1.3 < 10.0 * np.log10(power[row, column] / area) < 0.4


def test_profiles_have_the_range_toward_the_radar() -> None:
    found = sweep_of_points(np.array([0.0, 0.5]), np.arange(8e9, 12e9, 50e6))
    profiles = range_profiles(found)
    power = 4.0 * np.pi * np.abs(profiles.amplitude_m[0, :, 0]) ** 2
    bin_m = profiles.range_m[1] - profiles.range_m[0]
    for place, area in zip(POINTS, RCS_M2, strict=True):  # at azimuth 0 the radar stands in the north
        near = np.where(np.abs(profiles.range_m - place[1]) < 0.05, power, 0.0)
        assert abs(profiles.range_m[near.argmax()] - place[1]) <= bin_m
        assert abs(10.0 * np.log10(near.max() / area)) < 0.2  # a bin is an eighth of a cell; the other's sidelobe


def test_a_mesh_file_needs_no_scene_file(tmp_path: Path) -> None:
    mesh = ROOT / "data" / "coherent" / "plate.obj"  # 5 x 7 wavelengths, upright, to the east
    words = ["rcs", str(mesh), "--material", "metal", "--azimuths", "90,80", "--device", "cpu", "-o", str(tmp_path)]
    done = CliRunner().invoke(main, [*words, "--frequencies", "9993081933.333334"])
    assert done.exit_code == 0, done.output
    rows = list(csv.DictReader((tmp_path / "rcs.csv").read_text().splitlines()))
    assert [row["polarization"] for row in rows] == ["HH", "VV"] * 2
    expected = 10.0 * np.log10(4.0 * np.pi * (35 * 0.03**2) ** 2 / 0.03**2)
    assert float(rows[0]["rcs_dbsm"]) == pytest.approx(expected, abs=0.01)  # an edge's current is 0 in the mirror
    assert {"rcs.png", "rcs_polar.png"} <= set(json.loads((tmp_path / "rcs.json").read_text())["files"])
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Highest: " in page
    assert page.count("data:image/png") >= 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--frequencies", "1e10"], "--material: missing"),
        (["--material", "metal"], "--frequencies: missing"),
        (["--material", "wood pulp", "--frequencies", "1e10"], "library: found 'wood pulp'"),
        (["--material", "metal", "--frequencies", "1e10", "--isar"], "--azimuths: found 2 azimuths"),
    ],
)
def test_what_a_mesh_file_lacks_is_said(words: list[str], said: str, tmp_path: Path) -> None:
    mesh = str(ROOT / "data" / "coherent" / "plate.obj")
    out = tmp_path / "out"
    done = CliRunner().invoke(main, ["rcs", mesh, "--azimuths", "90,80", "--device", "cpu", "-o", str(out), *words])
    assert done.exit_code == 2
    assert said in done.output
    assert not out.exists()


def test_steps_that_repeat_the_image_are_refused(tmp_path: Path) -> None:
    mesh = str(ROOT / "data" / "coherent" / "plate.obj")
    words = ["--azimuths", "0:180:20", "--frequencies", "8e9:12e9:4e8", "--material", "metal", "--isar"]
    done = CliRunner().invoke(main, ["rcs", mesh, "--device", "cpu", "-o", str(tmp_path / "out"), *words])
    assert done.exit_code == 2
    assert "--frequencies: found a step of 4e+08 Hz" not in done.output  # 0.37 m hold the plate of 0.26 m
    assert "--azimuths: found a step of 20 degrees" in done.output


def test_a_scene_without_views_is_saved_as_it_is_and_makes_no_image(tmp_path: Path) -> None:
    scene = warpsar.Scene.load(scene_with(tmp_path))
    assert scene.views == []
    scene.save(tmp_path / "again.toml")
    text = (tmp_path / "again.toml").read_text()
    assert "[image]" not in text
    assert "views" not in text
    assert warpsar.Scene.load(tmp_path / "again.toml").materials == scene.materials
    with pytest.raises(warpsar.InputError, match=r"views: found none; an image needs \[image\] and \[\[views\]\]"):
        warpsar.simulate(scene, device="cpu")


@pytest.mark.parametrize(("there", "said"), [("views", "image: missing"), ("image", "views: missing")])
def test_an_image_needs_views_and_views_an_image(there: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(warpsar.InputError, match=said):
        warpsar.Scene.load(scene_with(tmp_path, there))


def test_the_line_of_a_whole_turn_is_closed() -> None:
    """0:360:2 ends at 358 degrees: the first angle follows again. A sector stays open."""
    assert closed(np.arange(0.0, 360.0, 2.0))[[0, -1]].tolist() == [0, 0]
    assert closed(np.arange(0.0, 300.0, 2.0)).tolist() == list(range(150))
    assert closed(np.arange(-180.0, 180.1, 2.0)).tolist() == list(range(181))  # both ends are there
