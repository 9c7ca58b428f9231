"""Ray tubes in a bent duct, by a program that shares nothing with the engine: exact arcs, NumPy, float64.

Ling, Chou, Lee (IEEE TAP 37(2), 1989). The tubes start at the mouth, in cells that fit it, and are not cut.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from duct_modes import Duct
from numpy.typing import NDArray

Complexes = NDArray[np.complex128]
Reals = NDArray[np.float64]
NEAR_M = 1e-9


class Line(NamedTuple):
    """A flat wall across the plane of the bend: x and z of its ends [m]."""

    start: Reals
    end: Reals


class Arc(NamedTuple):
    """A curved wall: points centre + radius (-sin a, cos a), a between low and high. A radius may be negative."""

    centre: Reals
    radius: float
    low: float
    high: float


def walls(duct: Duct, low_m: float) -> list[Line | Arc]:
    """The walls across the plane of the bend, the mouth's lower corner at (0, low_m)."""

    def up(a: float) -> Reals:
        return np.array([-math.sin(a), math.cos(a)])

    found: list[Line | Arc] = []
    at, a, h = np.array([0.0, low_m]), 0.0, duct.height_m
    for piece in duct.pieces:
        if not piece.radius_m:
            along = piece.length * np.array([-math.cos(a), -math.sin(a)])
            found += [Line(at, at + along), Line(at + h * up(a), at + h * up(a) + along)]
            at = at + along
            continue
        sign = 1.0 if piece.down else -1.0
        centre, after = at - sign * piece.radius_m * up(a), a + sign * piece.length
        low, high = sorted((a, after))
        found += [Arc(centre, sign * r, low, high) for r in (piece.radius_m, piece.radius_m + sign * h)]
        at, a = centre + sign * piece.radius_m * up(after), after
    return [*found, Line(at, at + h * up(a))]


@dataclass
class Met:
    """Where rays meet walls: way [m], normal toward the ray, and the normal's change per step along the wall (n,)."""

    way: Reals
    normal: Reals
    bend: Reals
    """1 / m, times a step in the plane of the bend."""


def meet(duct: Duct, some: list[Line | Arc], side_m: float, point: Reals, d: Reals) -> Met:
    """The nearest wall of each ray, (n, 3) each; infinitely far where it leaves through the mouth first."""
    n = len(point)
    p, e = point[:, [0, 2]], d[:, [0, 2]]
    found = Met(np.full(n, np.inf), np.zeros((n, 3)), np.zeros(n))

    def take(way: Reals, good: NDArray[np.bool_], normal: Reals, bend: float) -> None:
        better = good & (way > NEAR_M) & (way < found.way)
        facing = np.where((normal * d).sum(axis=1) > 0.0, -1.0, 1.0)
        found.way[better] = way[better]
        found.normal[better] = (facing[:, None] * normal)[better]
        found.bend[better] = (facing * bend)[better]

    with np.errstate(divide="ignore", invalid="ignore"):
        for y in (side_m, side_m + duct.width_m):
            take((y - point[:, 1]) / d[:, 1], d[:, 1] != 0.0, np.tile([0.0, 1.0, 0.0], (n, 1)), 0.0)
        for wall in some:
            if isinstance(wall, Line):
                along = wall.end - wall.start
                across = np.array([-along[1], along[0]]) / np.linalg.norm(along)
                way = (wall.start - p) @ across / (e @ across)
                share = (p + way[:, None] * e - wall.start) @ along / (along @ along)
                take(way, (share >= 0.0) & (share <= 1.0), np.tile([across[0], 0.0, across[1]], (n, 1)), 0.0)
                continue
            off = p - wall.centre
            square, half = (e * e).sum(axis=1), (off * e).sum(axis=1)
            under = half**2 - square * ((off * off).sum(axis=1) - wall.radius**2)
            for sign in (-1.0, 1.0):
                way = (-half + sign * np.sqrt(np.where(under >= 0.0, under, np.nan))) / square
                out = (off + way[:, None] * e) / wall.radius
                angle = np.arctan2(-out[:, 0], out[:, 1])
                normal = np.stack([out[:, 0], np.zeros(n), out[:, 1]], axis=1)
                take(way, (angle >= wall.low) & (angle <= wall.high), normal, 1.0 / wall.radius)
        mouth = np.where(d[:, 0] > 0.0, -point[:, 0] / d[:, 0], np.inf)
    found.way[mouth < found.way] = np.inf
    return found


