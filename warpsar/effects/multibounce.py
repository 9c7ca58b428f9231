"""Power that meets two and more surfaces on its way back to the radar."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Parameter, one_of
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.trial import Context, Step, Trial
from warpsar.kernels import deposit
from warpsar.kernels import merge as merging
from warpsar.kernels.effects import multibounce as kernels
from warpsar.runtime import threads
from warpsar.surface.stage import POLARIZATIONS
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, BinGrid, concatenate
from warpsar.trace.rays import ray_grid

_RECORD_BYTES = 160  # a record, and the sort's keys and order, twice
_SEGMENT = 64  # cells of one thread on CUDA


@dataclass
class Bounce:
    """One bounce of every path, in the arrays that Hits have; shape (n,)."""

    face: wp.array
    barycentric: wp.array
    point: wp.array
    cos_incidence: wp.array


@dataclass
class Paths:
    """Paths of one number of bounces, merged by bin and faces; arrays of shape (n,).

    `pixel` is a bin of the hits' grid; `weight` is dA_perp / cos(theta_n) over the pixel area; `point` [m] is where
    a single bounce would have the path's range, azimuth and mean elevation; `cos_half` and `cos_tilt` of the last
    bounce: between half vector and incoming direction, and half vector and normal.
    """

    bounces: list[Bounce]
    pixel: wp.array
    weight: wp.array
    point: wp.array
    cos_half: wp.array
    cos_tilt: wp.array


class Multibounce(Effect):
    """Rays followed over up to `max_bounces` surfaces (effects.md of the specification).

    Every surface but the last is a mirror with |R_p(theta)|^2 exp(-4 k^2 h^2 cos^2 theta). The last returns the ray,
    if the way is free, with the bistatic geometric-optics coefficient of slope variance 2 h^2 / l^2 + 1e-4. R_p is
    of the polarization in each facet's own basis; HV and VH get nothing. Range is half the path, azimuth the middle
    of entry and exit. Power adds: both directions of a path are traced, each once.
    """

    name = "multibounce"
    stage = "path"
    order = 10
    summary = "double and triple bounces between surfaces"
    parameters = (Parameter("strength", "1", 0.0, 0.0, 1e6, 1.0, scale="log", fit_low=1e-6, fit_high=1e4),)
    settings = (one_of("max_bounces", 3, 2, 3, 4),)

    def trials(self, context: Context) -> list[Trial]:
        step = Step("strength", 1.0, {"strength": 1.0}, one_sided=True)
        return [Trial((step,), tuple({"strength": s} for s in (1.0, 0.2, 5.0)))]

    def paths(self, render: Recorder, p: Any, image: Any, polarization: int) -> Any:
        name = next(key for key, code in POLARIZATIONS.items() if code == polarization)
        if name not in ("HH", "VV"):
            return image
        program, stage = render.program, render.stage
        if self.name not in render.recorded:
            bounces = render.settings[self.name]["max_bounces"]
            key = (self.name, bounces)
            if key not in render.hits.derived:
                render.hits.derived[key] = trace_paths(render, bounces)
            found = render.hits.derived[key]
            zetas = [
                [render.coordinates(b.face, b.barycentric, b.point) for b in paths.bounces] if paths else []
                for paths in found
            ]
            render.recorded[self.name] = list(zip(found, zetas, strict=True))
        for count, (paths, zeta) in enumerate(render.recorded[self.name], start=2):
            share = render.layers[f"beta0_{count}_bounces_{name}"] = program.array(image.shape[0], sum_into=True)
            if paths is None:
                continue
            n = paths.weight.shape[0]
            last = paths.bounces[-1]
            power = program.array(n)
            program.launch(
                kernels.return_kernel,
                n,
                [
                    p,
                    polarization,
                    last.face,
                    stage.face_material,
                    stage.eps_im,
                    paths.cos_half,
                    paths.cos_tilt,
                    zeta[-1],
                ],
                [power],
            )
            for bounce, z in zip(paths.bounces[:-1], zeta[:-1], strict=True):
                left = program.array(n)
                program.launch(
                    kernels.mirror_kernel,
                    n,
                    [
                        polarization,
                        render.geometry.wavenumber,
                        bounce.face,
                        stage.face_material,
                        stage.eps_im,
                        bounce.cos_incidence,
                        z,
                        power,
                    ],
                    [left],
                )
                power = left
            render.collect(power, paths.weight, paths.point, paths.pixel, share)
            result = program.array(image.shape[0])
            program.launch(deposit.add_kernel, image.shape[0], [image, share], [result])
            image = result
        return image


def trace_paths(render: Recorder, max_bounces: int) -> list[Paths | None]:
    """Paths of 2, 3, ... `max_bounces` bounces, with the density and seed of the view's hits; None where there are
    none."""
    hits, target = render.hits, render.stage.target
    grid, device = hits.grid, target.device
    # Rays that enter beside the image may leave inside: as far again on both sides, and no farther than the mesh.
    wide = BinGrid((grid.shape[0], 2 * grid.shape[1]), grid.spacing_m)
    area = render.spacing_m[0] * render.spacing_m[1]
    rays = ray_grid(target, hits.geometry, wide, hits.rays_per_m2, 1, area)
    first, last = rays.first_cell, rays.end_cell
    size = float(np.linalg.norm(np.ptp(target.corners, axis=0)))
    segment = rays.elevation_cells if device.is_cpu else _SEGMENT
    workers = threads.thread_count() if device.is_cpu else 1
    room = int(DEFAULT_MEMORY_GIB * 2**30 / workers / (_RECORD_BYTES * rays.elevation_cells * (max_bounces - 1)))
    # at least 8 bands for the threads to share
    width = max(1, min(room, -(-(last - first) // 8) if device.is_cpu else last - first))

    def band(begin: int) -> list[Any] | None:
        dim = (min(width, last - begin), -(-rays.elevation_cells // segment))
        capacity = max(4096, dim[0] * rays.elevation_cells // 4)
        while True:
            records = _records(capacity, device)
            wp.launch(
                kernels.path_kernel,
                dim,
                inputs=[
                    rays,
                    target.bvh.id,
                    target.vertices,
                    target.faces,
                    begin,
                    segment,
                    hits.seed,
                    max_bounces,
                    size,
                    grid.start_m[1],
                    grid.spacing_m[1],
                    grid.shape[1],
                ],
                outputs=[records],
                device=device,
            )
            count = int(records.count.numpy()[0])
            if count <= capacity:
                break
            capacity = count
        return _merge(records, count, max_bounces, device) if count else None

    wp.load_module(kernels, device=device)
    tasks = [partial(band, begin) for begin in range(first, last, width)]
    parts = [part for part in threads.ordered(tasks, device) if part is not None]
    found: list[Paths | None] = []
    for index in range(max_bounces - 1):
        mine = [part[index] for part in parts if part[index] is not None]
        if not mine:
            found.append(None)
            continue
        dtypes = (int, wp.vec4i, wp.vec4, wp.vec4, float, wp.vec3)
        arrays = [concatenate([part[k] for part in mine], dtype, device) for k, dtype in enumerate(dtypes)]
        found.append(_paths(arrays, index + 2, rays, target))
    return found


def _records(capacity: int, device: Any) -> Any:
    records = kernels.PathRecords()
    records.bin = wp.empty(capacity, dtype=int, device=device)
    records.bounces = wp.empty(capacity, dtype=int, device=device)
    records.faces = wp.empty(capacity, dtype=wp.vec4i, device=device)
    records.second = wp.empty(capacity, dtype=wp.vec4, device=device)
    records.third = wp.empty(capacity, dtype=wp.vec4, device=device)
    records.weight = wp.empty(capacity, dtype=float, device=device)
    records.point = wp.empty(capacity, dtype=wp.vec3, device=device)
    records.count = wp.zeros(1, dtype=int, device=device)
    return records


def _merge(records: Any, count: int, max_bounces: int, device: Any) -> list[Any]:
    """Records of one bin and the same faces become one path; a list of arrays (or None) for 2, 3, ... bounces."""
    order = wp.empty(2 * count, dtype=int, device=device)
    key = wp.empty(2 * count, dtype=wp.int64, device=device)
    wp.launch(merging.number_kernel, count, outputs=[order], device=device)
    for what in (2, 1, 0) if max_bounces > 2 else (1, 0):
        inputs = [what, order, records.bin, records.bounces, records.faces]
        wp.launch(kernels.sort_key_kernel, count, inputs=inputs, outputs=[key], device=device)
        wp.utils.radix_sort_pairs(key, order, count, 0, 64)
    start, rank = (wp.empty(count, dtype=int, device=device) for _ in range(2))
    wp.launch(
        kernels.mark_path_starts_kernel,
        count,
        inputs=[order, records.bin, records.faces],
        outputs=[start],
        device=device,
    )
    wp.utils.array_scan(start, rank, inclusive=True)
    paths = int(rank[count - 1 :].numpy()[0])
    first = wp.empty(paths, dtype=int, device=device)
    wp.launch(merging.place_starts_kernel, count, inputs=[start, rank], outputs=[first], device=device)
    merged = _records(paths, device)
    wp.launch(
        kernels.reduce_paths_kernel, paths, inputs=[records, order, first, count], outputs=[merged], device=device
    )
    # the sort has put them in the order of their bounces
    ends = np.searchsorted(merged.bounces.numpy(), np.arange(2, max_bounces + 2))
    arrays = (merged.bin, merged.faces, merged.second, merged.third, merged.weight, merged.point)
    return [[array[int(a) : int(b)] for array in arrays] if b > a else None for a, b in pairwise(ends)]


def _paths(arrays: list[Any], bounces: int, rays: Any, target: Any) -> Paths:
    device = target.device
    pixel, met, second, third, weight, point = arrays
    n = pixel.shape[0]

    def empty(dtype: Any) -> Any:
        return wp.empty(n, dtype=dtype, device=device)

    share, cosines, cos_half, cos_tilt = empty(float), empty(wp.vec4), empty(float), empty(float)
    wp.launch(
        kernels.path_geometry_kernel,
        n,
        inputs=[rays, target.vertices, target.faces, bounces, met, second, third, weight],
        outputs=[share, cosines, cos_half, cos_tilt],
        device=device,
    )
    each = []
    for k in range(bounces):
        one = Bounce(empty(int), empty(wp.vec2), empty(wp.vec3), empty(float))
        wp.launch(
            kernels.bounce_kernel,
            n,
            inputs=[k, target.vertices, target.faces, met, second, third, cosines],
            outputs=[one.face, one.barycentric, one.point, one.cos_incidence],
            device=device,
        )
        each.append(one)
    return Paths(each, pixel, share, point, cos_half, cos_tilt)


EFFECT = Multibounce()
