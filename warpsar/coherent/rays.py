"""The rays of a direction: cells of a grid across it, and the parts of a cell whose tube gets too wide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.kernels.coherent.radiate import RAYS


@dataclass(frozen=True)
class Rays:
    """Cells of several directions, a multiple of `RAYS` for each direction; the last ones may be unused."""

    view: NDArray[np.int32]
    """(n,)."""
    place: NDArray[np.float64]
    """Middle along u and v [m], (n, 2)."""
    size: NDArray[np.float64]
    """Width along u and v [m], (n, 2)."""
    used: NDArray[np.int32]
    """(n,)."""

    def __len__(self) -> int:
        return len(self.view)

    def __getitem__(self, some: slice) -> Rays:
        return Rays(self.view[some], self.place[some], self.size[some], self.used[some])


def grid(body: CoherentBody, directions: Directions, spacing_m: float, distance_m: float | None = None) -> Rays:
    """Cells of at most `spacing_m` that cover the mesh as each direction sees it, without a rest at its sides.

    They lie in the plane through the body's middle; with a distance as a radar there sees it.
    """
    parts = []
    for index in range(len(directions)):
        low, step, count = frame(body, directions, index, spacing_m, distance_m)
        i, j = (axis.ravel() for axis in np.meshgrid(np.arange(count[0]), np.arange(count[1]), indexing="ij"))
        place = low + (np.stack([i, j], axis=1) + 0.5) * step
        parts.append((place, np.broadcast_to(step, place.shape)))
    return _padded(parts)


def frame(
    body: CoherentBody, directions: Directions, index: int, spacing_m: float, distance_m: float | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Of one direction's grid: its lower corner along u and v [m], the width of a cell [m], and how many; (2,) each."""
    s, u, v = directions.s[index], directions.u[index], directions.v[index]
    ends = body.extents([u, v])
    if distance_m is not None:
        along = body.seen_from(directions.places(body.origin, distance_m)[index], s) @ np.stack([u, v], axis=1)
        ends = np.stack([along.min(axis=0), along.max(axis=0)], axis=1)
    width = ends[:, 1] - ends[:, 0]
    count = np.maximum(np.ceil(width / spacing_m - 1e-9), 1).astype(int)
    return ends[:, 0], width / count, count


def children(rays: Rays, cut: NDArray[np.bool_], views: int) -> Rays:
    """Halves of cells, or quarters: `cut` says along which sides, (n, 2). Cells without a cut are left out."""
    parts = []
    for view in range(views):
        some = np.flatnonzero(cut.any(axis=1) & (rays.view == view))
        place, size, along = rays.place[some], rays.size[some], cut[some]
        for side in (0, 1):
            copies = np.where(along[:, side], 2, 1)
            first = np.cumsum(copies) - copies
            place, size = np.repeat(place, copies, axis=0), np.repeat(size, copies, axis=0)
            along = np.repeat(along, copies, axis=0)
            halved = along[:, side]
            size[halved, side] *= 0.5
            place[halved, side] -= 0.5 * size[halved, side]
            second = first[copies == 2] + 1
            place[second, side] += size[second, side]
        parts.append((place, size))
    return _padded(parts)


def _padded(parts: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> Rays:
    view, place, size, used = [], [], [], []
    for index, (places, sizes) in enumerate(parts):
        more = -len(places) % RAYS
        view.append(np.full(len(places) + more, index, np.int32))
        place.append(np.concatenate([places, np.zeros((more, 2))]))
        size.append(np.concatenate([sizes, np.zeros((more, 2))]))
        used.append(np.repeat(np.array([1, 0], np.int32), [len(places), more]))
    return Rays(np.concatenate(view), np.concatenate(place), np.concatenate(size), np.concatenate(used))
