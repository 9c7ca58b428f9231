"""What a body sends back toward one place of the sensor: scatterers of rough faces, edges and tubes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent import rays as cells
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.coherent.patches import PatchesOnDevice, PlacedScatterers
from warpsar.coherent.records import host, records, upload
from warpsar.coherent.rough_models import load
from warpsar.coherent.sweep import Worker
from warpsar.coherent.traced import TURN, Traced
from warpsar.kernels import collection as kernels
from warpsar.kernels.coherent import tubes
from warpsar.kernels.coherent.rough_models import rough_places_kernel
from warpsar.runtime import threads
from warpsar.runtime.structs import fill
from warpsar.surface.bistatic import log_factorials

F64 = NDArray[np.float64]
COARSE = 16
"""Cells of the first, coarse tracing are so many tubes wide. It finds where smooth faces and second bounces are."""
FAINT = 1e-6
"""Power of a tube, as a share of the strongest one's of its `GROUP`, under which it is left out: -60 dB."""
GROUP = 64
"""Coarse cells that are traced together at least: what is left out does not depend on the memory."""

_TOGETHER, _TOGETHER_CUDA = 2**15, 2**22
"""Rough places that a thread of the CPU takes at a time, and a launch on CUDA."""


@dataclass(frozen=True)
class Places:
    """Scatterers about the body's middle (n, 3) [m], amplitudes (n, 4) [m] without the way's phase, and faces (n,)."""

    point: F64
    amplitude: NDArray[np.complex64]
    face: NDArray[np.int64]


def sight(body: CoherentBody, *places_m: F64) -> tuple[Directions, wp.array]:
    """The direction to a sensor at a place (3,) [m] about the reference point, and the kernels' radar.

    Of two places, those of transmitter and receiver: both directions, and two radars. Each has its own H and V.
    """
    place = np.array(places_m)
    distance = np.linalg.norm(place, axis=1)
    s = place / distance[:, None]
    level = np.hypot(s[:, 0], s[:, 1])[:, None]
    across = np.stack([s[:, 1], -s[:, 0], np.zeros(len(s))], axis=1)
    u = np.where(level > 1e-12, across / np.maximum(level, 1e-12), [1.0, 0.0, 0.0])
    ends = Directions(s, u, np.cross(-u, s))
    made = records(tubes.TubeRadar, len(s))
    made["s"], made["u"], made["v"] = s, u, ends.v
    made["near"], made["distance"], made["place"] = 1, distance, place - body.origin
    return ends, upload(made, tubes.TubeRadar, body.device)


def worker_of(body: CoherentBody, k: float, terms: tuple[str, ...], max_bounces: int, rays: float) -> Worker:
    """What all directions share, for sensors at a distance."""
    spacing = 2.0 * np.pi / k / rays
    return Worker(body, np.array([k]), spacing, terms, max_bounces, 0, 1.0)


@dataclass(frozen=True)
class SeenPlaces:
    """Rough places on a device as a sensor sees them: amplitudes (n, 4) [m] without the way's phase, 0 where hidden."""

    placed: PlacedScatterers
    amplitude: wp.array


def rough_amplitudes(worker: Worker, radar: wp.array, placed: PlacedScatterers) -> wp.array:
    """What some rough places send back, (n, 4) on the device, 0 where they are not seen: of two radars by both.

    Two radars are for places of `ka_spm` alone.
    """
    body, device = worker.body, worker.body.device
    out = wp.zeros((len(placed), 4), dtype=wp.vec2, device=device)
    seen = worker.free(radar, placed.points, placed.normals, both_sides=True)
    for group in placed.groups:
        part = group.part
        if radar.shape[0] > 1:
            inputs = [radar, float(worker.k[0]), body.surfaces, placed.scatterers[part], seen[:, part]]
            kernel = kernels.rough_places_apart_kernel
            wp.launch(kernel, part.stop - part.start, inputs=inputs, outputs=[out[part]], device=device)
            continue
        kernel, more = group.launched(kernels.rough_places_kernel, rough_places_kernel, worker.tables)
        inputs = [radar, float(worker.k[0]), body.surfaces, body.variant, placed.scatterers[part], seen[:, part], *more]
        wp.launch(kernel, part.stop - part.start, inputs=inputs, outputs=[out[part]], device=device)
    return out


