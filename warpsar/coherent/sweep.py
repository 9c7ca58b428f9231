"""Amplitudes of a body over directions and frequencies, term by term."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent import rough_models
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions, radar_records
from warpsar.coherent.rays import CellGrid, CellRays
from warpsar.coherent.records import upload
from warpsar.coherent.traced import LEVELS, MOST_BOUNCES, Sums, Tracer, over_lanes
from warpsar.kernels.coherent import (
    borders,
    cells,
    coated_edges,
    edge_waves,
    edges,
    free_lanes,
    radiate,
    rough,
    transmission,
    tubes,
)
from warpsar.kernels.coherent.rough_models import rough_kernel
from warpsar.runtime import threads
from warpsar.runtime.structs import fill
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import bounces

TERMS = ("single", "multibounce", "edges", "rough", "transmission", "edge_waves")
POLARIZATIONS = ("HH", "HV", "VH", "VV")
RAYS_PER_WAVELENGTH = 10.0
_RAYS_OF_TASK = {"cpu": 2**14, "cuda": 2**26}
"""Rays of directions that are worked out together."""
FACE_BYTES = {"cpu": 2**26, "cuda": 2**29}
"""Memory for what faces, edges and scatterers send to the directions of one launch."""


_INSIDE = 12
"""Faces that a tube meets within a solid dielectric: after six ways there and back a tenth of the field is left where
the index is 4 and nothing is lost, less elsewhere."""
_ACROSS = 24.0
"""Tubes across the narrowest width of a curved solid dielectric, at least."""
_PARTED = 96.0
"""The same of a flat one, where the rays of a tube would part. Others are as wide as outside, over the index."""


@dataclass(frozen=True)
class AmplitudeSweep:
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
) -> AmplitudeSweep:
    """What the body sends back to each direction (n) at each frequency [Hz], ascending, in all polarizations.

    `distance_m`: from the radar to the reference point; a plane wave without. The geometry of a ray serves all
    frequencies and polarizations. `layers`: each number of bounces by itself, too; that takes longer. `compare`: the
    error of the spacing, by tubes of twice the width; that takes a quarter longer. The result does not depend on the
    number of threads.
    """
    k = 2.0 * np.pi * np.asarray(frequencies_hz, float) / SPEED_OF_LIGHT
    spacing = float(2.0 * np.pi / k.max() / rays_per_wavelength)
    worker = Worker(body, k, spacing, terms, max_bounces, levels, distance_m, layers, compare)
    counts = [tubes_of(body, directions, i, spacing) for i in range(len(directions))]
    tasks = [partial(worker, directions[some]) for some in batches_of(counts, worker.task, worker.tracer.most_views)]
    found = []
    for part in threads.ordered(tasks, body.device):
        found.append(part)
        if progress is not None:
            progress.update(len(part.refined))
    turn = shift(body, directions, k, distance_m)[:, :, None, None]
    return AmplitudeSweep(
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


def tubes_of(body: CoherentBody, directions: Directions, i: int, spacing: float) -> int:
    """Tubes of `spacing` [m] of direction number `i`, before any is cut."""
    ends = body.extents([directions.u[i], directions.v[i]])
    return int(np.prod(np.ceil((ends[:, 1] - ends[:, 0]) / spacing).clip(1)))


def batches_of(counts: Sequence[int], rays: int, views: int) -> Iterator[slice]:
    """Directions that go together, of so many rays and views at most: the same for any number of threads."""
    start, there = 0, 0
    for i, count in enumerate(counts):
        if i > start and (there + count > rays or i - start == views):
            yield slice(start, i)
            start, there = i, 0
        there += count
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
        device, kind = body.device, "cpu" if body.device.is_cpu else "cuda"
        most = bounces(terms, max_bounces)
        self.stuff = body.stuff(len(k))
        others = "rough" in terms and bool(body.patches.kind.any())
        self.tables = rough_models.tables_of(body.materials, k, device) if others else None
        self.tracer = Tracer(body, k, self.stuff, most, levels, max(most, 2) if layers else 2)
        self.wavenumbers, self.task = self.tracer.wavenumbers, _RAYS_OF_TASK[kind]
        regions = body.shape.regions
        self.samples = upload(regions.sample, wp.vec3d, device)
        self.sample_normals = upload(regions.normal[regions.sample_region], wp.vec3d, device)
        starts = np.searchsorted(regions.sample_region, np.arange(len(regions.area) + 1))
        self.sample_start = upload(starts, int, device)
        pieces = body.edge_pieces(np.pi / k.max())
        self.edges = pieces
        if pieces.shape[0]:
            packed = pieces.numpy()
            outward = -(packed["first"] + packed["second"])
            outward /= np.linalg.norm(outward, axis=1)[:, None]
            self.edge_middle = upload(packed["middle"], wp.vec3d, device)
            self.edge_outward = upload(outward, wp.vec3d, device)
            if "edge_waves" in terms:
                thin = 2.0 * np.pi * edge_waves.THIN / k.min()
                self.rims, self.opposite = body.plate_rims(np.pi / k.max(), thin)
        self.views_together = max(FACE_BYTES[kind] // self._bytes_of_view(), 1)

    def _bytes_of_view(self) -> int:
        """What faces, edges and scatterers take of a direction: what it sees, and the sums of their chunks."""
        points = max(self.samples.shape[0], self.edges.shape[0], len(self.body.patches))
        return points + points * len(self.k) * 4 * 16 // min(radiate.REGIONS, edges.EDGES, rough.SCATTERERS) + 1

    def __call__(self, directions: Directions) -> AmplitudeSweep:
        body = self.body
        radars = upload(radar_records(directions, body.origin, self.distance), tubes.TubeRadar, body.device)
        exact = self.lit_regions(radars)
        faces = self.faces(radars, exact)
        grid, found = self.tubes(directions, radars, exact, self.spacing)
        wanted = np.array([term in self.terms for term in TERMS])
        amplitude = faces + found.terms
        if "transmission" in self.terms and body.has_solids:
            amplitude[:, :, TERMS.index("transmission")] = self.transmission(directions, radars)
        amplitude[:, :, ~wanted] = 0.0
        error = None
        if self.compare:
            change = found.terms - self.tubes(directions, radars, exact, 2.0 * self.spacing)[1].terms
            error = np.abs(change[:, :, wanted].sum(axis=2))
        with np.errstate(invalid="ignore", divide="ignore"):
            number = found.area**2 / found.way  # area over the mean way
        whole = np.where(grid.area > 0.0, grid.area, 1.0)  # a plate from its side has no tubes
        return AmplitudeSweep(
            amplitude,
            found.amplitude[:, :, 1:] if self.layers else None,
            number[:, None] * self.k / (2.0 * np.pi),
            self.spacing,
            found.refined / whole,
            found.aliased / whole,
            int(found.segments.sum()),
            error,
        )

    def free(self, radars: wp.array, points: wp.array, normals: wp.array, both_sides: bool) -> wp.array:
        """Which points each of the radars sees, (radars, points)."""
        device, (views, count) = self.body.device, (radars.shape[0], points.shape[0])
        seen = wp.empty((views, count), dtype=wp.uint8, device=device)
        inputs = [self.body.rays, radars, points, normals, int(both_sides)]
        kernel, each = (free_lanes.free_kernel, free_lanes.LANES) if device.is_cpu else (tubes.free_kernel, 1)
        wp.launch(kernel, (views, -(-count // each)), inputs=inputs, outputs=[seen], device=device)
        return seen

    def lit_regions(self, radars: wp.array) -> wp.array:
        """Which flat regions each direction sees as a whole, (directions, regions)."""
        device, views, regions = self.body.device, radars.shape[0], self.sample_start.shape[0] - 1
        exact = wp.zeros((views, max(regions, 1)), dtype=wp.uint8, device=device)
        if not regions or self.distance is not None:  # the closed form is that of a plane wave
            return exact
        for some in self._views(views):
            seen = self.free(radars[some], self.samples, self.sample_normals, both_sides=True)
            shape = seen.shape[0], regions
            wp.launch(cells.whole_kernel, shape, inputs=[self.sample_start, seen], outputs=[exact[some]], device=device)
        return exact

    def faces(self, radars: wp.array, exact: wp.array) -> NDArray[np.complex128]:
        """What flat regions, edges and scatterers send, (directions, frequencies, terms, 4)."""
        shape = (radars.shape[0], len(self.k), len(TERMS), 4)
        total = wp.zeros(shape, dtype=wp.vec2d, device=self.body.device)
        for some in self._views(radars.shape[0]):
            self._faces(radars[some], exact[some], total[some])
        parts = total.numpy()
        whole: NDArray[np.complex128] = parts[..., 0] + 1j * parts[..., 1]
        return whole

    def _views(self, views: int) -> list[slice]:
        step = self.views_together
        return [slice(start, min(start + step, views)) for start in range(0, views, step)]

    def _faces(self, radars: wp.array, exact: wp.array, total: wp.array) -> None:
        body, start = self.body, [radars, self.wavenumbers]
        for term, slabs in ((0, 0), (2, 1)):
            if (count := body.regions.shape[0]) and TERMS[term] in self.terms and (body.has_slabs or not slabs):
                inputs = [*start, self.stuff, exact, body.regions, body.middle, body.along, slabs]
                self._add(radiate.regions_kernel, -(-count // radiate.REGIONS), inputs, total, term)
        if (count := self.edges.shape[0]) and {"edges", "edge_waves"} & set(self.terms):
            seen = self.free(radars, self.edge_middle, self.edge_outward, both_sides=False)
            inputs, chunks = [*start, self.edges, seen], -(-count // edges.EDGES)
            if "edges" in self.terms and not body.has_coats:
                self._add(edges.edges_kernel, chunks, inputs, total, TERMS.index("edges"))
            elif "edges" in self.terms:
                inputs = [*inputs, self.stuff]
                self._add(coated_edges.coated_edges_kernel, chunks, inputs, total, TERMS.index("edges"))
            if "edge_waves" in self.terms and (count := self.rims.shape[0]):
                inputs = [*start, self.rims, self.opposite, seen]
                chunks, term = -(-count // edges.EDGES), TERMS.index("edge_waves")
                self._add(edge_waves.edge_waves_kernel, chunks, inputs, total, term)
        if (places := body.scatterers) is not None and "rough" in self.terms:
            seen = self.free(radars, body.scatterer_points, body.scatterer_normals, both_sides=True)
            for group in body.scatterer_groups:
                kernel, more = group.launched(rough.rough_kernel, rough_kernel, self.tables)
                inputs = [*start, body.surfaces, body.variant, places[group.part], seen[:, group.part], *more]
                self._add(kernel, -(-(group.part.stop - group.part.start) // rough.SCATTERERS), inputs, total, 3)

    def _add(self, kernel: wp.Kernel, chunks: int, inputs: list[Any], total: wp.array, term: int) -> None:
        """Add the chunks of a launch to a term."""
        device, shape = self.body.device, (*total.shape[:2], chunks)
        part = wp.empty((*shape, 4), dtype=wp.vec2d, device=device)
        wp.launch(kernel, shape, inputs=inputs, outputs=[part], device=device)
        shape = (*total.shape[:2], 4)
        wp.launch(cells.chunks_kernel, shape, inputs=[part, term], outputs=[total], device=device)

    def transmission(self, directions: Directions, radars: wp.array) -> NDArray[np.complex128]:
        """What comes out of solid dielectrics, (directions, frequencies, 4).

        A tube of a flat body holds for any width if all of it meets the same surfaces. So it is halved only where it
        does not: a thin plate would otherwise be cut all over into tubes a fraction of its thickness wide.
        """
        body, device, views = self.body, self.body.device, len(directions)
        spacing, curved = self.spacing / body.largest_index, bool(body.shape.curved.any())
        finest = min(spacing, body.narrowest / (_ACROSS if curved else _PARTED))
        grid = CellGrid(body, directions, finest if curved else spacing, self.distance)
        total = wp.zeros((views, cells.LANES, len(self.k), 4), dtype=wp.vec2d, device=device)
        surface = upload(body.shape.surface, int, device)
        marked = fill(borders.Marked, body=body.rays, surface=surface, standoff=body.standoff, most=_INSIDE)
        for rays, kept in self._halved(marked, radars, grid, (1.0 + 1e-6) * finest):  # a grid's cells round
            shape = (len(rays) // cells.RAYS, len(self.k))
            part = wp.empty((*shape, 1, 4), dtype=wp.vec2d, device=device)
            inputs = [body.rays, radars, self.wavenumbers, self.stuff, body.face_material]
            inputs += [rays.cells, kept, body.standoff, _INSIDE]
            wp.launch(transmission.transmission_kernel, shape, inputs=inputs, outputs=[part], device=device)
            first = upload(rays.first, int, device)
            wp.launch(
                cells.lanes_kernel, (*total.shape[:3], 4), inputs=[first, part, 0, 0, 1], outputs=[total], device=device
            )
        pairs = over_lanes(total)
        found: NDArray[np.complex128] = pairs[..., 0] + 1j * pairs[..., 1]
        return found

    def _halved(
        self, marked: Any, radars: wp.array, grid: CellGrid | CellRays, finest: float
    ) -> Iterator[tuple[CellRays, wp.array]]:
        """Cells, and which of them stay; then the halves of those that are cut, down to `finest` [m]."""
        body, device, together = self.body, self.body.device, self.tracer.together
        for start in range(0, len(grid), together):
            rays = grid[start : min(start + together, len(grid))]
            kept, parts = (wp.empty(len(rays), dtype=int, device=device) for _ in range(2))
            cut = wp.empty(len(rays), dtype=wp.vec2d, device=device)
            inputs = [marked, radars, self.stuff, body.face_material, rays.cells, finest]
            wp.launch(transmission.halves_kernel, len(rays), inputs=inputs, outputs=[kept, cut, parts], device=device)
            yield rays, kept
            through = wp.empty_like(parts)
            wp.utils.array_scan(parts, through, inclusive=True)
            if (smaller := rays.parts(cut, 0.5, through)) is not None:
                yield from self._halved(marked, radars, smaller, finest)

    def grid(self, directions: Directions, spacing: float) -> CellGrid:
        return CellGrid(self.body, directions, spacing, self.distance)

    def tubes(self, directions: Directions, radars: wp.array, exact: wp.array, spacing: float) -> tuple[CellGrid, Sums]:
        """The grid of some directions, and what its tubes add up to. The many tubes of one direction go in parts."""
        grid = self.grid(directions, spacing)
        task = self.task - self.task % cells.RAYS
        tasks = [
            partial(self.tracer.sums, radars, exact, grid, start, min(start + task, len(grid)))
            for start in range(0, len(grid), task)
        ]
        first, *others = threads.ordered(tasks, self.body.device)
        for other in others:
            first.add(other)
        return grid, first
