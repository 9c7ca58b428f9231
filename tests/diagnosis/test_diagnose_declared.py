"""What is declared wrongly and `warpsar diagnose` names: a body's size, a view's angles, a pixel spacing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from learning_scenes import START, measured, starting
from test_diagnose import saved
from test_diagnose_geometry import HUT, QUICK, case, true_scene

from warpsar.diagnosis.command import run
from warpsar.diagnosis.geometry import object_pose, object_size
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.geometry.object_size import SAME_IMAGES
from warpsar.diagnosis.geometry.registry import changes, coordinates, of, without_change
from warpsar.diagnosis.models.names import object_of
from warpsar.diagnosis.turn.sensor_search import hypotheses
from warpsar.parameters.at import at
from warpsar.scene.scene import Scene
from warpsar.world.tables import Sampling

HIGHER = {"scale": (1.0, 1.0, 1.3)}
TURNED_DEG = 1.5
STRETCHED = 1.03


def found(scene: Scene, out: Path) -> dict[str, Any]:
    assert scene.path is not None
    return run(scene.path, out, device="cpu", options=QUICK)


def declared_otherwise(folder: Path, values: dict[str, float]) -> Scene:
    """Images of the true scene, in a scene file that declares other values of some parameters."""
    seen = measured(true_scene(), folder, seed=1)
    declared = replace(true_scene(), views=seen.views, sampling=Sampling(rays_per_pixel=64.0)).with_values(values)
    return saved(starting(declared, {**START, "hut": {**HUT, "eps_r": 6.0}}), folder)


@pytest.mark.full
def test_a_body_of_another_size_is_named_and_measured(tmp_path: Path) -> None:
    """The hut is 30 % higher than its mesh, which no pose imitates: raised, it leaves a gap."""
    content = found(case(tmp_path / "scene", true_scene(**HIGHER)), tmp_path / "out")
    assert content["verdict"] == ["object_size"]
    assert not content["unexplained"]
    (step,) = content["steps"]
    assert (step["effect"], step["object"]) == ("object_size", "hut")
    assert step["left_out"]["passed"]
    one = content["objects"]["hut"]
    error = np.abs(np.subtract(one["scale"], HIGHER["scale"]))
    assert (error < 4.0 * np.array(one["scale_sd"])).all()
    assert (error < 0.03).all()  # of a hut of 3 m: 9 cm, a fifth of a pixel
    written = Scene.load(tmp_path / "out" / "scene.toml")
    assert [each.scales for each in written.objects] == [tuple(one["scale"])]


@pytest.mark.slow
def test_a_views_own_angle_is_named_and_measured(tmp_path: Path) -> None:
    """No test view sees it, so none need get better."""
    truth = true_scene().views[1].azimuth_deg
    scene = declared_otherwise(tmp_path / "scene", {"views.v1.azimuth_deg": truth + TURNED_DEG})
    content = found(scene, tmp_path / "out")
    assert content["verdict"] == ["view_angles"]
    assert not content["unexplained"]
    one = content["sensor"]["v1"]["azimuth_deg"]
    assert one["declared"] == truth + TURNED_DEG
    assert abs(one["found"] - truth) < min(4.0 * one["sd"], 0.2)


@pytest.mark.slow
def test_a_pixel_spacing_is_named_and_measured(tmp_path: Path) -> None:
    scene = declared_otherwise(tmp_path / "scene", {"image.range_spacing_m": 0.5 * STRETCHED})
    content = found(scene, tmp_path / "out")
    assert content["verdict"] == ["pixel_spacing"]
    assert not content["unexplained"]
    one = content["sensor"]["range"]["range_spacing_m"]
    assert abs(one["found"] - 0.5) < min(4.0 * one["sd"], 0.002)
    assert any("the same as a scene whose size in range is another" in each["note"] for each in content["steps"])


# ---- names and readings ----


@pytest.mark.unit
def test_changes_are_named_by_what_differs() -> None:
    scene = true_scene()
    hut = true_scene(**HIGHER)
    assert changes(scene, hut) == ["object_size hut"]
    assert changes(scene, true_scene(position_m=(0.5, 0.0, 0.0))) == ["object_pose hut"]
    assert changes(scene, true_scene(position_m=(0.5, 0.0, 0.0), **HIGHER)) == ["object_size hut"]
    turned = scene.with_values({"views.v1.azimuth_deg": 3.0, "image.azimuth_spacing_m": 0.52})
    names = ["view_angles v1", "pixel_spacing azimuth"]
    assert changes(scene, turned) == names
    assert coordinates(scene, turned) == ["views.v1.azimuth_deg", "image.azimuth_spacing_m"]
    for name in names:
        back = without_change(scene, turned, name)
        assert changes(scene, back) == [one for one in names if one != name]
    common = at(scene, {scene.parameters["views.azimuth_deg"]: 2.0})
    assert changes(scene, common) == ["view_angles all"]
    assert changes(scene, without_change(scene, common, "view_angles all")) == []
    only = [of(name).only_view(object_of(name)) for name in (*names, "view_angles all", "object_pose hut")]
    assert only == ["v1", None, None, None]


@pytest.mark.unit
def test_a_mesh_of_another_size_has_a_height_in_metres() -> None:
    """The hut of the mesh is 2.5 m high."""
    values = object_size.CHANGE.values(true_scene(), true_scene(**HIGHER), "hut", {"scale": [1.0, 1.0, 1.3]}, None)
    assert values["height_m"] == pytest.approx(3.25)
    assert values["declared_height_m"] == pytest.approx(2.5)
    assert "height_m" not in object_size.CHANGE.values(true_scene(), true_scene(**HIGHER), "hut", {}, None)


@pytest.mark.unit
@pytest.mark.parametrize("taken", ["views.azimuth_deg", "views.v1.azimuth_deg"])
def test_whatever_is_offered_beside_a_turn_keeps_its_name(taken: str) -> None:
    """A turn of all views and one of a single view's same angle would leave angles that have neither's name."""
    scene = true_scene()
    turned = at(scene, {scene.parameters[taken]: scene.parameters[taken].value + 2.0})
    views: Any = [SimpleNamespace(view=view) for view in scene.views]
    here: Any = SimpleNamespace(scene=turned, problem=SimpleNamespace(views=views))
    (first,) = changes(scene, turned)
    offered = hypotheses(scene, here)
    assert {one.kind for one in offered} == {"view_angles", "pixel_spacing"}
    for one in offered:
        (key,) = one.parameters
        unit = 0.01 if one.kind == "pixel_spacing" else 1.0
        both = at(turned, {turned.parameters[key]: turned.parameters[key].value + unit})
        assert set(changes(scene, both)) == {first, one.name}


@pytest.mark.unit
def test_two_readings_of_one_body_are_one_hypothesis() -> None:
    """A body that is sunk looks as one that is lower: the name is that of its size, and the other reading is said."""
    scene = true_scene()
    at_foot = {"position_m": [0.0, 0.0, -0.5]}
    size = GeometryCandidate("object_size", "hut", scene, 100.0, 3)
    reading = object_pose.CHANGE.reading(at_foot)
    sunk = GeometryCandidate("object_pose", "hut", scene, 100.0 + 0.9 * SAME_IMAGES, 4, at_foot, reading=reading)
    one_reading = object_size.CHANGE.one_reading
    (one,) = one_reading([sunk, size])
    assert one.kind == "object_size"
    assert "-0.50 m up" in one.words[-1]
    for gain in (100.0 + 1.1 * SAME_IMAGES, 100.0 - 1.1 * SAME_IMAGES):
        assert one_reading([replace(sunk, gain=gain), size]) == [replace(sunk, gain=gain), size]
    assert one_reading([size]) == [size]
    assert one_reading([sunk]) == [sunk]
