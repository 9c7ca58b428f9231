"""Shifts of one view alone: exact for whole pixels, and beside a registration."""

from dataclasses import replace

import numpy as np
import pytest
from effect_worlds import ROUNDING, Case, plane, render_of, street, with_effect
from worlds import ground, mesh_of, scene_of, view

from warpsar.effects.registry import get, held_by
from warpsar.learning.coordinates import SceneCoordinates
from warpsar.learning.geometry import Geometry
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.objects.table import Object

pytestmark = pytest.mark.unit

WORKING = [
    Case({"range_m": {"v0": 0.31}, "azimuth_m": {"v0": -0.23}}),
    Case({"range_m": {"v0": -0.43, "v1": 0.2}, "azimuth_m": {"v0": 0.11}}, {"slant_range_m": 300.0}),
]
FREE = {"range_m": {"view": 0.0}, "azimuth_m": {"view": 0.0}}


def test_an_aim_point_by_whole_pixels_is_a_shift_of_the_image() -> None:
    """Pixels are 0.5 m: three rows away from the radar, two columns to the left."""
    render = render_of(with_effect(plane(), "aim_point", {"range_m": {"view": 1.5}, "azimuth_m": {"view": -1.0}}))
    moved = render.forward()["HH"]
    render.set_parameters(None, {"aim_point": np.zeros(2)})
    before = render.forward()["HH"]
    assert before.max() > 0.0
    assert moved[3:, :-2] == pytest.approx(before[:-3, 2:], rel=ROUNDING, abs=1e-7 * float(before.max()))


def test_it_adds_to_a_registration() -> None:
    scene = with_effect(plane(), "registration", {"range_m": 0.3, "azimuth_m": 0.4})
    render = render_of(with_effect(scene, "aim_point", {"range_m": {"view": 0.5}, "azimuth_m": {"view": -0.9}}))
    both = render.forward()["HH"]
    render.set_parameters(None, {"registration": np.array([0.8, -0.5, 0.0, 0.0, 0.0]), "aim_point": np.zeros(2)})
    assert both == pytest.approx(render.forward()["HH"], rel=1e-4, abs=1e-6)
    assert both.sum() > 0.0


def vehicle() -> Scene:
    soil = scene_of(mesh_of(soil=ground(20.0)), view(20.0, 40.0), shape=(16, 16), rays_per_pixel=16.0)
    body = Object(name="hut", primitive="box", size_m=(3.0, 2.0, 2.0), material="soil", learn=("position", "heading"))
    return with_objects(replace(soil, objects=()), [body])


def test_it_holds_what_it_contains() -> None:
    """A registration and a place of an object: a free aim point moves every view by as much."""
    scene = with_effect(vehicle(), "registration", {"range_m": 0.1})
    both = with_effect(scene, "aim_point", FREE)
    fixed = with_effect(scene, "aim_point", {**FREE, "fixed": True})

    def labels(one: Scene) -> set[str]:
        fitted = SceneCoordinates(one, one.views).labels + Geometry(one).labels
        return {label for label in fitted if not label.startswith("soil")}

    place = {"hut.east", "hut.north", "hut.up"}
    assert labels(scene) == {"registration.range_m", "hut.heading", *place}
    assert labels(fixed) == labels(scene)
    assert labels(both) == {"aim_point.range_m[view]", "aim_point.azimuth_m[view]", "hut.heading"}
    assert held_by(both.effects) == {"registration": "aim_point"}
    assert Geometry(both).held == ["hut.position: held, because aim_point shifts each view by itself"]
    assert (held_by(fixed.effects), Geometry(fixed).held) == ({}, [])


def test_a_view_that_it_does_not_move_holds_places() -> None:
    scene = with_effect(vehicle(), "aim_point", FREE)
    other = view(110.0, 40.0, name="other")
    assert Geometry(scene).held
    assert Geometry(replace(scene, views=[*scene.views, other])).held == []
    looked_at = replace(scene, views=[*scene.views, other.model_copy(update={"role": "test"})])
    assert Geometry(looked_at).held == Geometry(scene).held  # a test view holds nothing in a fit


def test_a_view_that_no_table_names_stays() -> None:
    scene = street()
    moved = simulate(with_effect(scene, "aim_point", {"range_m": {"v0": 0.3}}), device="cpu")
    before = simulate(scene, device="cpu")
    assert np.array_equal(moved[1].beta0["HH"], before[1].beta0["HH"])
    assert not np.array_equal(moved[0].beta0["HH"], before[0].beta0["HH"])


def test_few_views_that_lie_elsewhere_are_simpler() -> None:
    """One view that was cut out about another point has a shift; the others lie where they should."""
    table = {"range_m": {"a": 0.01, "b": 0.5, "c": 0.02}, "azimuth_m": {"a": 0.0, "b": 0.0, "c": -0.03}, "reach_m": 0.0}
    (two,) = get("aim_point").simpler(table)
    assert two == {"range_m": {"b": 0.5, "c": 0.02}, "azimuth_m": {"b": 0.0, "c": -0.03}, "reach_m": 0.0}
    (one,) = get("aim_point").simpler(two)
    assert one == {"range_m": {"b": 0.5}, "azimuth_m": {"b": 0.0}, "reach_m": 0.0}
    assert get("aim_point").simpler(one) == []
