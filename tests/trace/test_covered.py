"""Where a surface lies in an image, lit or hidden, against the outline of a plane and a box by geometry."""

import numpy as np
import pytest
from worlds import axes, box, ground, join, mesh_of, scene_of, view

from warpsar.runtime import devices
from warpsar.simulation.rays import hit_grid
from warpsar.surface.stage import Stage
from warpsar.trace import layers
from warpsar.trace.layers import covered
from warpsar.world.world import geometry_of

CPU = devices.resolve_device("cpu")
SIDE, HEIGHT, SPACING, SIZE = 24.0, 6.0, 0.5, 96
BORDER = 3  # pixels about an outline, in which nothing is asked: few rays tell where it lies to a pixel or two


def inside(outline: np.ndarray, row: np.ndarray, col: np.ndarray, away: float) -> np.ndarray:
    """Whether pixels lie inside a convex outline, (n, 2) in order, by at least `away` pixels (outside, if negative)."""
    found = np.ones(row.shape, bool)
    centre = outline.mean(axis=0)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        normal = np.array([b[1] - a[1], a[0] - b[0]]) / np.hypot(*(b - a))
        normal *= np.sign(normal @ (centre - a))
        found &= (row - a[0]) * normal[0] + (col - a[1]) * normal[1] >= away
    return found


@pytest.mark.parametrize(("azimuth", "incidence"), [(0.0, 40.0), (30.0, 25.0), (200.0, 60.0)])
def test_ground_is_covered_in_shadow_too_and_nothing_beyond_it(azimuth: float, incidence: float) -> None:
    """A plane with a box in its middle: the shadow lies on the plane, so the plane's outline is what is covered. Beyond
    it, and beyond what the box throws toward the radar, nothing is."""
    body = box((-3.0, -3.0, 0.0), (3.0, 3.0, HEIGHT))
    scene = scene_of(
        mesh_of(ground=join([ground(SIDE), body])),
        [view(azimuth, incidence)],
        shape=(SIZE, SIZE),
        spacing_m=(SPACING, SPACING),
    )
    stage = Stage.of(scene, CPU)
    found = covered(stage.target, geometry_of(scene, scene.views[0]), hit_grid(scene))
    d, u, _ = axes(azimuth, incidence)
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * SIDE / 2.0
    outline = np.stack([corners @ d, corners @ u], axis=1) / SPACING + SIZE / 2.0
    row, col = (at + 0.5 for at in np.indices((SIZE, SIZE)))
    assert found[inside(outline, row, col, BORDER)].all()
    top = np.stack([body[0] @ axis for axis in (d, u)], axis=1) / SPACING + SIZE / 2.0
    low, high = top.min(axis=0) - BORDER, top.max(axis=0) + BORDER
    over_box = (row > low[0]) & (row < high[0]) & (col > low[1]) & (col < high[1])
    assert not found[~inside(outline, row, col, -BORDER) & ~over_box].any()


def test_holes_that_few_rays_leave_are_filled_and_larger_ones_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """7 x 7 pixels that no ray met on a slope, and a pond of 12 x 12 that the mesh does not have."""
    met = np.ones((SIZE, SIZE), bool)
    met[20:27, 30:37] = False
    met[60:72, 50:62] = False
    monkeypatch.setattr(layers, "launch_layers", lambda *_: (met.ravel().astype(np.int32), np.zeros(met.size, bool)))
    scene = scene_of(mesh_of(ground=ground(SIDE)), [view(0.0, 40.0)], shape=(SIZE, SIZE), spacing_m=(SPACING, SPACING))
    found = covered(Stage.of(scene, CPU).target, geometry_of(scene, scene.views[0]), hit_grid(scene))
    assert found[15:32, 25:42].all()
    assert not found[63:69, 53:59].any()