def caustics(d: Reals, pu: Reals, pv: Reals, du: Reals, dv: Reals, way: Reals) -> NDArray[np.int64]:
    """How often the cross-section vanishes on a way: roots of a quadratic polynomial."""
    a0 = (d * np.cross(pu, pv)).sum(axis=1)
    a1 = (d * (np.cross(du, pv) + np.cross(pu, dv))).sum(axis=1)
    a2 = (d * np.cross(du, dv)).sum(axis=1)
    at = np.array([-1.0, -1.0])[None] * np.ones((len(a0), 1))
    flat = np.abs(a2) * way**2 <= 1e-12 * (np.abs(a0) + np.abs(a1) * way)
    with np.errstate(divide="ignore", invalid="ignore"):
        at[:, 0] = np.where(flat, -a0 / a1, (-a1 + np.sqrt(a1**2 - 4 * a2 * a0)) / (2 * a2))
        at[:, 1] = np.where(flat, np.nan, (-a1 - np.sqrt(a1**2 - 4 * a2 * a0)) / (2 * a2))
        count: NDArray[np.int64] = ((at > 0.0) & (at < way[:, None])).sum(axis=1)
    return count


@dataclass
class Tubes:
    """Tubes on their way: (n, 3) and (n,) each."""

    point: Reals
    d: Reals
    pu: Reals
    pv: Reals
    du: Reals
    dv: Reals
    path: Reals
    passed: NDArray[np.int64]
    """Caustics."""
    h: Reals
    """Field of a wave that came in as H."""
    v: Reals

    def __getitem__(self, some: NDArray[np.bool_]) -> Tubes:
        return Tubes(**{name: value[some] for name, value in vars(self).items()})


def dot(a: Reals, b: Reals) -> Reals:
    found: Reals = (a * b).sum(axis=-1)
    return found


@dataclass(frozen=True)
class Look:
    """A direction to the radar, and the cells of the mouth."""

    s: Reals
    h: Reals
    v: Reals
    k: float
    cell_m2: float

    def started(self, duct: Duct, corner: tuple[float, float], cell_m: float) -> Tubes:
        sizes = duct.width_m, duct.height_m
        count = [math.ceil(size / cell_m) for size in sizes]
        y, z = (low + (np.arange(n) + 0.5) / n * size for low, n, size in zip(corner, count, sizes, strict=True))
        point = np.stack([np.zeros(y.size * z.size), np.repeat(y, z.size), np.tile(z, y.size)], axis=1)
        zero = np.zeros_like(point)
        sides = np.diag([0.0, sizes[0] / count[0], sizes[1] / count[1]])[1:]
        pu, pv = (zero + side - (side @ self.s) * self.s for side in sides)
        passed = np.zeros(len(point), np.int64)
        return Tubes(point, zero - self.s, pu, pv, zero, zero, -point @ self.s, passed, zero + self.h, zero + self.v)

    def sent(self, at: Tubes, normal: Reals, back: tuple[Reals, Reals, Reals] | None) -> Complexes:
        """A [m] of HH and VV that the currents of tubes on a surface send, with the reflected direction and fields."""
        start = self.cell_m2 * self.s[0]
        area = np.sqrt(start * np.abs(dot(at.d, np.cross(at.pu, at.pv)))) / np.abs(dot(normal, at.d))
        turn = 0.5 * self.k / np.pi * (self.s - at.d)
        size = area * np.sinc(dot(turn, at.pu)) * np.sinc(dot(turn, at.pv))
        phase = -self.k * (at.path - at.point @ self.s) + 0.5 * np.pi * at.passed
        factor = -1j * self.k / (4.0 * np.pi) * size * np.exp(1j * phase)
        found = []
        for i, (p, e) in enumerate(((self.h, at.h), (self.v, at.v))):
            eta_h = np.cross(at.d, e)
            if back is not None:
                eta_h, e = eta_h + np.cross(back[0], back[1 + i]), e + back[1 + i]
            found.append((factor * (np.cross(normal, eta_h) @ p - np.cross(self.s, np.cross(e, normal)) @ p)).sum())
        return np.array(found)


