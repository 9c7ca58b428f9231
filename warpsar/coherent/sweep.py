"""Amplitudes of a body over directions and frequencies, term by term."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent import rays as cells
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions, radar_records
from warpsar.coherent.records import upload
from warpsar.kernels.coherent import edges, radiate, rough, tubes
from warpsar.runtime import threads
from warpsar.world.frame import SPEED_OF_LIGHT

TERMS = ("single", "multibounce", "edges", "rough")
POLARIZATIONS = ("HH", "HV", "VH", "VV")
RAYS_PER_WAVELENGTH = 10.0
MOST_BOUNCES = 30
TURN = np.pi / 2
"""How wide a tube may get after a curved surface [rad]: half a wavelength, or so much change of phase over half its
footprint. Wider tubes are cut along the side that is too wide."""
LEVELS = 5
"""How many times a side of a tube is halved at most."""
_RAYS_TOGETHER = {"cpu": 2**14, "cuda": 2**19}
"""Rays of one launch, with `MOST_BOUNCES`: 80 MB of hits for each thread of the CPU, 2.5 GB on CUDA."""


@dataclass(frozen=True)
class Sweep:
    """Amplitudes over directions and frequencies."""

    amplitude: NDArray[np.complex128]
    """A [m], shape (directions, frequencies, terms, polarizations), in the order of `TERMS` and `POLARIZATIONS`."""
    bounces: NDArray[np.complex128] | None
    """The same of each number of bounces, from 2 on: (directions, frequencies, bounces, polarizations)."""
    fresnel_number: NDArray[np.float64]
    """(directions, frequencies); NaN where no ray meets the body twice."""
    spacing_m: float
    """Width of a tube at its start."""
    refined: NDArray[np.float64]
    """Share of the tubes that got too wide and were cut, (directions,)."""
    aliased: NDArray[np.float64]
    """Share of the tubes that are too wide even so, (directions,)."""
    segments: int
    """Rays times the hits of each."""
    spacing_error: NDArray[np.float64] | None
    """How far tubes of twice the width take the amplitude [m], (directions, frequencies, polarizations)."""


def sweep(
    body: CoherentBody,
    directions: Directions,
    frequencies_hz: Sequence[float],
    *,
    terms: Sequence[str] = TERMS,
    max_bounces: int = MOST_BOUNCES,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
    levels: int = LEVELS,
    distance_m: float | None = None,
    layers: bool = False,
    compare: bool = False,
    progress: Any = None,
) -> Sweep:
    """What the body sends back to each direction (n) at each frequency [Hz], ascending, in all polarizations.

    `distance_m`: from the radar to the reference point; a plane wave without. The geometry of a ray serves all
    frequencies and polarizations. `layers`: each number of bounces by itself, too; that takes longer. `compare`: the
    error of the spacing, by tubes of twice the width; that takes a quarter longer. The result does not depend on the
    number of threads.
    """
    k = 2.0 * np.pi * np.asarray(frequencies_hz, float) / SPEED_OF_LIGHT
    spacing = float(2.0 * np.pi / k.max() / rays_per_wavelength)
    worker = Worker(body, k, spacing, terms, max_bounces, levels, distance_m, layers, compare)
    counts = [_cells(body, directions, i, spacing) for i in range(len(directions))]
    tasks = [partial(worker, directions[some]) for some in _batches(counts, worker.together)]
    found = []
    for part in threads.ordered(tasks, body.device):
        found.append(part)
        if progress is not None:
            progress.update(len(part.refined))
    turn = shift(body, directions, k, distance_m)[:, :, None, None]
    return Sweep(
        np.concatenate([part.amplitude for part in found]) * turn,
        np.concatenate([part.bounces for part in found]) * turn if layers else None,
        np.concatenate([part.fresnel_number for part in found]),
        spacing,
        np.concatenate([part.refined for part in found]),
        np.concatenate([part.aliased for part in found]),
        sum(part.segments for part in found),
        np.concatenate([part.spacing_error for part in found]) if compare else None,
    )


def shift(
    body: CoherentBody, directions: Directions, k: NDArray[np.float64], distance_m: float | None
) -> NDArray[np.complex128]:
    """The kernels' phase is zero in the body's middle, the result's at the reference point: (directions, frequencies).

    With a distance the way to the radar already starts from the reference point."""
    way = 2j * (directions.s @ body.origin)[:, None]
    factor: NDArray[np.complex128] = np.exp(way * (k if distance_m is None else 0.0 * k))
    return factor


def _cells(body: CoherentBody, directions: Directions, i: int, spacing: float) -> int:
    ends = body.extents([directions.u[i], directions.v[i]])
    return int(np.prod(np.ceil((ends[:, 1] - ends[:, 0]) / spacing).clip(1)))


def _batches(counts: Sequence[int], together: int) -> Iterator[slice]:
    """Directions whose rays go together: the same for any number of threads."""
    start, rays = 0, 0
    for i, count in enumerate(counts):
        if i > start and rays + count > together:
            yield slice(start, i)
            start, rays = i, 0
        rays += count
    yield slice(start, len(counts))


class Worker:
    """Works out some directions; holds what all of them share."""

    def __init__(
        self,
        body: CoherentBody,
        k: NDArray[np.float64],
        spacing: float,
        terms: Sequence[str],
        max_bounces: int,
        levels: int,
        distance_m: float | None,
        layers: bool = False,
        compare: bool = False,
    ) -> None:
        self.body, self.k, self.spacing, self.terms, self.distance = body, k, spacing, terms, distance_m
        self.layers, self.compare = layers, compare
        self.bounces, self.levels = max_bounces if "multibounce" in terms else 1, levels
        self.layer_count = max(self.bounces, 2) if layers else 2
        device = body.device
        kind = "cpu" if device.is_cpu else "cuda"
        together = _RAYS_TOGETHER[kind] * MOST_BOUNCES // max(self.bounces, MOST_BOUNCES)
        self.together = max(together - together % radiate.RAYS, radiate.RAYS)
        self.wavenumbers = upload(k, wp.float64, device)
        self.stuff = body.stuff(len(k))
        regions = body.shape.regions
        self.samples = upload(regions.sample, wp.vec3d, device)
        self.sample_normals = upload(regions.normal[regions.sample_region], wp.vec3d, device)
        self.sample_start = np.searchsorted(regions.sample_region, np.arange(len(regions.area)))
        pieces = body.edge_pieces(np.pi / k.max())
        self.edges = pieces
        if pieces.shape[0]:
            packed = pieces.numpy()
            outward = -(packed["first"] + packed["second"])
            outward /= np.linalg.norm(outward, axis=1)[:, None]
            self.edge_middle = upload(packed["middle"], wp.vec3d, device)
            self.edge_outward = upload(outward, wp.vec3d, device)

    def __call__(self, directions: Directions) -> Sweep:
        body, device = self.body, self.body.device
        radars = upload(radar_records(directions, body.origin, self.distance), tubes.Radar, device)
        amplitude = np.zeros((len(directions), len(self.k), len(TERMS), 4), np.complex128)
        exact = self.lit_regions(radars)
        for term, slabs in ((0, 0), (2, 1)):
            if body.regions.shape[0] and TERMS[term] in self.terms and (body.has_slabs or not slabs):
                amplitude[:, :, term] = self.chunks(
                    radiate.regions_kernel,
                    radiate.REGIONS,
                    body.regions.shape[0],
                    [radars, self.wavenumbers, self.stuff, exact, body.regions, body.middle, body.along, slabs],
                    len(directions),
                )
        if self.edges.shape[0] and "edges" in self.terms:
            seen = self.free(radars, self.edge_middle, self.edge_outward, both_sides=False)
            amplitude[:, :, 2] += self.chunks(
                edges.edges_kernel,
                edges.EDGES,
                self.edges.shape[0],
                [radars, self.wavenumbers, self.edges, seen],
                len(directions),
            )
        if (places := body.scatterers) is not None and "rough" in self.terms:
            seen = self.free(radars, body.scatterer_points, body.scatterer_normals, both_sides=True)
            amplitude[:, :, 3] = self.chunks(
                rough.rough_kernel,
                rough.SCATTERERS,
                places.shape[0],
                [radars, self.wavenumbers, body.surfaces, body.variant, places, seen],
                len(directions),
            )
        found = self.tubes(directions, radars, exact, self.spacing)
        wanted = np.array([term in self.terms for term in TERMS])
        amplitude += found.amplitude
        amplitude[:, :, ~wanted] = 0.0
        error = None
        if self.compare:
            change = found.amplitude - self.tubes(directions, radars, exact, 2.0 * self.spacing).amplitude
            error = np.abs(change[:, :, wanted].sum(axis=2))
        return replace(found, amplitude=amplitude, spacing_error=error)

    def free(self, radars: wp.array, points: wp.array, normals: wp.array, both_sides: bool) -> wp.array:
        seen = wp.empty((radars.shape[0], points.shape[0]), dtype=wp.uint8, device=self.body.device)
        inputs = [self.body.rays, radars, points, normals, int(both_sides)]
        wp.launch(tubes.free_kernel, seen.shape, inputs=inputs, outputs=[seen], device=self.body.device)
        return seen

    def lit_regions(self, radars: wp.array) -> wp.array:
        """Which flat regions each direction sees as a whole, (directions, regions)."""
        device, views = self.body.device, radars.shape[0]
        if not len(self.sample_start) or self.distance is not None:  # the closed form is that of a plane wave
            return wp.zeros((views, max(len(self.sample_start), 1)), dtype=wp.uint8, device=device)
        seen = self.free(radars, self.samples, self.sample_normals, both_sides=True).numpy()
        whole = np.minimum.reduceat(seen, self.sample_start, axis=1)
        return upload(whole, wp.uint8, device)

    def chunks(
        self, kernel: wp.Kernel, together: int, count: int, inputs: list[Any], views: int
    ) -> NDArray[np.complex128]:
        """The sum over chunks of a launch, shape (directions, frequencies, 4)."""
        shape = (views, len(self.k), -(-count // together))
        out = wp.empty((*shape, 4), dtype=wp.vec2d, device=self.body.device)
        wp.launch(kernel, shape, inputs=inputs, outputs=[out], device=self.body.device)
        total: NDArray[np.complex128] = _complex(out).sum(axis=2)
        return total

    def tubes(self, directions: Directions, radars: wp.array, exact: wp.array, spacing: float) -> Sweep:
        """What the tubes of some directions radiate. The many tubes of one direction go in blocks."""
        rays = cells.grid(self.body, directions, spacing, self.distance)
        # Several directions fit into one block; a block never holds parts of them.
        step = max(self.together, len(rays)) if len(directions) > 1 else self.together
        tasks = [partial(self.block, radars, exact, rays[i : i + step]) for i in range(0, len(rays), step)]
        total = _Block.empty(len(directions), len(self.k), self.layer_count)
        for part in threads.ordered(tasks, self.body.device):
            total.add(part)
        with np.errstate(invalid="ignore", divide="ignore"):
            number = total.area**2 / total.way  # area over the mean way
        first = np.bincount(rays.view, rays.size.prod(axis=1), len(directions))
        amplitude = np.zeros((len(directions), len(self.k), len(TERMS), 4), np.complex128)
        amplitude[:, :, 0], further = total.amplitude[:, :, 0], total.amplitude[:, :, 1:]
        amplitude[:, :, 1] = further.sum(axis=2)
        fresnel = number[:, None] * self.k / (2.0 * np.pi)
        bounces = further if self.layers else None
        first = np.where(first > 0.0, first, 1.0)  # a plate from its side has no tubes
        shares = total.refined / first, total.aliased / first
        return Sweep(amplitude, bounces, fresnel, spacing, *shares, int(total.segments), None)

    def block(self, radars: wp.array, exact: wp.array, rays: cells.Rays) -> _Block:
        """Trace tubes, cut those that get too wide, and add up what they radiate."""
        views = radars.shape[0]
        total = _Block.empty(views, len(self.k), self.layer_count)
        for level, some, traced, kept in self.narrowed(radars, rays):
            area = some.size.prod(axis=1)
            total.refined += np.bincount(some.view, area * ~kept, views) if level == 0 else 0.0
            total.aliased += np.bincount(some.view, area * (kept & (traced.turn > TURN)), views)
            total.amplitude += traced.radiated(exact, kept, views)
            cross = area * (kept & (traced.count > 1))
            total.area += np.bincount(some.view, cross, views)
            total.way += np.bincount(some.view, cross * traced.span, views)
            total.segments += int(traced.count.sum())
        return total

    def narrowed(
        self, radars: wp.array, rays: cells.Rays
    ) -> Iterator[tuple[int, cells.Rays, Traced, NDArray[np.bool_]]]:
        """Level, rays, what they hit, and which of them stay: the others are cut, and their parts come later."""
        waiting = [(0, rays)]
        while waiting:
            level, some = waiting.pop()
            traced = Traced(self, radars, some)
            used = some.used != 0
            cut = (traced.sides > TURN) & used[:, None] & (level < self.levels)
            yield level, some, traced, used & ~cut.any(axis=1)
            if cut.any():
                parts = cells.children(some, cut, radars.shape[0])
                waiting += [(level + 1, parts[i : i + self.together]) for i in range(0, len(parts), self.together)]


@dataclass
class _Block:
    """Sums over tubes, for each direction."""

    amplitude: NDArray[np.complex128]
    """(directions, frequencies, bounces, polarizations); without layers the second bounce holds all further ones."""
    area: NDArray[np.float64]
    """Cross-section of the tubes that meet more than one face [m2]."""
    way: NDArray[np.float64]
    """That, times the way from the first to the last hit [m3]."""
    refined: NDArray[np.float64]
    aliased: NDArray[np.float64]
    segments: int

    @classmethod
    def empty(cls, views: int, frequencies: int, bounces: int) -> _Block:
        area, way, refined, aliased = np.zeros((4, views))
        return cls(np.zeros((views, frequencies, bounces, 4), np.complex128), area, way, refined, aliased, 0)

    def add(self, other: _Block) -> None:
        self.amplitude += other.amplitude
        self.area += other.area
        self.way += other.way
        self.refined += other.refined
        self.aliased += other.aliased
        self.segments += other.segments


class Traced:
    """Rays with what they hit."""

    def __init__(self, worker: Worker, radars: wp.array, rays: cells.Rays) -> None:
        self.worker, self.radars = worker, radars
        device, body, n = worker.body.device, worker.body, len(rays)
        self.view = upload(rays.view, int, device)
        self.hits = wp.empty((n, worker.bounces), dtype=tubes.Hit, device=device)
        self.counts = wp.empty(n, dtype=int, device=device)
        span = wp.empty(n, dtype=wp.float64, device=device)
        turn = wp.empty(n, dtype=wp.vec2d, device=device)
        place = upload(rays.place, wp.vec2d, device)
        size = upload(rays.size, wp.vec2d, device)
        standoff = body.standoff
        wp.launch(
            tubes.trace_kernel,
            n,
            inputs=[body.rays, radars, self.view, place, size, standoff, float(worker.k.max()), worker.bounces],
            outputs=[self.hits, self.counts, span, turn],
            device=device,
        )
        self.count, self.span, self.sides = self.counts.numpy(), span.numpy(), turn.numpy()
        self.turn = self.sides.max(axis=1)
        self.chunk_view = rays.view[:: radiate.RAYS]

    def radiated(self, exact: wp.array, used: NDArray[np.bool_], views: int) -> NDArray[np.complex128]:
        """(directions, frequencies, bounces, polarizations), as `_Block` holds them."""
        worker = self.worker
        total = np.zeros((views, len(worker.k), worker.layer_count, 4), np.complex128)
        if not worker.layers:
            self._add(total[:, :, :2], exact, used, -1)
        else:
            for b in range(int(self.count.max(initial=0))):
                self._add(total[:, :, b : b + 1], exact, used, b)
        return total

    def _add(self, total: NDArray[np.complex128], exact: wp.array, used: NDArray[np.bool_], only: int) -> None:
        """Add the first and further bounces to `total`, or the one bounce `only`."""
        worker, body = self.worker, self.worker.body
        shape = (len(self.chunk_view), len(worker.k))
        out = wp.empty((*shape, 2, 4), dtype=wp.vec2d, device=body.device)
        wp.launch(
            radiate.tubes_kernel,
            shape,
            inputs=[
                self.radars,
                worker.wavenumbers,
                worker.stuff,
                body.face_material,
                body.region,
                exact,
                self.view,
                upload(used.astype(np.int32), int, body.device),
                self.hits,
                self.counts,
                only,
            ],
            outputs=[out],
            device=body.device,
        )
        parts = _complex(out)
        np.add.at(total, self.chunk_view, parts if only < 0 else parts[:, :, [min(only, 1)]])


def _complex(array: wp.array) -> NDArray[np.complex128]:
    parts = array.numpy()
    whole: NDArray[np.complex128] = parts[..., 0] + 1j * parts[..., 1]
    return whole
