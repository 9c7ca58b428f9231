"""Which edges of a box shine, where, and how much in all."""

import numpy as np
import pytest
import worlds
from effect_worlds import Case, render_of, with_effect
from worlds import box, ground, mesh_of, scene_of, view

from warpsar.effects.edge_diffraction import sharp_edges

pytestmark = pytest.mark.unit

WORKING = [Case({"strength": 0.7})]


def test_edges_of_a_box_are_lines_where_they_lie() -> None:
    mesh = mesh_of(soil=ground(20.0), wall=box((-3, -2, 0), (3, 2, 4)))
    scene = scene_of(mesh, view(20.0, 40.0), shape=(48, 48), rays_per_pixel=16.0)
    render = render_of(with_effect(scene, "edge_diffraction", {"strength": 1.0}))
    edges = sharp_edges(render.stage.target)
    assert len(edges.start) == 12
    render.forward()
    share = render.layers["beta0_edges_HH"].numpy().astype(float).reshape(48, 48)
    # from 20 degrees east of north the radar sees the roof's four edges and the three upright ones about the north
    # and the east wall
    d, u, _ = worlds.axes(20.0, 40.0)
    roof = [((-3, -2, 4), (3, -2, 4)), ((-3, 2, 4), (3, 2, 4)), ((-3, -2, 4), (-3, 2, 4)), ((3, -2, 4), (3, 2, 4))]
    upright = [((x, y, 0), (x, y, 4)) for x, y in ((3, 2), (-3, 2), (3, -2))]
    total = 0.0
    for start, end in roof + upright:
        a, b = np.array(start, float), np.array(end, float)
        sin2 = 1 - (((b - a) @ d) / np.linalg.norm(b - a)) ** 2
        total += 1.0 / worlds.WAVENUMBER * sin2 * np.linalg.norm(b - a)
        middle = (a + b) / 2
        row, col = int(np.floor(middle @ d / 0.5)) + 24, int(np.floor(middle @ u / 0.5)) + 24
        assert share[row - 1 : row + 2, col - 1 : col + 2].max() > 0
    # pieces of a quarter of a pixel whose start is just off the ground or the roof
    assert share.sum() * 0.25 == pytest.approx(total, rel=0.02)


def test_edges_do_not_shine_through() -> None:
    """A box under a roof larger than it: only the roof is seen from above."""
    plate = worlds.plate((-6, -6, 6.0), (12, 0, 0), (0, 12, 0))
    mesh = mesh_of(soil=ground(20.0), wall=box((-1, -1, 0), (1, 1, 2)), roof=plate)
    scene = scene_of(mesh, view(20.0, 20.0), shape=(48, 48), rays_per_pixel=16.0)
    render = render_of(with_effect(scene, "edge_diffraction", {"strength": 1.0}))
    render.forward()
    assert render.layers["beta0_edges_HH"].numpy().max() == 0


def test_level_ground_has_no_edges() -> None:
    mesh = mesh_of(soil=ground(20.0, cells=4))
    render = render_of(scene_of(mesh, view(0.0, 40.0), shape=(8, 8), rays_per_pixel=4.0))
    assert len(sharp_edges(render.stage.target).start) == 0


def test_a_face_without_width_is_no_side_of_an_edge() -> None:
    """A mesh may have them where it was cut: here along an edge of a box, and across its roof."""
    lines = [[(-3, -2, 4), (3, -2, 4), (1, -2, 4)], [(-3, -2, 4), (3, 2, 4), (0.3, 0.2, 4)]]
    cut = worlds.join([box((-3, -2, 0), (3, 2, 4)), *((np.array(one, float), np.array([[0, 1, 2]])) for one in lines)])
    mesh = mesh_of(wall=cut)
    scene = scene_of(mesh, view(20.0, 40.0), shape=(8, 8), rays_per_pixel=4.0)
    with np.errstate(all="raise"):
        assert len(sharp_edges(render_of(scene).stage.target).start) == 12
