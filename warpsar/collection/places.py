"""What a body sends back toward one place of the sensor: scatterers of rough faces, edges and tubes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent import rays as cells
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.coherent.records import host, records, upload
from warpsar.coherent.rough_models import Group, load
from warpsar.coherent.sweep import Worker
from warpsar.coherent.traced import TURN, Traced
from warpsar.kernels import collection as kernels
from warpsar.kernels.coherent import tubes
from warpsar.kernels.coherent.rough_models import rough_places_kernel
from warpsar.runtime import threads

F64 = NDArray[np.float64]
COARSE = 16
"""Cells of the first, coarse tracing are so many tubes wide. It finds where smooth faces and second bounces are."""
FAINT = 1e-6
"""Power of a tube, as a share of the strongest one's, under which it is left out: -60 dB."""

_TOGETHER = 2**14
"""Rough places that a thread of the CPU takes at a time."""


@dataclass(frozen=True)
class Places:
    """Scatterers about the body's middle (n, 3) [m], amplitudes (n, 4) [m] without the way's phase, and faces (n,)."""

    point: F64
    amplitude: NDArray[np.complex64]
    face: NDArray[np.int64]


def sight(body: CoherentBody, place_m: F64) -> tuple[Directions, wp.array]:
    """The direction to a sensor at a place (3,) [m] about the reference point, and the kernels' radar."""
    distance = float(np.linalg.norm(place_m))
    s = place_m / distance
    level = float(np.hypot(s[0], s[1]))
    u = np.array([s[1], -s[0], 0.0]) / level if level > 1e-12 else np.array([1.0, 0.0, 0.0])
    one = Directions(s[None], u[None], np.cross(-u, s)[None])
    made = records(tubes.Radar, 1)
    made["s"], made["u"], made["v"] = s, u, one.v[0]
    made["near"], made["distance"], made["place"] = 1, distance, place_m - body.origin
    return one, upload(made, tubes.Radar, body.device)


def worker_of(body: CoherentBody, k: float, terms: tuple[str, ...], max_bounces: int, rays: float) -> Worker:
    """What all directions share, for sensors at a distance."""
    spacing = 2.0 * np.pi / k / rays
    return Worker(body, np.array([k]), spacing, terms, max_bounces, 0, 1.0)


def rough_amplitudes(worker: Worker, radar: wp.array) -> tuple[wp.array, int]:
    """Of the body's rough places, (n, 4) on the device, 0 where they are not seen; and how many are seen."""
    body, device = worker.body, worker.body.device
    assert body.scatterers is not None
    places, count = body.scatterers, body.scatterers.shape[0]
    out = wp.zeros((count, 4), dtype=wp.vec2, device=device)

    def some(piece: Group) -> int:
        part = piece.part
        seen = worker.free(radar, body.scatterer_points[part], body.scatterer_normals[part], both_sides=True)
        kernel, more = piece.launched(kernels.rough_places_kernel, rough_places_kernel, worker.tables)
        inputs = [radar, float(worker.k[0]), body.surfaces, body.variant, places[part], seen, *more]
        wp.launch(kernel, part.stop - part.start, inputs=inputs, outputs=[out[part]], device=device)
        return int(np.count_nonzero(seen.numpy()))

    load(body.scatterer_groups, rough_places_kernel, device)
    step = _TOGETHER if device.is_cpu else count
    tasks = [partial(some, piece) for group in body.scatterer_groups for piece in group.cut(step)]
    return out, sum(threads.ordered(tasks, device))


def edge_places(worker: Worker, radar: wp.array) -> Places:
    """The pieces of edges that the sensor sees."""
    device = worker.body.device
    seen = worker.free(radar, worker.edge_middle, worker.edge_outward, both_sides=False)
    out = wp.zeros((worker.edges.shape[0], 4), dtype=wp.vec2, device=device)
    inputs = [radar, float(worker.k[0]), worker.edges, seen]
    wp.launch(kernels.edge_places_kernel, out.shape[0], inputs=inputs, outputs=[out], device=device)
    which = worker.body.cuts(np.pi / float(worker.k.max()))[0]
    return _kept(worker.edge_middle.numpy(), complex_of(out), worker.body.shape.wedges.face[which, 0])


def tube_places(
    worker: Worker, direction: Directions, radar: wp.array, distance_m: float, apart: F64
) -> tuple[Places, float]:
    """Hits of tubes, and the share of tubes that alias.

    `apart` (3,) is half of the unit vector to the transmitter less that to the receiver: zero for one antenna.

    A coarse tracing first finds the cells where a smooth face is met, or a second one; they and their neighbours are
    traced with tubes of the worker's width.
    """
    body = worker.body
    found, wide, traced_all = [], 0, 0
    for rays in _chosen(worker, direction, radar, distance_m):
        traced = Traced(worker.tracer, radar, rays)
        wide += int((traced.turn.numpy() > TURN).any(axis=1).sum())
        traced_all += len(rays)
        n, most = len(rays), worker.tracer.bounces
        place = wp.zeros((n, most), dtype=wp.vec3d, device=body.device)
        amplitude = wp.zeros((n, most, 4), dtype=wp.vec2, device=body.device)
        face = wp.zeros((n, most), dtype=int, device=body.device)
        inputs = [radar, float(worker.k[0]), worker.stuff, body.face_material]
        inputs += [traced.hits, traced.count, int("single" in worker.terms), wp.vec3d(*apart)]
        wp.launch(kernels.tube_places_kernel, n, inputs=inputs, outputs=[place, amplitude, face], device=body.device)
        values = complex_of(amplitude).reshape(-1, 4)
        found.append(_kept(place.numpy().reshape(-1, 3), values, face.numpy().reshape(-1).astype(np.int64)))
    return joined(found), wide / max(traced_all, 1)


def _chosen(worker: Worker, direction: Directions, radar: wp.array, distance_m: float) -> Iterator[cells.Rays]:
    """Fine rays in blocks, of the coarse cells that matter."""
    body = worker.body
    coarse = cells.Grid(body, direction, COARSE * worker.spacing, distance_m)[:]
    traced = Traced(worker.tracer, radar, coarse)
    hits, hit_count = host(traced.hits[:1])[0], traced.count.numpy()
    smooth = np.array([not material.rms_height_m for material in body.materials])
    met = hit_count > 0
    first = np.where(met, hits["face"], 0)
    matters = met & (smooth[body.face_material.numpy()[first]] | (hit_count > 1))
    low, step, count = cells.frame(body, direction, 0, COARSE * worker.spacing, distance_m)
    wanted = np.zeros(count + 2, bool)
    at = np.round((coarse.place.numpy() - low) / step - 0.5).astype(int)[matters] + 1
    for i in (-1, 0, 1):  # a body may begin between the rays of two cells
        for j in (-1, 0, 1):
            wanted[at[:, 0] + i, at[:, 1] + j] = True
    chosen = np.argwhere(wanted[1:-1, 1:-1])
    part = (np.arange(COARSE) + 0.5) / COARSE
    inside = np.stack(np.meshgrid(part, part, indexing="ij"), axis=-1).reshape(-1, 2)
    together = max(1, worker.tracer.together // COARSE**2)
    for start in range(0, len(chosen), together):
        corner = chosen[start : start + together]
        place = (low + (corner[:, None] + inside[None]) * step).reshape(-1, 2)
        yield cells.Rays.of(place, np.broadcast_to(step / COARSE, place.shape), body.device)


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
