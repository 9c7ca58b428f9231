"""`warpsar view` without a browser: what is drawn, what lies over what, and a page that needs nothing else."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

import warpsar
from warpsar.cli.main import main
from warpsar.runtime import devices
from warpsar.simulation.rays import trace_view
from warpsar.surface.stage import Stage
from warpsar.viewer.drapes import layover
from warpsar.viewer.page import _levels, by_meaning, strong
from warpsar.viewer.points import with_points
from warpsar.viewer.surface import drawn, owners

ROOT = Path(__file__).resolve().parents[2]
BOX = """
[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]
[image]
shape = [40, 48]
spacing_m = [0.5, 0.5]
[sampling]
rays_per_pixel = 64.0
[scene]
reference_point_m = [0.0, 0.0, 0.0]
[materials.ground]
eps_r = 5.0
rms_height_m = 0.001
correlation_length_m = 0.006
[[objects]]
name = "ground"
primitive = "plate"
size_m = [24.0, 24.0, 0.0]
material = "ground"
[[objects]]
name = "sheet"
primitive = "plate"
size_m = [6.0, 8.0, 0.0]
position_m = [0.0, 0.0, 5.0]
material = "ground"
[[views]]
name = "north"
azimuth_deg = 0.0
incidence_deg = 45.0
"""


@pytest.fixture
def sheet(tmp_path: Path) -> warpsar.Scene:
    (tmp_path / "scene.toml").write_text(BOX)
    return warpsar.Scene.load(tmp_path / "scene.toml")


def content_of(page: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert found
    return json.loads(found[1])


def test_points_have_no_parameters(sheet: warpsar.Scene) -> None:
    """A scatterer is none of the surface: its corners have a level, and no value of a material."""
    surface = drawn(sheet)
    found = with_points(surface, sheet, np.array([[0.0, 0.0, 5.0]]), {"HH": np.array([10.0])})
    corners = len(surface.corners)
    assert found.parameters.keys() == surface.parameters.keys() != set()
    for key, values in found.parameters.items():
        np.testing.assert_array_equal(values[:corners], surface.parameters[key])
        assert np.isnan(values[corners:]).all()
        assert len(values) == len(found.corners)
    assert found.levels_db["scatterers HH [dBsm]"][corners:].tolist() == [10.0] * 6


def test_a_sheet_over_the_ground_lies_over_it_in_all_its_pixels(sheet: warpsar.Scene) -> None:
    """Its image is length times sin(incidence) long. The ground behind it in elevation is lit: the sheet's shadow
    falls on the far side. At its border a pixel holds less than a twentieth of it: two pixels in each direction."""
    stage = Stage.of(sheet, devices.resolve_device("cpu"))
    found = layover(trace_view(sheet, stage, sheet.views[0], seed=1, effects=[]))
    rows, cols = np.flatnonzero(found.any(axis=1)), np.flatnonzero(found.any(axis=0))
    assert len(cols) == pytest.approx(8.0 / 0.5, abs=2)
    assert len(rows) == pytest.approx(6.0 * np.sin(np.pi / 4) / 0.5, abs=2)
    assert found[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1].all()


def test_flat_ground_alone_has_no_layover(sheet: warpsar.Scene) -> None:
    bare = replace(sheet, objects=sheet.objects[:1], mesh=sheet.assembly.mesh(sheet.objects[:1]))
    stage = Stage.of(bare, devices.resolve_device("cpu"))
    assert not layover(trace_view(bare, stage, bare.views[0], seed=1, effects=[])).any()


def test_faces_know_their_object(sheet: warpsar.Scene) -> None:
    found = owners(sheet)
    heights = sheet.mesh.vertices[sheet.mesh.faces].mean(axis=1)[:, 2]
    assert np.array_equal(found, np.where(heights > 1.0, 2, 1))
    shown = drawn(sheet)
    assert shown.owners == ("the scene's mesh", "ground", "sheet")
    assert np.array_equal(shown.owner, np.where(shown.corners[:, 2] > 1.0, 2, 1))


def test_a_texture_is_drawn_to_a_texel() -> None:
    """Corners that are cut into faces carry the texture's own value at their place."""
    scene = warpsar.Scene.load(ROOT / "data/fields/scene.toml")
    shown = drawn(scene)
    assert len(shown.triangles) > 10 * len(scene.mesh.faces)

    def area(corners: np.ndarray, triangles: np.ndarray) -> float:
        a, b, c = (corners[triangles[:, k]] for k in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()

    whole = area(scene.mesh.vertices, scene.mesh.faces)
    assert area(shown.corners.astype(float), shown.triangles) == pytest.approx(whole, rel=1e-5)  # float32 corners
    stated = [scene.field(name, "rms_height_m") for name in shown.materials]
    low, high = min(one.min() for one in stated), max(one.max() for one in stated)
    values = shown.parameters["rms_height_m"]
    assert low * 0.999 <= values.min() < 1.1 * low  # float32 logarithms; a corner may miss the one lowest texel
    assert 0.9 * high < values.max() <= high * 1.001


def test_levels_are_grey_and_what_is_not_there_is_transparent() -> None:
    uri = _levels(np.array([[-10.0, 0.0], [np.nan, 20.0]]), -10.0, 10.0)
    image = np.asarray(Image.open(BytesIO(base64.b64decode(uri.split(",")[1]))))
    assert image.shape == (2, 2, 2)
    assert image[..., 1].tolist() == [[255, 255], [0, 255]]
    assert image[0, :, 0].tolist() == [0, 128]
    assert image[1, 1, 0] == 255


def test_the_page_holds_everything(tmp_path: Path, sheet: warpsar.Scene) -> None:
    done = CliRunner().invoke(main, ["view", str(sheet.path), "-o", str(tmp_path / "out"), "--device", "cpu"])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "out/view.html").read_text()
    assert not re.search(r"""(?:src|href|url)\s*[=(]\s*["']?(?:https?:)?//""", text)
    content = content_of(text)
    (state,) = content["states"]
    assert [view["name"] for view in state["views"]] == ["north"]
    assert set(state["views"][0]["images"]) == {"modelled HH"}
    corners = np.frombuffer(base64.b64decode(state["corners"]), "<f4").reshape(-1, 3)
    assert corners.max(axis=0) == pytest.approx([12.0, 12.0, 5.0])


