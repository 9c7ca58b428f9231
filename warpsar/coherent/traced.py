"""Tubes on a device: traced, cut where they get too wide, and what they radiate, summed up for each direction.

Nothing of the size of the rays comes to the host, but where derivatives ask for it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.rays import CellGrid, CellRays, within
from warpsar.coherent.records import host, upload
from warpsar.kernels.coherent import cells, radiate, tubes
from warpsar.runtime.memory import default_gib
from warpsar.runtime.structs import allocate

MOST_BOUNCES = 30
TURN = np.pi / 2
"""How wide a tube may get after a curved surface [rad]: half a wavelength, or so much change of phase over half its
footprint. Wider tubes are cut along the side that is too wide."""
LEVELS = 5
"""How many times a side of a tube is halved at most."""
RAYS_TOGETHER = {"cpu": 2**14, "cuda": 2**19}
"""Rays of one launch, with `MOST_BOUNCES`: 80 MB of hits for each thread of the CPU, 2.5 GB on CUDA. A small device
takes fewer."""
HIT_BYTES = 160
_PART_BYTES = {"cpu": 2**24, "cuda": 2**28}
"""Memory for what the chunks of one launch radiate, and for what is kept of the directions of one task."""


class Tracer:
    """Follows rays of a body at some frequencies."""

    def __init__(
        self, body: CoherentBody, k: NDArray[np.float64], stuff: wp.array, bounces: int, levels: int, layers: int
    ) -> None:
        self.body, self.stuff, self.bounces, self.levels, self.layers = body, stuff, bounces, levels, layers
        self.count, self.largest = len(k), float(k.max())
        self.wavenumbers = upload(k, wp.float64, body.device)
        kind = "cpu" if body.device.is_cpu else "cuda"
        together = RAYS_TOGETHER[kind] * MOST_BOUNCES // max(bounces, MOST_BOUNCES)
        if kind == "cuda":
            together = min(together, int(0.25 * default_gib(body.device) * 2**30) // (bounces * HIT_BYTES))
        self.together = max(together - together % cells.RAYS, cells.RAYS)
        self.radiating = max(_PART_BYTES[kind] // (self.count * 2 * 4 * 16), 1) * cells.RAYS
        bytes_of_view = cells.LANES * self.count * layers * 4 * 16 + body.regions.shape[0]
        self.most_views = max(_PART_BYTES[kind] // bytes_of_view, 1)

    def narrowed(self, radars: wp.array, grid: CellGrid, start: int, stop: int) -> Iterator[Judged]:
        """The cells of a grid from `start` to `stop`, and the parts of those that are cut, level by level.

        The parts of many cells wait for one another: a launch of few tubes takes as long as their deepest one.
        """
        waiting: list[list[CellRays]] = [[] for _ in range(self.levels + 2)]
        for first in range(start, stop, self.together):
            yield from self._follow(radars, grid[first : min(first + self.together, stop)], 0, waiting)
        for level in range(1, self.levels + 1):
            yield from self._ripe(radars, level, 1, waiting)

    def _follow(self, radars: wp.array, rays: CellRays, level: int, waiting: list[list[CellRays]]) -> Iterator[Judged]:
        traced = Judged(self, radars, rays, level)
        yield traced
        parts = traced.parts() if level < self.levels else None
        del traced  # with its hits, before there are those of others
        if parts is not None:
            waiting[level + 1].append(parts)
            yield from self._ripe(radars, level + 1, self.together, waiting)

    def _ripe(self, radars: wp.array, level: int, least: int, waiting: list[list[CellRays]]) -> Iterator[Judged]:
        """Follow what waits at a level, in launches of at least so many cells."""
        there = sum(map(len, waiting[level]))
        if there < least:
            return
        rays, stop = CellRays.joined(waiting[level]), there - there % least
        waiting[level] = [rays[stop:]] if stop < there else []
        for first in range(0, stop, self.together):
            yield from self._follow(radars, rays[first : min(first + self.together, stop)], level, waiting)

    def sums(self, radars: wp.array, exact: wp.array, grid: CellGrid, start: int, stop: int) -> Sums:
        """What the cells of a grid from `start` to `stop` add up to."""
        views, device = radars.shape[0], self.body.device
        radiated = wp.zeros((views, cells.LANES, self.count * self.layers, 4), dtype=wp.vec2d, device=device)
        judged = wp.zeros((views, cells.LANES, 1, 3), dtype=wp.vec2d, device=device)
        for traced in self.narrowed(radars, grid, start, stop):
            traced.add(traced.judged, judged, 0, 0, 1)
            traced.radiate(exact, radiated)
            del traced
        amplitude = over_lanes(radiated).reshape(views, self.count, self.layers, 4, 2)
        pairs = over_lanes(judged)[:, 0]
        return Sums(
            amplitude[..., 0] + 1j * amplitude[..., 1],
            *(pairs[:, i, j] for i, j in ((1, 0), (1, 1), (0, 0), (0, 1), (2, 0))),
        )


def over_lanes(total: wp.array) -> NDArray[np.float64]:
    """Partial sums added up: of (views, LANES, m, n) of vec2d an array (views, m, n, 2)."""
    views, _, m, n = total.shape
    out = wp.empty((views, m, n), dtype=wp.vec2d, device=total.device)
    wp.launch(cells.views_kernel, (views, m, n), inputs=[total], outputs=[out], device=total.device)
    found: NDArray[np.float64] = out.numpy()
    return found


@dataclass
class Sums:
    """Sums over tubes, for each direction."""

    amplitude: NDArray[np.complex128]
    """(directions, frequencies, bounces, polarizations); without layers the second bounce holds all further ones."""
    area: NDArray[np.float64]
    """Cross-section of the tubes that meet more than one face [m2]."""
    way: NDArray[np.float64]
    """That, times the way from the first to the last hit [m3]."""
    refined: NDArray[np.float64]
    """Cross-section of the tubes of the grid that are cut [m2]."""
    aliased: NDArray[np.float64]
    """And of those that are too wide even so [m2]."""
    segments: NDArray[np.float64]

    @property
    def terms(self) -> NDArray[np.complex128]:
        """As the terms of a sweep: the first bounce, the sum of the further ones, nothing."""
        zero = np.zeros_like(self.amplitude[:, :, 0])
        first, further = self.amplitude[:, :, 0], self.amplitude[:, :, 1:].sum(axis=2)
        return np.stack([first, further, zero, zero, zero, zero], axis=2)

    def add(self, other: Sums) -> None:
        for each in fields(self):
            getattr(self, each.name)[...] += getattr(other, each.name)


class Traced:
    """Rays with what they hit. They start at `radars`, and are seen from there, or from `receivers` (as many)."""

    def __init__(self, tracer: Tracer, radars: wp.array, rays: CellRays, receivers: wp.array | None = None) -> None:
        self.tracer, self.radars, self.rays = tracer, radars, rays
        body, device, n = tracer.body, tracer.body.device, len(rays)
        self.hits = wp.empty((tracer.bounces, n), dtype=tubes.Hit, device=device)
        self.ends = allocate(cells.TubeEnds, n, device)
        ends = [radars, radars, 0] if receivers is None else [radars, receivers, 1]
        inputs = [body.rays, *ends, rays.cells, body.standoff, tracer.largest, tracer.bounces]
        wp.launch(tubes.trace_kernel, n, inputs=inputs, outputs=[self.hits, self.ends], device=device)

    def found(self) -> tuple[Any, NDArray[np.int32]]:
        """On the host: records of `tubes.Hit`, (n, most of a ray), zero from a ray's count on, and the counts, (n,)."""
        count: NDArray[np.int32] = self.ends.count.numpy()
        most = max(int(count.max(initial=0)), 1)
        hits = host(self.hits[:most]).T.copy()
        hits[np.arange(most) >= count[:, None]] = 0
        return hits, count


