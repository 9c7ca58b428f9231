"""What each face and each edge of a body sends back in one direction, term by term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.directions import radar_records
from warpsar.coherent.rcs import RcsRequest
from warpsar.coherent.records import records, upload
from warpsar.coherent.sweep import POLARIZATIONS, RAYS_PER_WAVELENGTH, TERMS, Worker
from warpsar.coherent.traced import LEVELS
from warpsar.kernels.coherent import coated_edges, edges, radiate, tubes
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.world import World


@dataclass(frozen=True)
class Contributors:
    """Amplitudes A [m] that add up to those of the terms of single and further bounces and of edges, p polarizations.

    Their phase is zero in the middle of the body, not at the reference point.
    """

    azimuth_deg: float
    incidence_deg: float
    frequency_hz: float
    polarizations: tuple[str, ...]
    faces_m: dict[str, NDArray[np.complex128]]
    """By the terms of single and of further bounces: what each face of the mesh sends to the radar, (faces, p).

    A path of several faces counts for each of them with what it sends from there.
    """
    start: NDArray[np.float64]
    """Ends of the edges that diffract about the reference point, (e, 3) [m]."""
    end: NDArray[np.float64]
    edges_m: NDArray[np.complex128]
    """(e, p); zero without the term `edges`."""


def contributors(
    scene: World,
    azimuth_deg: float,
    incidence_deg: float = 90.0,
    frequency_hz: float | None = None,
    *,
    device: str | None = None,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
) -> Contributors:
    """Which faces and edges the amplitude of one direction comes from; the frequency is that of `[radar]` without one.

    Slabs in air count with what their coefficient of reflection sends. Raises InputError and DeviceError as `rcs`.
    """
    asked = RcsRequest.of(scene, [azimuth_deg], [incidence_deg], frequency_hz, device, rays_per_wavelength)
    body, radar = asked.body, scene.radar
    k = 2.0 * np.pi * asked.frequencies / SPEED_OF_LIGHT
    spacing = float(2.0 * np.pi / k[0] / rays_per_wavelength)
    worker = Worker(body, k, spacing, radar.terms, radar.max_bounces, LEVELS, radar.slant_range_m)
    records_of = radar_records(asked.directions, body.origin, radar.slant_range_m)
    radars = upload(records_of, tubes.TubeRadar, body.device)
    chosen = [POLARIZATIONS.index(name) for name in radar.polarizations]
    faces = _of_faces(worker, asked, radars)[..., chosen]
    by_term = {TERMS[0]: faces[:, 0], TERMS[1]: faces[:, 1]}  # the first bounce, and all later ones
    which = body.cuts(np.pi / k[0])[0]
    some, place = np.unique(which, return_inverse=True)
    along = np.zeros((len(some), len(POLARIZATIONS)), np.complex128)
    if len(which) and "edges" in radar.terms:
        seen = worker.free(radars, worker.edge_middle, worker.edge_outward, both_sides=False)
        out = wp.empty((len(which), 4), dtype=wp.vec2d, device=body.device)
        inputs = [radars, wp.float64(k[0]), worker.edges, seen]
        kernel = edges.pieces_kernel
        if body.has_coats:
            kernel, inputs = coated_edges.coated_pieces_kernel, [*inputs, worker.stuff]
        wp.launch(kernel, len(which), inputs=inputs, outputs=[out], device=body.device)
        np.add.at(along, place, _complex(out))
    wedges = body.shape.wedges
    return Contributors(
        azimuth_deg,
        incidence_deg,
        float(asked.frequencies[0]),
        tuple(radar.polarizations),
        {name: amplitude for name, amplitude in by_term.items() if name in radar.terms},
        wedges.start[some] + body.origin,
        wedges.end[some] + body.origin,
        along[:, chosen],
    )


def _of_faces(worker: Worker, asked: RcsRequest, radars: wp.array) -> NDArray[np.complex128]:
    """(faces, first or later bounce, 4)."""
    body, tracer = worker.body, worker.tracer
    k, device = wp.float64(worker.k[0]), body.device
    exact = worker.lit_regions(radars)
    total = wp.zeros((len(body.shape.faces), 2, 4), dtype=wp.vec2d, device=device)
    grid = worker.grid(asked.directions, worker.spacing)
    for traced in tracer.narrowed(radars, grid, 0, len(grid)):
        inputs = [radars, k, worker.stuff, body.face_material, body.region, exact]
        inputs += [traced.rays.cells.view, traced.kept, traced.hits, traced.ends.count]
        wp.launch(radiate.by_face_kernel, len(traced.rays), inputs=inputs, outputs=[total], device=device)
        del traced
    lit = np.append(exact.numpy()[0], 0)[body.shape.region] != 0  # the region -1 is none
    if (face := np.flatnonzero(lit)).size:
        inputs = [radars, k, worker.stuff, *_triangles(worker, face), upload(face, int, device)]
        wp.launch(radiate.by_triangle_kernel, len(face), inputs=inputs, outputs=[total], device=device)
    return _complex(total)


def _triangles(worker: Worker, face: NDArray[np.int64]) -> tuple[wp.array, wp.array, wp.array]:
    """Faces of flat regions as regions of their own, wound about the region's normal; middles and lengths of edges."""
    shape, body = worker.body.shape, worker.body
    normal = shape.regions.normal[shape.region[face]]
    corners = shape.vertices[shape.faces[face]]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners = np.where((np.einsum("ij,ij->i", area, normal) < 0.0)[:, None, None], corners[:, ::-1], corners)
    after = np.roll(corners, -1, axis=1)
    packed = records(radiate.Region, len(face))
    packed["normal"], packed["centre"] = normal, corners.mean(axis=1)
    packed["area"] = 0.5 * np.linalg.norm(area, axis=1)
    packed["reach"] = np.linalg.norm(after - corners, axis=2).max(axis=1)
    packed["material"] = shape.regions.material[shape.region[face]]
    packed["first"] = 3 * np.arange(len(face))
    packed["end"] = packed["first"] + 3
    edges_of = (0.5 * (after + corners), after - corners)
    return (
        upload(packed, radiate.Region, body.device),
        *(upload(each.reshape(-1, 3), wp.vec3d, body.device) for each in edges_of),
    )


def _complex(pairs: wp.array) -> NDArray[np.complex128]:
    both = pairs.numpy()
    found: NDArray[np.complex128] = both[..., 0] + 1j * both[..., 1]
    return found
