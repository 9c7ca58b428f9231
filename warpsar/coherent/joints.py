"""Which faces of a mesh meet at which edge. Meshes of CAD are often not welded: their parts share no vertices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

WELD = 2e-6
"""Vertices closer than this share of the body's size are one: STL keeps seven digits."""
GAP = 1e-5
"""Borders closer than this share of the size, and a hundredth of their length, meet."""
_NEIGHBOURS = 8


@dataclass(frozen=True)
class Joints:
    """Straight pieces of edges, each between a face and another face, or none."""

    start: NDArray[np.float64]
    """[m], shape (n, 3)."""
    end: NDArray[np.float64]
    """[m], shape (n, 3)."""
    face: NDArray[np.int64]
    """(n,)."""
    other: NDArray[np.int64]
    """(n,); -1 at the border of an open sheet."""
    share: NDArray[np.float64]
    """(n,): 1, or 1/2 where both faces state the piece."""
    vertex: NDArray[np.int64]
    """The vertices of the edge that the piece is cut from, (n, 2)."""
    part: NDArray[np.float64]
    """Where on the way from the first of them to the second it starts and ends, 0 to 1, (n, 2)."""


def welded(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Faces by vertices that are one where they lie in one place, shape (m, 3)."""
    size = float(np.ptp(vertices, axis=0).max())
    cells = np.round(vertices / (WELD * size)).astype(np.int64)
    inverse = np.unique(cells, axis=0, return_inverse=True)[1]
    return np.asarray(inverse).ravel()[faces]


def joints(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> Joints:
    """All edges of a mesh. An edge of one face alone is cut into pieces and joined to the border that it lies on."""
    corners = welded(vertices, faces)
    half = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    places = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    keep = half[:, 0] != half[:, 1]
    half, places, owner = half[keep], places[keep], owner[keep]
    key = np.sort(half, axis=1)
    order = np.lexsort((key[:, 1], key[:, 0]))
    key, places, owner = key[order], places[order], owner[order]
    new = np.append(True, (key[1:] != key[:-1]).any(axis=1))
    first = np.flatnonzero(new)
    count = np.diff(np.append(first, len(key)))
    pairs = first[count == 2]
    single = first[count == 1]
    start, end, edge, part, other = _matched(vertices[places[single]], owner[single], vertices)
    a = vertices[places[pairs]]
    return Joints(
        np.concatenate([a[:, 0], start]),
        np.concatenate([a[:, 1], end]),
        np.concatenate([owner[pairs], owner[single][edge]]),
        np.concatenate([owner[pairs + 1], other]),
        np.concatenate([np.ones(len(pairs)), np.where(other < 0, 1.0, 0.5)]),
        np.concatenate([places[pairs], places[single][edge]]).astype(np.int64),
        np.concatenate([np.tile([0.0, 1.0], (len(pairs), 1)), part]),
    )


def _matched(
    ends: NDArray[np.float64], owner: NDArray[np.int64], vertices: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Pieces of border edges `ends` (n, 2, 3): start, end, edge, part, and the face whose border they lie on, or -1."""
    if not len(ends):
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0, np.int64)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    unit = float(np.median(length))
    cuts = np.ceil(length / unit - 1e-9).astype(int).clip(1)
    edge = np.repeat(np.arange(len(ends)), cuts)
    step = np.arange(len(edge)) - np.repeat(np.cumsum(cuts) - cuts, cuts)
    along = (ends[edge, 1] - ends[edge, 0]) / cuts[edge, None]
    start = ends[edge, 0] + step[:, None] * along
    middle = start + 0.5 * along
    found: Any = cKDTree(middle).query(middle, k=min(_NEIGHBOURS, len(middle)), distance_upper_bound=1.01 * unit)
    near, who = (each.reshape(len(middle), -1) for each in found)
    allowed = GAP * float(np.ptp(vertices, axis=0).max()) + 0.01 * np.linalg.norm(along, axis=1)
    other = np.full(len(middle), -1, np.int64)
    best = np.full(len(middle), np.inf)
    direction = along / np.linalg.norm(along, axis=1)[:, None]
    for column in range(who.shape[1]):
        there = np.flatnonzero(np.isfinite(near[:, column]))
        candidate = who[there, column]
        apart = owner[edge[candidate]] != owner[edge[there]]
        there, candidate = there[apart], candidate[apart]
        offset = middle[there] - start[candidate]
        t = np.clip(np.einsum("ij,ij->i", offset, along[candidate]) / (along[candidate] ** 2).sum(1), 0.0, 1.0)
        gap = np.linalg.norm(offset - t[:, None] * along[candidate], axis=1)
        parallel = np.abs(np.einsum("ij,ij->i", direction[there], direction[candidate])) > 0.95
        better = parallel & (gap < allowed[there]) & (gap < best[there])
        best[there[better]] = gap[better]
        other[there[better]] = owner[edge[candidate[better]]]
    part = (step[:, None] + [0.0, 1.0]) / cuts[edge, None]
    return start, start + along, edge, part, other