class Judged(Traced):
    """Rays of one level, and which of their tubes stay: the others are cut."""

    def __init__(self, tracer: Tracer, radars: wp.array, rays: CellRays, level: int) -> None:
        super().__init__(tracer, radars, rays)
        device, chunks = tracer.body.device, len(rays) // cells.RAYS
        self.kept, self.cuts = (wp.empty(len(rays), dtype=int, device=device) for _ in range(2))
        self.judged = wp.empty((chunks, 1, 1, 3), dtype=wp.vec2d, device=device)
        inputs = [rays.cells, self.ends, TURN, level, tracer.levels]
        outputs = [self.kept, self.cuts, self.judged]
        wp.launch(cells.judge_kernel, chunks, inputs=inputs, outputs=outputs, device=device)

    def parts(self) -> CellRays | None:
        """The parts of the tubes that are cut; None where none is."""
        through = wp.empty_like(self.cuts)
        wp.utils.array_scan(self.cuts, through, inclusive=True)
        return self.rays.parts(self.ends.turn, TURN, through)

    def radiate(self, exact: wp.array, total: wp.array) -> None:
        """Add what the tubes radiate to (directions, LANES, frequencies times bounces, polarizations)."""
        tracer, body, n = self.tracer, self.tracer.body, len(self.rays)
        layers = tracer.layers > 2
        for start in range(0, n, tracer.radiating):
            some = slice(start, min(start + tracer.radiating, n))
            shape = ((some.stop - start) // cells.RAYS, tracer.count)
            part = wp.empty((*shape, 2, 4), dtype=wp.vec2d, device=body.device)
            inputs = [self.radars, tracer.wavenumbers, tracer.stuff, body.face_material, body.region, exact]
            inputs += [self.rays.cells.view[some], self.kept[some], self.hits[:, some], self.ends.count[some]]
            for only in range(tracer.layers) if layers else (-1,):
                wp.launch(radiate.tubes_kernel, shape, inputs=[*inputs, only], outputs=[part], device=body.device)
                bounces = (min(only, 1), only, 1) if layers else (0, 0, 2)
                self.add(part, total, *bounces, start=start)

    def add(self, part: wp.array, total: wp.array, source: int, target: int, bounces: int, start: int = 0) -> None:
        """Add sums of chunks from the ray `start` on to those of the directions; so many bounces from `source` on."""
        device, (chunks, frequencies, _, n) = self.tracer.body.device, part.shape
        first = within(self.rays.first, start, start + chunks * cells.RAYS)
        wp.launch(
            cells.lanes_kernel,
            (*total.shape[:2], frequencies, bounces * n),
            inputs=[upload(first, int, device), part, source, target, total.shape[2] // frequencies],
            outputs=[total],
            device=device,
        )
