"""Cases that are declared otherwise: each change does to mesh, scene file or image what its name says."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from conftest import benchmark

from warpsar.io.images import read_channel
from warpsar.scene.scene import Scene

SCENE = """
[image]
spacing_m = [0.5, 0.5]

[[views]]
name = "az000"
azimuth_deg = 0.0
incidence_deg = 35.0
looks = 16

[[views]]
name = "az225"
azimuth_deg = 225.0
incidence_deg = 45.0
looks = 16
"""
WIDE, LONG, HIGH = 8.0, 5.0, 3.0


@pytest.fixture(scope="module")
def made() -> Any:
    return benchmark("redeclared")


@pytest.fixture
def mesh(made: Any) -> Any:
    """A house on the ground."""
    found: Any = {}
    made.added((1.0, 2.0, 0.0), (1.0 + WIDE, 2.0 + LONG, HIGH), "brick")(found)
    return {"house": found["more"]}


def body(mesh: Any, name: str = "house") -> trimesh.Trimesh:
    vertices, faces, _ = mesh[name]
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.mark.parametrize(
    ("change", "volume"),
    [
        (("height", "house", 4.5), WIDE * LONG * 4.5),
        (("wider", "house", 1.0, -0.5), (WIDE + 1.0) * (LONG - 0.5) * HIGH),
        (("moved", "house", 0.6, -0.4, 30.0), WIDE * LONG * HIGH),
        (("gable", "house", 2.0), WIDE * LONG * (HIGH + 1.0)),  # a prism: half of the box over the eaves
    ],
)
def test_a_body_keeps_its_walls_closed_and_has_the_volume_of_its_shape(
    made: Any, mesh: Any, change: tuple[Any, ...], volume: float
) -> None:
    getattr(made, change[0])(*change[1:])(mesh)
    solid = body(mesh)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(volume, rel=1e-12)  # positive: its faces look outward


def test_a_body_moves_and_turns_about_its_middle(made: Any, mesh: Any) -> None:
    before = body(mesh).vertices.copy()
    made.moved("house", 0.6, -0.4, 90.0)(mesh)
    after = body(mesh)
    np.testing.assert_allclose(after.vertices.mean(axis=0) - before.mean(axis=0), [0.6, -0.4, 0.0], atol=1e-12)
    np.testing.assert_allclose(after.extents, [LONG, WIDE, HIGH], atol=1e-12)


def test_a_mesh_is_written_as_it_was_read(made: Any, mesh: Any, tmp_path: Path) -> None:
    made.added((-3.0, 0.0, 0.0), (-1.0, 1.0, 1.0), "tower")(mesh)
    made.write_mesh(mesh, tmp_path / "scene.obj")
    again = made.read_mesh(tmp_path / "scene.obj")
    assert {name: group[1] for name, group in again.items()} == {name: group[1] for name, group in mesh.items()}
    for name in mesh:
        np.testing.assert_allclose(again[name][0], mesh[name][0], atol=1e-6)


def test_angles_spacings_and_looks_are_declared_otherwise(made: Any) -> None:
    text = made.incidence(-0.6)(made.azimuth(-1.5, "az000")(SCENE))
    found = tomllib.loads(made.looks(9.0)(made.spacing(0.5, 0.491)(text)))
    assert [view["azimuth_deg"] for view in found["views"]] == [358.5, 225.0]
    assert [view["incidence_deg"] for view in found["views"]] == pytest.approx([34.4, 44.4])
    assert [view["looks"] for view in found["views"]] == [9.0, 9.0]
    assert found["image"]["spacing_m"] == [0.5, 0.491]


def test_images_get_a_gain_or_a_shift(made: Any) -> None:
    image = np.arange(6, dtype=np.float32).reshape(3, 2)
    np.testing.assert_array_equal(made.gains(az000=1.5)("az000", image), 1.5 * image)
    np.testing.assert_array_equal(made.gains(az000=1.5)("az225", image), image)
    np.testing.assert_array_equal(made.rolled("az225", 1)("az225", image), image[[2, 0, 1]])


@pytest.mark.parametrize(
    ("trial", "said", "unexplained", "words"),
    [
        ("nothing", [], False, "right"),
        ("nothing", ["looks"], False, "false name"),
        ("tower too low", ["object_size"], False, "right"),
        ("tower too low", ["object_size"], True, "named, unexplained"),
        ("tower too low", [], True, "unexplained"),
        ("tower too low", [], False, "missed"),
        ("tower too low", ["object_pose"], True, "false name"),
        ("gabled roof", [], True, "right"),
        ("gabled roof", [], False, "false all-clear"),
        ("gabled roof", ["saturation"], False, "false name"),
        ("gabled roof", ["saturation"], True, "false name"),
    ],
)
def test_the_outcome_of_a_verdict(made: Any, trial: str, said: list[str], unexplained: bool, words: str) -> None:
    assert made.outcome({"name": trial, "verdict": said, "unexplained": unexplained}) == words


@pytest.mark.parametrize("trial", benchmark("redeclared").TRIALS)
def test_a_trial_is_a_scene_with_images_of_its_views(
    made: Any, trial: str, independent_cases: Path, tmp_path: Path
) -> None:
    path = made.make(made.TRIALS[trial], independent_cases, tmp_path)
    scene = Scene.load(path)
    for view in scene.views:
        (image,) = view.images.values()
        assert read_channel(tmp_path / image).shape == tuple(scene.grid.shape)
