"""Shifts of the image: exact for whole bins, and of unchanged power in between."""

from typing import Any

import numpy as np
import pytest
import worlds
from effect_worlds import ROUNDING, STRIP_MAP, Case, pair, plane, render_of, with_effect
from worlds import ground, mesh_of, scene_of, view

from warpsar.effects.registry import get
from warpsar.render.render import ViewRender
from warpsar.scene.scene import Scene

pytestmark = pytest.mark.unit

WORKING = [
    Case({"range_m": 0.31, "azimuth_m": -0.23}),
    Case({"range_m": 0.1, "east_m": 0.37, "north_m": 0.2, "up_m": -0.3}, STRIP_MAP),
]


def shifted(image: np.ndarray, rows: int, cols: int) -> np.ndarray:
    result = np.zeros_like(image)
    source = image[max(0, -rows) : image.shape[0] - max(0, rows), max(0, -cols) : image.shape[1] - max(0, cols)]
    result[max(0, rows) :, max(0, cols) :][: source.shape[0], : source.shape[1]] = source
    return result


def unmoved(scene: Scene, table: dict[str, Any]) -> tuple[ViewRender, np.ndarray]:
    """A render with registration, and its own hits' image at no shift."""
    render = render_of(with_effect(scene, "registration", table))
    bare = ViewRender(render.stage, render.view, render.hits, render.shape, ("HH",), [])
    return render, bare.forward()["HH"].astype(float)


def test_registration_by_whole_pixels_is_a_shift_of_the_image() -> None:
    render, before = unmoved(plane(), {"range_m": 1.5, "azimuth_m": -1.0})
    assert render.forward()["HH"] == pytest.approx(shifted(before, 3, -2), rel=ROUNDING, abs=1e-7 * before.max())


def test_registration_by_whole_fine_bins_is_exact() -> None:
    """A quarter of a pixel is one fine bin: the same as hits binned one bin farther."""
    render, _ = unmoved(plane(), {"range_m": 0.125})
    moved = render.forward()["HH"]
    grid = render.hits.grid
    render.hits.pixel.assign(render.hits.pixel.numpy() + grid.shape[1])
    render.set_parameters(render.stage.surface.nodes, {"registration": np.zeros(5)})
    assert moved == pytest.approx(render.forward()["HH"], rel=ROUNDING, abs=1e-9)


def test_registration_keeps_power_and_moves_its_centre() -> None:
    render, before = unmoved(plane(), {"range_m": 0.83, "azimuth_m": -0.61})
    after = render.forward()["HH"].astype(float)
    assert after.sum() == pytest.approx(before.sum(), rel=ROUNDING)
    for axis, metres in ((0, 0.83), (1, -0.61)):
        centres = [(np.arange(i.shape[axis]) * i.sum(axis=1 - axis)).sum() / i.sum() * 0.5 for i in (before, after)]
        # spreading over a pixel what lay in a fine bin of it leaves its mean to a small part of the bin
        assert centres[1] - centres[0] == pytest.approx(metres, abs=0.01)


def test_registration_of_the_world_is_seen_along_the_axes() -> None:
    east, up = 0.75, -0.5
    render, _ = unmoved(plane(), {"east_m": east, "up_m": up})
    world = render.forward()["HH"]
    d, u, _ = worlds.axes(20.0, 40.0)
    step = np.array([east, 0.0, up])
    render.set_parameters(render.stage.surface.nodes, {"registration": np.array([d @ step, u @ step, 0, 0, 0])})
    assert world == pytest.approx(render.forward()["HH"], rel=1e-4, abs=1e-6)


def test_shift_of_the_image_is_that_of_the_bins() -> None:
    """What others are told of the shift, against axes written out in angles, and against what the render does."""
    table = {"range_m": 0.31, "azimuth_m": -0.23, "east_m": 0.75, "north_m": 0.2, "up_m": -0.5}
    render, _ = unmoved(plane(), table)
    d, u, _ = worlds.axes(20.0, 40.0)
    world = np.array([0.75, 0.2, -0.5])
    shift = get("registration").shift_m(np.array(list(table.values())), render.geometry)
    assert shift == pytest.approx([0.31 + d @ world, -0.23 + u @ world], abs=1e-12)
    both = render.forward()["HH"]
    render.set_parameters(render.stage.surface.nodes, {"registration": np.array([*shift, 0, 0, 0])})
    assert both == pytest.approx(render.forward()["HH"], rel=1e-4, abs=1e-6)


def test_registration_brings_in_what_lay_beside_the_image() -> None:
    """Flat soil larger than the image: it stays lit to the edge."""
    scene = scene_of(mesh_of(soil=ground(60.0)), view(20.0, 40.0), shape=(16, 16), rays_per_pixel=16.0)
    _, image = pair(scene, "registration", {"range_m": 2.0, "azimuth_m": 2.0})
    assert image.min() > 0.8 * image.max()
