"""Which way is up in a mesh: what stands, what lies as ground does, and what says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import CASES, MEASURED, ROOT
from worlds import box, ground, join, plate

from warpsar.world.mesh import read_mesh
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.upright import y_up, z_up

pytestmark = pytest.mark.unit

Shape = tuple[np.ndarray, np.ndarray]


def house(ridge: float = 5.0, floor: bool = True) -> Shape:
    """10 x 8 x 8 m; the ridge, from -`ridge` to +`ridge` along x, makes it a gabled or a hipped roof."""
    low = [(-5, -4, 0), (5, -4, 0), (5, 4, 0), (-5, 4, 0)]
    high = [(x, y, 5) for x, y, _ in low]
    vertices = np.array([*low, *high, (-ridge, 0, 8), (ridge, 0, 8)], float)
    walls = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7]]
    roof = [[4, 5, 9], [4, 9, 8], [6, 7, 8], [6, 8, 9], [4, 8, 7], [5, 6, 9]]
    return vertices, np.array(walls + roof + [[0, 2, 1], [0, 3, 2]][: 2 * floor], np.int32)


def terrain(height: float) -> Shape:
    """Hills of 50 x 50 m."""
    vertices, faces = plate((0, 0, 0), (50, 0, 0), (0, 50, 0), 40)
    x, y = vertices[:, 0] / 9, vertices[:, 1] / 7
    return np.column_stack([vertices[:, :2], height * (np.sin(x) + np.cos(y)) / 4]), faces


def primitive(name: str) -> Shape:
    made = body(Object(primitive=name, size_m=(4.6, 1.8, 1.5), material="m"))
    return made.vertices, made.faces


TOWER = box((-3, -3, 0), (3, 3, 30))
PLAIN = {
    "a house": house(),
    "a house without a floor": house(floor=False),
    "a hipped roof": house(ridge=2.0),
    "a house on a plate": join([house(), ground(60.0)]),
    "a tower on a plate": join([TOWER, ground(30.0)]),
    "a tower on a slab": join([TOWER, box((-20, -20, -0.3), (20, 20, 0))]),
    "a chimney": join([box((0, 0, 0), (10, 10, 6)), box((3, 3, 6), (6, 6, 20))]),
    "hills": terrain(8.0),
    "almost level ground": terrain(0.5),
    "a house on hills": join([terrain(8.0), (house()[0] + [25, 25, 0], house()[1])]),
}
"""What stands or lies on one axis alone."""

UNDECIDED = {
    "a wall": plate((0, 0, 0), (5, 0, 0), (0, 0, 3), 4),
    "level ground": ground(50.0, 4),
    "two blocks": join([box((0, 0, 0), (10, 4, 6)), box((0, 4, 0), (4, 10, 6))]),
    "a block with a porch": join([box((0, 0, 0), (10, 8, 6)), box((4, 8, 0), (6, 10, 6))]),
    "steps": join([box((0, 0, 0), (10, 10, 6)), box((0, 0, 6), (5, 10, 12))]),
    "a plane's wings": join([box((-6, -1, 2), (6, 1, 2.2)), box((-0.5, -5, 1.5), (0.5, 5, 2.5))]),
    **{name: primitive(name) for name in ("box", "plate", "dihedral", "cylinder", "sphere", "car", "truck")},
}


def headings(vertices: np.ndarray) -> list[np.ndarray]:
    """The vertices, turned about Z by a quarter each."""
    found = [vertices]
    for _ in range(3):
        x, y, z = found[-1].T
        found.append(np.stack([-y, x, z], axis=1))
    return found


def in_y_up(vertices: np.ndarray) -> np.ndarray:
    """As a file with Y up has them; `z_up` takes it back."""
    x, y, z = vertices.T
    return np.stack([x, z, -y], axis=1)


@pytest.mark.parametrize("name", [*PLAIN, *UNDECIDED])
def test_z_up_is_left_alone(name: str) -> None:
    vertices, faces = {**PLAIN, **UNDECIDED}[name]
    for turned in headings(vertices):
        assert y_up(turned, faces) is None


@pytest.mark.parametrize("name", PLAIN)
def test_y_up_is_seen(name: str) -> None:
    vertices, faces = PLAIN[name]
    for turned in headings(vertices):
        assert "seems to have Y up" in str(y_up(in_y_up(turned), faces))


def test_the_turn_is_right_handed() -> None:
    points = np.random.default_rng(0).normal(size=(5, 3))
    assert np.array_equal(z_up(in_y_up(points)), points)
    assert np.array_equal(z_up(np.array([[1.0, 2.0, 3.0]])), [[1.0, -3.0, 2.0]])
    assert np.linalg.det(z_up(np.eye(3))) == pytest.approx(1.0)


def test_our_own_scenes_have_z_up() -> None:
    scenes = [*ROOT.glob("data/**/*.obj"), *CASES.glob("*/*.obj")]
    assert len(scenes) > 5
    for path in scenes:
        assert not [warning for warning in read_mesh(path).warnings if "Y up" in warning], path


@pytest.mark.measured
def test_a_vehicle_with_y_up_is_seen() -> None:
    """A drawing of the BTR-70, whose file has Y up (docs/measured-btr70.md)."""
    mesh = read_mesh(MEASURED / "mstar_btr70" / "BTR70.obj")
    assert any("seems to have Y up" in warning for warning in mesh.warnings)
