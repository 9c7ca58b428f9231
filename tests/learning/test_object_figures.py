"""Pictures of objects before and after: what is drawn, and what is not."""

import numpy as np
import pytest
from worlds import BRICK, box, ground, mesh_of, scene_of, view

from warpsar.learning.object_figures import MOST_FACES, _plain, _ridges, figure_of_objects
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

pytestmark = pytest.mark.unit

BODY = {"it": Material(**BRICK)}


def scene(**more: object) -> Scene:
    image = np.ones((40, 40), np.float32)
    views = [view(a, 40.0, name=f"v{a}", images={"HH": image}, looks=4.0) for a in (0, 90)]
    plain = scene_of(mesh_of(ground=ground(30), hut=box((5.0, 5.0, 0.0), (7.0, 8.0, 3.0))), views)
    if not more:
        return plain
    return with_objects(plain, (Object(name="it", primitive="box", material="it", **more),), BODY)  # type: ignore[arg-type]


def test_outlines_are_the_footprints() -> None:
    """A box turned by 90 degrees: its corners before and after, and the axes in metres."""
    size = (4.0, 2.0, 1.5)
    before = scene(size_m=size, position_m=(0.0, 0.0, 0.0))
    after = scene(size_m=size, position_m=(1.0, 2.0, 0.0), heading_deg=90.0)
    told = {"it": {"position_m": [1.0, 2.0, 0.0], "position_sd_m": [0.1, 0.2, 0.3]}}
    figure = figure_of_objects(before, after, told)
    assert figure is not None
    plan, space = figure.axes
    outlines = [np.array(line.get_xydata()) for line in plan.lines if len(line.get_xydata()) == 5]
    (declared,), (found,) = ([o for o in outlines if abs(o[:4].mean(axis=0)[0] - x) < 0.1] for x in (0.0, 1.0))
    np.testing.assert_allclose(np.abs(declared), np.tile((1.0, 2.0), (5, 1)), atol=1e-9)
    np.testing.assert_allclose(np.abs(found - (1.0, 2.0)), np.tile((2.0, 1.0), (5, 1)), atol=1e-9)
    assert (plan.get_xlabel(), plan.get_ylabel(), space.get_zlabel()) == ("east [m]", "north [m]", "up [m]")
    (ellipse,) = plan.patches
    # 95 % of a Gaussian of two numbers: sqrt(-2 ln 0.05) standard deviations
    np.testing.assert_allclose(
        (ellipse.width, ellipse.height), 2.0 * np.sqrt(-2.0 * np.log(0.05)) * np.array([0.1, 0.2]), rtol=1e-3
    )


def test_an_object_that_one_scene_lacks_is_drawn_once() -> None:
    figure = figure_of_objects(scene(), scene(size_m=(2.0, 2.0, 2.0)), {})
    assert figure is not None
    assert sum(len(line.get_xydata()) == 5 for line in figure.axes[0].lines) == 1


def test_nothing_is_drawn_where_nothing_differs() -> None:
    assert figure_of_objects(scene(), scene(), {}) is None
    assert figure_of_objects(scene(size_m=(2.0, 2.0, 2.0)), scene(size_m=(2.0, 2.0, 2.0)), {}) is None


def test_a_group_of_the_mesh_is_drawn_where_it_was_moved() -> None:
    plain = scene()
    moved = with_objects(plain, (Object(group="hut", position_m=(-3.0, 0.0, 0.0)),))
    figure = figure_of_objects(plain, moved, {"hut": {"position_sd_m": [0.1, 0.1, 0.1]}})
    assert figure is not None
    middles = sorted(
        float(np.array(line.get_xydata())[:4, 0].mean()) for line in figure.axes[0].lines if len(line.get_xydata()) == 5
    )
    np.testing.assert_allclose(middles, (3.0, 6.0))


def test_a_box_has_twelve_ridges_and_a_large_mesh_is_its_hull() -> None:
    vertices, faces = box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0))
    mesh = _plain(vertices, faces)
    assert len(_ridges(mesh)) == 12
    many = np.tile(faces, (MOST_FACES // len(faces) + 1, 1))
    hull = _plain(vertices, many)
    assert len(hull.faces) == 12
    np.testing.assert_allclose((hull.vertices.min(axis=0), hull.vertices.max(axis=0)), ((0, 0, 0), (1, 2, 3)))
