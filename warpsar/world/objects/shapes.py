"""Primitives: bodies of a few numbers, as triangles in the object's frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from warpsar.world.objects.table import CABIN, Object

ROUND = 48
"""Sides of a cylinder, and of a sphere's equator."""
SIDE_STRIPS = 6  # of a vehicle's curved side
CLEARANCE, BELT = 0.12, 0.58  # of a vehicle's height: its underside; a car's window line
HOOD, CROWN = 0.85, 1.03  # of the window line: a car's front end; the middle of its hood and trunk
TUMBLEHOME = 0.78  # width of a car's roof, of its body
TRUNK, REAR_WINDOW, WINDSHIELD = 0.12, 0.12, 0.68  # of a car's length; of its cabin: where the roof begins and ends
GAP, CAB_HEIGHT = 0.03, 0.8  # of a truck's length, between cab and box; of its height


@dataclass(frozen=True)
class ObjectTriangles:
    """Triangles: `vertices` [m], shape (n, 3), float64, in the object's frame; `faces`, (m, 3), int32.

    The faces depend on the kind of body alone, so that vertices of other numbers fit to them.
    """

    vertices: np.ndarray
    faces: np.ndarray


def body(table: Object) -> ObjectTriangles:
    """The primitive that the table states: its length along the front (+Y), its width along +X, its foot at z = 0."""
    assert table.primitive is not None
    assert table.size_m is not None
    return _made(table.primitive, table.size_m, table.cabin, table.side_curvature or 0.0)


@lru_cache(maxsize=1024)  # a fit moves some bodies of many, and asks for all of them
def _made(
    primitive: str, size_m: tuple[float, float, float], cabin: float | None, side_curvature: float
) -> ObjectTriangles:
    if primitive in CABIN:
        share = CABIN[primitive] if cabin is None else cabin
        made = _VEHICLES[primitive](*size_m, share, side_curvature)
    else:
        made = _SOLIDS[primitive](*size_m)
    for array in (made.vertices, made.faces):
        array.flags.writeable = False
    return made


def _joined(parts: Sequence[ObjectTriangles]) -> ObjectTriangles:
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    return ObjectTriangles(np.concatenate([part.vertices for part in parts]), faces.astype(np.int32))


def _sheet(corner: Sequence[float], one: Sequence[float], other: Sequence[float]) -> ObjectTriangles:
    """A parallelogram."""
    a, p, q = (np.asarray(each, float) for each in (corner, one, other))
    return ObjectTriangles(np.stack([a, a + p, a + p + q, a + q]), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def _box(length: float, width: float, height: float) -> ObjectTriangles:
    x, y = width / 2.0, length / 2.0
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    vertices = np.array([(*c, 0.0) for c in corners] + [(*c, height) for c in corners])
    quads = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return ObjectTriangles(vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32))


def _plate(length: float, width: float, height: float) -> ObjectTriangles:
    """A sheet where one size is 0, else a slab."""
    x, y = width / 2.0, length / 2.0
    if height == 0.0:
        return _sheet((-x, -y, 0.0), (width, 0.0, 0.0), (0.0, length, 0.0))
    if length == 0.0:
        return _sheet((x, 0.0, 0.0), (-width, 0.0, 0.0), (0.0, 0.0, height))
    if width == 0.0:
        return _sheet((0.0, -y, 0.0), (0.0, length, 0.0), (0.0, 0.0, height))
    return _box(length, width, height)


def _dihedral(length: float, width: float, height: float) -> ObjectTriangles:
    """A floor, and a wall at its back; it opens to the front."""
    x, y = width / 2.0, length / 2.0
    floor = _sheet((-x, -y, 0.0), (width, 0.0, 0.0), (0.0, length, 0.0))
    return _joined([floor, _sheet((x, -y, 0.0), (-width, 0.0, 0.0), (0.0, 0.0, height))])


def _trihedral(length: float, width: float, height: float) -> ObjectTriangles:
    """A floor and two walls that meet in a corner at the back; at right angles where length = width."""
    back, right, left = np.array([[0.0, -length / 2, 0.0], [width / 2, 0.0, 0.0], [-width / 2, 0.0, 0.0]])
    up = (0.0, 0.0, height)
    sheets = [_sheet(back, right - back, left - back), _sheet(back, up, right - back), _sheet(back, left - back, up)]
    return _joined(sheets)