def reflected(at: Tubes, normal: Reals, bend: Reals) -> Tubes:
    """Tubes after a wall: fields of a conductor; differentials with the wall's curvature (Igehy, 1999)."""
    nd = dot(normal, at.d)[:, None]
    sides = []
    for q, change in ((at.pu, at.du), (at.pv, at.dv)):
        turned = bend[:, None] * q * [1.0, 0.0, 1.0]
        sides.append(change - 2.0 * ((dot(normal, change) + dot(turned, at.d))[:, None] * normal + nd * turned))
    h, v = (2.0 * dot(normal, e)[:, None] * normal - e for e in (at.h, at.v))
    point = at.point + 10.0 * NEAR_M * normal
    return Tubes(point, at.d - 2.0 * nd * normal, at.pu, at.pv, *sides, at.path, at.passed, h, v)


def amplitudes(
    duct: Duct, corner: tuple[float, float], phi: float, k: float, cell_m: float, most: int = 60
) -> tuple[Complexes, Complexes]:
    """A [m] of HH and VV in a direction at phi [rad] across the bend: from every hit that is seen; from the mouth."""
    s, h = np.array([math.cos(phi), math.sin(phi), 0.0]), np.array([math.sin(phi), -math.cos(phi), 0.0])
    cells = math.ceil(duct.width_m / cell_m) * math.ceil(duct.height_m / cell_m)
    look = Look(s, h, np.array([0.0, 0.0, -1.0]), k, duct.width_m * duct.height_m / cells)
    some, tubes = walls(duct, corner[1]), look.started(duct, corner, cell_m)
    hits, mouth = np.zeros(2, complex), np.zeros(2, complex)
    for _ in range(most):
        met = meet(duct, some, corner[0], tubes.point, tubes.d)
        inside, x = np.isfinite(met.way), tubes.d[:, 0]
        way = np.where(inside, met.way, -tubes.point[:, 0] / np.where(inside, 1.0, x))
        tubes.passed = tubes.passed + caustics(tubes.d, tubes.pu, tubes.pv, tubes.du, tubes.dv, way)
        tubes.point, tubes.path = tubes.point + way[:, None] * tubes.d, tubes.path + way
        normal = np.where(inside[:, None], met.normal, [1.0, 0.0, 0.0])
        for side, change in (("pu", tubes.du), ("pv", tubes.dv)):
            q = getattr(tubes, side) + way[:, None] * change
            setattr(tubes, side, q - (dot(normal, q) / dot(normal, tubes.d))[:, None] * tubes.d)
        mouth += look.sent(tubes[~inside], normal[~inside], None)
        if not inside.any():
            break
        tubes, normal = tubes[inside], normal[inside]
        after = reflected(tubes, normal, met.bend[inside])
        seen = ~np.isfinite(meet(duct, some, corner[0], after.point, np.tile(s, (len(normal), 1))).way)
        seen &= normal @ s > 0.0
        hits += look.sent(tubes[seen], normal[seen], (after.d[seen], after.h[seen], after.v[seen]))
        tubes = after
    return hits, mouth