def rough_seen(
    worker: Worker, radar: wp.array, there: PatchesOnDevice, some: slice, together: int
) -> Iterator[SeenPlaces]:
    """Rough places from one number to another, placed and seen in parts; at most `together` are held at a time."""
    device = worker.body.device

    def part(first: int, last: int) -> SeenPlaces:
        placed = there.placed(slice(first, last))
        return SeenPlaces(placed, rough_amplitudes(worker, radar, placed))

    load(worker.body.patches.kind, rough_places_kernel, device)
    step = min(_TOGETHER if device.is_cpu else _TOGETHER_CUDA, max(together, 1))
    batch = max(together // step, 1) * step
    for start in range(some.start, some.stop, batch):
        end = min(start + batch, some.stop)
        tasks = [partial(part, first, min(first + step, end)) for first in range(start, end, step)]
        yield from threads.ordered(tasks, device)


def edge_places(worker: Worker, radar: wp.array) -> Places:
    """The pieces of edges that the sensor sees."""
    device = worker.body.device
    seen = worker.free(radar, worker.edge_middle, worker.edge_outward, both_sides=False)
    out = wp.zeros((worker.edges.shape[0], 4), dtype=wp.vec2, device=device)
    inputs = [radar, float(worker.k[0]), worker.edges, seen]
    kernel = kernels.edge_places_kernel
    if worker.body.has_coats:
        kernel, inputs = kernels.coated_edge_places_kernel, [*inputs, worker.stuff]
    wp.launch(kernel, out.shape[0], inputs=inputs, outputs=[out], device=device)
    which = worker.body.cuts(np.pi / float(worker.k.max()))[0]
    return _kept(worker.edge_middle.numpy(), complex_of(out), worker.body.shape.wedges.face[which, 0])


@dataclass(frozen=True)
class TubeTally:
    """How many tubes there are, and how many are too wide after a curved face; and the power of both [m2]."""

    tubes: int = 0
    wide: int = 0
    power: float = 0.0
    wide_power: float = 0.0

    def __add__(self, other: TubeTally) -> TubeTally:
        return TubeTally(
            self.tubes + other.tubes,
            self.wide + other.wide,
            self.power + other.power,
            self.wide_power + other.wide_power,
        )

    @property
    def share(self) -> float:
        """Of the tubes, those that are too wide."""
        return self.wide / max(self.tubes, 1)

    @property
    def power_share(self) -> float:
        """Of the power of all tubes, that of those that are too wide."""
        return self.wide_power / self.power if self.power > 0.0 else 0.0


class CoarseCells:
    """The coarse cells of a place of the sensor, by which it is found out where tubes are worth their time.

    `places_m`: where tubes start, and where their hits are seen from, if elsewhere, (3,) each [m] about the reference
    point; `rates`: how fast both directions turn, (3,) each. Tubes start at the transmitter, or with `returned` at the
    receiver: then they are those whose first hit scatters diffusely, gone through the other way round.
    """

    def __init__(
        self, worker: Worker, places_m: Sequence[F64], rates: Sequence[F64], *, returned: bool = False
    ) -> None:
        self.worker, self.returned = worker, returned
        direction, self.radars = sight(worker.body, *places_m)
        distance_m = float(np.linalg.norm(places_m[0]))
        self.radar = self.radars[:1]
        self.rates = fill(kernels.Rates, transmitter=wp.vec3d(*rates[0]), receiver=wp.vec3d(*rates[-1]))
        self.low, self.step, self.count = cells.frame(worker.body, direction, 0, COARSE * worker.spacing, distance_m)
        self._smooth = np.array([not material.rms_height_m for material in worker.body.materials])
        self._material = worker.body.face_material.numpy()

    def __len__(self) -> int:
        return int(self.count.prod())

    @property
    def together(self) -> int:
        """Cells whose tubes are traced in one launch."""
        return max(1, self.worker.tracer.together // COARSE**2)

    def matter(self, start: int, stop: int) -> NDArray[np.bool_]:
        """Which of the cells from `start` to `stop`, row by row, meet a smooth face first, or a second one."""
        device, step = self.worker.body.device, self.worker.tracer.together
        found = []
        for first in range(start, stop, step):
            at = np.stack(np.divmod(np.arange(first, min(first + step, stop)), self.count[1]), axis=1)
            place = self.low + (at + 0.5) * self.step
            rays = cells.CellRays.of(place, np.broadcast_to(self.step, place.shape), device)
            traced = Traced(self.worker.tracer, self.radar, rays)
            hits, count = host(traced.hits[:1])[0], traced.ends.count.numpy()
            face = np.where(count > 0, hits["face"], 0)
            found.append((count > 0) & (self._smooth[self._material[face]] | (count > 1)))
        return np.concatenate(found)

    def chosen(self, matter: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Row and column, (n, 2), of the cells that matter, and of their neighbours: a body may begin between the rays
        of two cells. `matter`: of whole rows, the first of which is row 0."""
        rows = matter.reshape(-1, self.count[1])
        wide = np.zeros((rows.shape[0] + 2, rows.shape[1] + 2), bool)
        for i in range(3):
            for j in range(3):
                wide[i : i + rows.shape[0], j : j + rows.shape[1]] |= rows
        return np.argwhere(wide[1:-1, 1:-1])

    def places(self, chosen: NDArray[np.int64]) -> tuple[Places, TubeTally]:
        """What the tubes of some cells hit, and how many of them are too wide."""
        worker, body = self.worker, self.worker.body
        part = (np.arange(COARSE) + 0.5) / COARSE
        inside = np.stack(np.meshgrid(part, part, indexing="ij"), axis=-1).reshape(-1, 2)
        middle = (self.low + (chosen[:, None] + inside[None]) * self.step).reshape(-1, 2)
        rays = cells.CellRays.of(middle, np.broadcast_to(self.step / COARSE, middle.shape), body.device)
        apart = self.radars.shape[0] > 1
        receiver = self.radars[1:] if apart else self.radar
        traced = Traced(worker.tracer, self.radar, rays, receiver if apart else None)
        wide = (traced.ends.turn.numpy() > TURN).any(axis=1)
        n, most = len(rays), worker.tracer.bounces
        place = wp.zeros((n, most), dtype=wp.vec3d, device=body.device)
        amplitude = wp.zeros((n, most, 4), dtype=wp.vec2, device=body.device)
        face = wp.zeros((n, most), dtype=int, device=body.device)
        antennas = fill(kernels.Antennas, transmitter=self.radar, receiver=receiver, rates=self.rates)
        of = fill(
            kernels.SentFields,
            k=float(worker.k[0]),
            stuff=worker.stuff,
            material=body.face_material,
            surface=body.surfaces,
            log_factorial=log_factorials(str(body.device)),
            single=int(not self.returned and "single" in worker.terms),
            more=int(not self.returned),
            diffuse=(2 if apart else 1) if "rough" in worker.terms else 0,
            seed=body.seed % 2**31,
        )
        inputs = [antennas, of, traced.hits, traced.ends.count]
        wp.launch(kernels.tube_places_kernel, n, inputs=inputs, outputs=[place, amplitude, face], device=body.device)
        values = complex_of(amplitude).reshape(-1, 4)
        if self.returned:
            values = values[:, [0, 2, 1, 3]]  # the received one comes first
        power = (np.abs(values) ** 2).sum(axis=1)
        of_tube = power.reshape(n, most).sum(axis=1, dtype=float)
        starts = np.arange(0, len(power), GROUP * COARSE**2 * most)
        strongest = np.repeat(np.maximum.reduceat(power, starts), np.diff(starts, append=len(power)))
        some = power > FAINT * strongest
        kept = Places(place.numpy().reshape(-1, 3)[some], values[some], face.numpy().reshape(-1)[some].astype(np.int64))
        return kept, TubeTally(n, int(wide.sum()), float(of_tube.sum()), float(of_tube[wide].sum()))


def tube_places(seen: CoarseCells) -> Iterator[tuple[Places, TubeTally, float]]:
    """Hits of tubes, block by block; with each block its tally, and the share of the blocks that are done.

    A coarse tracing first finds the cells where a smooth face is met, or a second one; they and their neighbours are
    traced with tubes of the worker's width.
    """
    chosen = seen.chosen(seen.matter(0, len(seen)))
    for start in range(0, len(chosen), seen.together):
        some = chosen[start : start + seen.together]
        yield *seen.places(some), min(start + seen.together, len(chosen)) / len(chosen)


def joined(parts: list[Places]) -> Places:
    if not parts:
        return Places(np.empty((0, 3)), np.empty((0, 4), np.complex64), np.empty(0, np.int64))
    return Places(
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.amplitude for part in parts]),
        np.concatenate([part.face for part in parts]),
    )


def _kept(point: F64, amplitude: NDArray[np.complex64], face: NDArray[np.int64]) -> Places:
    """Without those that send nothing back, or hardly anything."""
    power = (np.abs(amplitude) ** 2).sum(axis=1)
    some = power > FAINT * power.max(initial=0.0)
    return Places(point[some], amplitude[some], face[some])


def complex_of(array: wp.array) -> NDArray[np.complex64]:
    """Pairs of numbers of a device as complex ones."""
    return np.ascontiguousarray(array.numpy()).view(np.complex64)[..., 0]
