"""The rims of thin plates of metal, and how far the opposite rim is: what waves from edge to edge go between."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.records import records
from warpsar.coherent.shape import MeshShape
from warpsar.kernels.coherent import edge_waves, edges

_STRAIGHT = 1e-6


def rims(
    shape: MeshShape,
    which: NDArray[np.int64],
    bare: NDArray[np.bool_],
    middle: NDArray[np.float64],
    along: NDArray[np.float64],
    thin_m: float,
) -> tuple[Any, Any]:
    """Records of `edges.Edge` and `edge_waves.Opposite`, (rims,), among pieces of the wedges `which`, (n,) and (n, 3).

    A rim is the border of a flat sheet, or one of the two right-angled edges of a box that is thinner than `thin_m`.
    `bare`: which wedges are of bare metal, (wedges,). Coated ones are no rims.
    """
    thickness = _thickness(shape, np.unique(which[bare[which]]), thin_m)
    region, found = shape.region[shape.wedges.face], []
    borders = {one: np.flatnonzero((region == one).any(axis=1)) for one in np.unique(region[~np.isnan(thickness)])}
    for piece, side in np.argwhere(~np.isnan(thickness[which])):
        own = int(which[piece])
        one = region[own, side]
        way, other, ends = _across(shape, middle[piece], own, side, borders[one])
        if other >= 0 and not np.isnan(thickness[other, int(region[other, 0] != one)]):
            found.append((piece, side, way, *ends, thickness[own, side]))
    piece, side = (np.array([each[i] for each in found], int) for i in range(2))
    opposite = records(edge_waves.Opposite, len(found))
    opposite["piece"] = piece
    for i, name in enumerate(("way", "begin", "end", "thickness")):
        opposite[name] = [each[2 + i] for each in found]
    packed = records(edges.Edge, len(found))
    own = which[piece]
    packed["first"] = packed["second"] = _vectors(shape, "into")[own, side]
    packed["normal_first"] = _vectors(shape, "normal")[own, side]
    packed["normal_second"] = -packed["normal_first"]
    packed["middle"], packed["along"], packed["outer"] = middle[piece], along[piece], 2.0
    packed["share"] = shape.wedges.share[own]
    reach = shape.wedges.reach(own, middle[piece])[np.arange(len(own)), side]
    packed["reach_first"] = packed["reach_second"] = reach
    return packed, opposite


def _vectors(shape: MeshShape, kind: str) -> NDArray[np.float64]:
    """Into both faces of a wedge, or their normals, (wedges, 2, 3)."""
    names = ("first", "second") if kind == "into" else ("normal_first", "normal_second")
    return np.stack([getattr(shape.wedges, name) for name in names], axis=1)


def _thickness(shape: MeshShape, some: NDArray[np.int64], thin_m: float) -> NDArray[np.float64]:
    """Of the plate that both faces of a wedge belong to, (wedges, 2) [m]: 0 for a sheet, NaN where there is none."""
    wedges, region, normal = shape.wedges, shape.region[shape.wedges.face], _vectors(shape, "normal")
    found = np.full(region.shape, np.nan)
    flat = some[(region[some] >= 0).all(axis=1)]
    sheet = wedges.outer[flat] > 2.0 - _STRAIGHT
    found[flat[sheet], 0] = 0.0
    borders: dict[int, NDArray[np.int64]] = {}
    for own in flat[np.abs(wedges.outer[flat] - 1.5) < _STRAIGHT]:
        for side in range(2):  # the wide face; the other one is its rim
            rim = int(region[own, 1 - side])
            if rim not in borders:
                borders[rim] = np.flatnonzero((region == rim).any(axis=1))
            middle = 0.5 * (wedges.start[own] + wedges.end[own])
            way, other, _ = _across(shape, middle, int(own), 1 - side, borders[rim])
            if other >= 0 and way < thin_m:
                behind = normal[other, int(region[other, 0] == rim)]
                if behind @ normal[own, side] < _STRAIGHT - 1.0:
                    found[own, side] = way
    return found


def _across(
    shape: MeshShape, place: NDArray[np.float64], own: int, side: int, border: NDArray[np.int64]
) -> tuple[float, int, tuple[float, float]]:
    """How far the nearest wedge across a face is from a place, which one, and its ends along `own` from the place [m].

    The number is -1 where it is not parallel.
    """
    wedges = shape.wedges
    into, along = _vectors(shape, "into")[own, side], wedges.end[own] - wedges.start[own]
    along = along / np.linalg.norm(along)
    ends = np.stack([wedges.start[border], wedges.end[border]]) - place
    x, t = ends @ into, ends @ along  # (2, borders) each
    width = np.where(t[1] == t[0], 1.0, t[1] - t[0])
    meets = (t[0] * t[1] <= 0.0) & (t[1] != t[0])
    way = np.where(meets, x[0] - t[0] * (x[1] - x[0]) / width, np.inf)
    way[(border == own) | (way <= 1e-9 * shape.size)] = np.inf
    first = int(way.argmin())
    if not np.isfinite(way[first]) or abs(x[1, first] - x[0, first]) > _STRAIGHT * abs(t[1, first] - t[0, first]):
        return 0.0, -1, (0.0, 0.0)
    return float(way[first]), int(border[first]), (float(t[:, first].min()), float(t[:, first].max()))