def test_a_smooth_body_is_shown_without_images(tmp_path: Path) -> None:
    """It has a phase: no image of power, no parameter. Its views light it all the same."""
    words = ["view", str(ROOT / "data/coherent/trihedral.toml"), "-o", str(tmp_path / "out"), "--device", "cpu"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    (state,) = content_of((tmp_path / "out/view.html").read_text())["states"]
    assert state["parameters"] == []
    assert state["views"]
    assert all(one["images"] == {} for one in state["views"])


def test_a_page_of_contributors_has_a_level_for_each_term(tmp_path: Path) -> None:
    """The trihedral from its axis: three bounces send most, faces seen aslant least; all terms have one scale."""
    words = [
        "rcs",
        str(ROOT / "data/coherent/trihedral.toml"),
        "-o",
        str(tmp_path),
        "--azimuths",
        "45",
        "--device",
        "cpu",
    ]
    words += ["--incidences", "54.7356", "--frequencies", "5e9", "--contributors", "45"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    (state,) = content_of((tmp_path / "contributors.html").read_text())["states"]
    levels = {one["label"]: np.frombuffer(base64.b64decode(one["values"]), "<f4") for one in state["parameters"]}
    highest = {label.split(",")[0]: float(values.max()) for label, values in levels.items() if "HH" in label}
    assert set(highest) == {"all terms", "single", "multibounce", "edges"}
    assert highest["multibounce"] > highest["edges"] > highest["single"]
    whole = np.concatenate([*levels.values()])
    for one in state["parameters"]:
        assert one["ends"] == pytest.approx([whole.min(), whole.max()], abs=1e-5)  # float32 of tens of dB


def test_before_and_after_share_one_scale(tmp_path: Path, sheet: warpsar.Scene) -> None:
    brighter = tmp_path / "brighter.toml"
    brighter.write_text(BOX.replace("eps_r = 5.0", "eps_r = 12.0"))
    words = ["view", str(brighter), "--before", str(sheet.path), "-o", str(tmp_path / "out"), "--device", "cpu"]
    assert CliRunner().invoke(main, words).exit_code == 0
    states = content_of((tmp_path / "out/view.html").read_text())["states"]
    assert [one["name"] for one in states] == ["before", "after"]
    first, second = (one["views"][0]["images"]["modelled HH"] for one in states)
    assert first["scale"] == second["scale"]
    assert first["png"] != second["png"]


def test_a_folder_without_a_scene_is_refused(tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["view", str(tmp_path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "scene.toml" in done.output
    assert not (tmp_path / "out").exists()


def test_materials_have_the_colours_of_what_they_are() -> None:
    lawn, meadow, road, thing = (row[:3].astype(int) for row in by_meaning(["lawn", "meadow", "Asphalt.001", "thing"]))
    assert lawn[1] > lawn[0] > lawn[2]  # green
    assert np.ptp(road) < 15  # grey
    assert (meadow > lawn).all()  # the second grass is paler
    assert np.ptp(thing) > 60  # strong
    assert by_meaning([]).shape == (0, 4)
    assert strong(21)[20].tolist() == strong(1)[0].tolist()