def _rings(rings: np.ndarray) -> ObjectTriangles:
    """A closed body through rings of an even number of points, shape (k, n, 3), with a lid at either end."""
    count, size, _ = rings.shape
    at = np.arange(count * size).reshape(count, size)
    a, b = at[:-1], np.roll(at, -1, axis=1)[:-1]
    c, d = np.roll(at, -1, axis=1)[1:], at[1:]
    sides = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    i = np.arange(size // 2 - 1)  # strips from one half of the ring to the other
    j = size - 1 - i
    lid = np.concatenate([np.stack([i, i + 1, j - 1], axis=1), np.stack([i, j - 1, j], axis=1)])
    faces = np.concatenate([sides, at[0][lid[:, ::-1]], at[-1][lid]])
    return ObjectTriangles(rings.reshape(-1, 3), faces.astype(np.int32))


def _without_slivers(made: ObjectTriangles) -> ObjectTriangles:
    p = made.vertices[made.faces]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return ObjectTriangles(made.vertices, made.faces[area > 1e-9 * area.max()])


def _circle() -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(ROUND) / ROUND
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _cylinder(length: float, width: float, height: float) -> ObjectTriangles:
    """An upright cylinder; its sides touch the ellipse of `length` and `width` from inside."""
    flat = _circle() * (width / 2.0, length / 2.0)
    return _rings(np.stack([np.column_stack([flat, np.full(ROUND, z)]) for z in (0.0, height)]))


def _sphere(length: float, width: float, height: float) -> ObjectTriangles:
    """An ellipsoid that stands on its lowest point."""
    polar = np.pi * np.arange(ROUND // 2 + 1) / (ROUND // 2)
    rings = [np.column_stack([np.sin(t) * _circle(), np.full(ROUND, -np.cos(t))]) for t in polar]
    unit = _without_slivers(_rings(np.stack(rings)))
    return ObjectTriangles(
        (unit.vertices + np.array([0.0, 0.0, 1.0])) * (width / 2.0, length / 2.0, height / 2.0), unit.faces
    )


def _section(y: float, low: float, belt: float, roof: float, half: float, curvature: float, top: float) -> np.ndarray:
    """A ring across a vehicle at `y`: curved sides from `low` to `belt`, then straight to the roof, `top` wide."""
    t = np.linspace(0.0, 1.0, SIDE_STRIPS + 1)
    x, z = half * (1.0 - curvature * (2.0 * t - 1.0) ** 2), low + t * (belt - low)
    right = [*zip(x, z, strict=True), (half * top, roof)]
    return np.array([(-a, y, b) for a, b in right] + [(a, y, b) for a, b in reversed(right)])


def _car(length: float, width: float, height: float, cabin: float, curvature: float) -> ObjectTriangles:
    low, belt, half, tail = CLEARANCE * height, BELT * height, width / 2.0, -length / 2.0
    foot, top = tail + TRUNK * length, TUMBLEHOME * (1.0 - curvature)
    stations = [
        (tail, belt, CROWN * belt),
        (foot, belt, CROWN * belt),
        (foot + REAR_WINDOW * cabin * length, belt, height),
        (foot + WINDSHIELD * cabin * length, belt, height),
        (foot + cabin * length, belt, CROWN * belt),
        (length / 2.0, HOOD * belt, CROWN * HOOD * belt),
    ]
    return _rings(np.stack([_section(y, low, side, roof, half, curvature, top) for y, side, roof in stations]))


def _truck(length: float, width: float, height: float, cabin: float, curvature: float) -> ObjectTriangles:
    """A cab, and a box behind it."""
    low, half, front = CLEARANCE * height, width / 2.0, length / 2.0
    back = front - cabin * length

    def part(start: float, end: float, roof: float) -> ObjectTriangles:
        ends = [_section(y, low, 0.98 * roof, roof, half, curvature, 0.98 * (1.0 - curvature)) for y in (start, end)]
        return _rings(np.stack(ends))

    return _joined([part(-front, back - GAP * length, height), part(back, front, CAB_HEIGHT * height)])


_SOLIDS: dict[str, Callable[[float, float, float], ObjectTriangles]] = {
    "box": _box,
    "cylinder": _cylinder,
    "sphere": _sphere,
    "plate": _plate,
    "dihedral": _dihedral,
    "trihedral": _trihedral,
}
_VEHICLES: dict[str, Callable[[float, float, float, float, float], ObjectTriangles]] = {"car": _car, "truck": _truck}
