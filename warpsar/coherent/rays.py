"""The rays of a direction: cells of a grid across it, and the parts of a cell whose tube gets too wide.

They are on a device; the host knows how many cells each direction has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.coherent.records import upload
from warpsar.kernels.coherent import cells
from warpsar.runtime.structs import allocate, element_types, fill
from warpsar.trace.hits import concatenate


@dataclass(frozen=True)
class CellRays:
    """Cells of several directions, a multiple of `RAYS` for each; the last ones of a direction may be empty."""

    first: NDArray[np.int32]
    """The first cell of each direction, and the end, (directions + 1,)."""
    cells: Any
    """On the device, (n,) each (`kernels.coherent.cells.Cells`)."""

    @classmethod
    def of(
        cls, place: NDArray[np.float64], size: NDArray[np.float64], device: wp.Device, view: NDArray[Any] | None = None
    ) -> CellRays:
        """Cells, (n, 2) each, of one direction; or of those of `view`, (n,), whose sums are not told apart."""
        places = {"place": upload(place, wp.vec2d, device), "size": upload(size, wp.vec2d, device)}
        views = wp.zeros(len(place), dtype=int, device=device) if view is None else upload(view, int, device)
        return cls(np.array([0, len(place)], np.int32), fill(cells.Cells, view=views, **places))

    @classmethod
    def empty(cls, counts: NDArray[np.int64], device: wp.Device) -> CellRays:
        """Empty cells, at least so many for each direction."""
        first = _first(counts)
        made = allocate(cells.Cells, int(first[-1]), device)
        for name in element_types(cells.Cells):
            getattr(made, name).zero_()
        return cls(first, made)

    @classmethod
    def joined(cls, parts: Sequence[CellRays]) -> CellRays:
        """The cells of all parts; a direction's cells in two parts are the last of one and the first of the next."""
        if len(parts) == 1:
            return parts[0]
        kinds = element_types(cells.Cells)
        device = parts[0].cells.view.device
        whole = {k: concatenate([getattr(part.cells, k) for part in parts], of, device) for k, of in kinds.items()}
        return cls(sum((part.first for part in parts), np.zeros_like(parts[0].first)), fill(cells.Cells, **whole))

    def __len__(self) -> int:
        return int(self.first[-1])

    def __getitem__(self, some: slice) -> CellRays:
        start, stop, _ = some.indices(len(self))
        if (start, stop) == (0, len(self)):
            return self
        arrays = {name: getattr(self.cells, name)[some] for name in element_types(cells.Cells)}
        return CellRays(within(self.first, start, stop), fill(cells.Cells, **arrays))

    def parts(self, turn: wp.array, most: float, through: wp.array) -> CellRays | None:
        """Halves of cells, or quarters, of those whose tubes turn more than `most` [rad] along u or v.

        `through`: how many parts the cells have up to each, (n,). None where no cell has any.
        """
        device, views = self.cells.view.device, len(self.first) - 1
        first = upload(self.first, int, device)
        counts = wp.empty(views, dtype=int, device=device)
        wp.launch(cells.share_kernel, views, inputs=[first, through], outputs=[counts], device=device)
        found = CellRays.empty(counts.numpy(), device)
        if not len(found):
            return None
        starts = upload(found.first, int, device)
        inputs = [first, through, self.cells, turn, most, starts]
        wp.launch(cells.parts_kernel, len(self), inputs=inputs, outputs=[found.cells], device=device)
        return found


class CellGrid:
    """Cells of at most `spacing_m` that cover the mesh as each direction sees it, without a rest at its sides.

    They lie in the plane through the body's middle; with a distance as a radar there sees it. They are made when they
    are asked for.
    """

    def __init__(
        self, body: CoherentBody, directions: Directions, spacing_m: float, distance_m: float | None = None
    ) -> None:
        self.device = body.device
        frames = [frame(body, directions, index, spacing_m, distance_m) for index in range(len(directions))]
        low, step, count = (np.stack([each[i] for each in frames]) for i in range(3))
        self.area: NDArray[np.float64] = (step * count).prod(axis=1)
        """Of all cells of each direction [m2]."""
        self.first = _first(count.prod(axis=1))
        self.inputs = [
            upload(self.first, int, self.device),
            upload(low, wp.vec2d, self.device),
            upload(step, wp.vec2d, self.device),
            upload(count.astype(np.int32), wp.vec2i, self.device),
        ]

    def __len__(self) -> int:
        return int(self.first[-1])

    def __getitem__(self, some: slice) -> CellRays:
        start, stop, _ = some.indices(len(self))
        made = allocate(cells.Cells, stop - start, self.device)
        inputs = [*self.inputs, start]
        wp.launch(cells.grid_kernel, stop - start, inputs=inputs, outputs=[made], device=self.device)
        return CellRays(within(self.first, start, stop), made)


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


def within(first: NDArray[np.int32], start: int, stop: int) -> NDArray[np.int32]:
    """The first cell of each direction among those from `start` to `stop`, and the end."""
    return np.clip(first, start, stop) - np.int32(start)


def _first(counts: NDArray[Any]) -> NDArray[np.int32]:
    """The first cell of each direction, and the end, where each has a multiple of `RAYS`."""
    padded = -(-counts.astype(np.int64) // cells.RAYS) * cells.RAYS
    return np.concatenate([[0], np.cumsum(padded)]).astype(np.int32)
