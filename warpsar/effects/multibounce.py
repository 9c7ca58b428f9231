"""Power that meets two and more surfaces on its way back to the radar."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter, one_of
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels import binning
from warpsar.kernels import merge as merging
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import multibounce as kernels
from warpsar.kernels.geometry import Band, RayGrid
from warpsar.runtime import threads
from warpsar.runtime.structs import allocate, element_types, fill
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, BinGrid, concatenate
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target

_RECORD_BYTES = 160  # a record, and the sort's keys and order, twice
_SEGMENT = 64  # cells of one thread on CUDA

_ARRAYS = {name: dtype for name, dtype in element_types(kernels.PathRecords).items() if name != "count"}


@dataclass
class BouncePaths:
    """Paths of one number of bounces, merged by bin and faces; arrays of shape (n,).

    `pixel` is a bin of the hits' grid. `weight` is dA_perp / cos(theta_n) over the pixel area. `point` [m] is where a
    single bounce would have the path's range, azimuth and mean elevation. At the last bounce, `cos_half` is between
    half vector and incoming direction, `cos_tilt` between half vector and normal.
    """

    bounces: list[kernels.Bounce]
    pixel: wp.array
    weight: wp.array
    point: wp.array
    cos_half: wp.array
    cos_tilt: wp.array


class Multibounce(Effect):
    """Rays followed over up to `max_bounces` surfaces (docs/effects.md).

    Every surface but the last is a mirror with |R_p(theta)|^2 exp(-4 k^2 h^2 cos^2 theta). The last surface returns
    the ray if nothing lies between it and the radar, with the bistatic geometric-optics coefficient of slope variance
    2 h^2 / l^2 + 1e-4. R_p is for the polarization in each facet's own basis. HV and VH get nothing. Range is half
    the path, azimuth the middle of entry and exit. Powers add: both directions of a path are traced, each once.
    """

    name = "multibounce"
    stage = "path"
    of_surfaces_with = "eps_r"
    order = 10
    needs_all_hits = True
    summary = "double and triple bounces between surfaces"
    in_place = "multibounce in radar.terms"
    example: ClassVar[dict[str, Any]] = {"strength": 1.0}
    rate_case: ClassVar[dict[str, Any]] = {"strength": 1.0}
    parameters = (
        EffectParameter(
            "strength",
            "1",
            0.0,
            0.0,
            1e6,
            1.0,
            unstated=1.0,
            scale="log",
            fit_low=1e-6,
            fit_high=1e4,
            description="Factor on the power of the paths: 1 is all of it.",
        ),
    )
    settings = (one_of("max_bounces", 3, 2, 3, 4, description="Most surfaces on a path."),)

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """All corners must show it."""
        return image.halves()

    def trials(self, context: Context) -> list[Trial]:
        step = ScoreStep("strength", 1.0, {"strength": 1.0}, one_sided=True)
        return [Trial((step,), tuple({"strength": s} for s in (1.0, 0.2, 5.0)))]

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        if Polarization(polarization).crossed:
            return image
        if self.name not in render.recorded:
            render.recorded[self.name] = self._with_coordinates(render)
        for count, (paths, zetas) in enumerate(render.recorded[self.name], start=2):
            share = render.program.array(image.shape[0], sum_into=True)
            render.layers[f"beta0_{count}_bounces_{Polarization(polarization).name}"] = share
            if paths is None:
                continue
            power = _power(render, p, paths, zetas, polarization)
            render.collect(power, paths.weight, paths.point, paths.pixel, share)
            result = render.program.array(image.shape[0])
            render.program.launch(binning.add_kernel, image.shape[0], [image, share], [result])
            image = result
        return image

    def _with_coordinates(self, render: Recorder) -> list[tuple[BouncePaths | None, list[wp.array]]]:
        """Paths by number of bounces, traced once for all renders of the hits, and the coordinates of each bounce."""
        bounces = render.settings[self.name]["max_bounces"]
        key = (self.name, bounces)
        if key not in render.hits.derived:
            render.hits.derived[key] = trace_paths(render, bounces)
        return [
            (paths, [render.coordinates(b.face, b.barycentric, b.point) for b in paths.bounces] if paths else [])
            for paths in render.hits.derived[key]
        ]


def _power(render: Recorder, p: wp.array, paths: BouncePaths, zetas: list[wp.array], polarization: int) -> wp.array:
    """Record what each path returns per unit of its weight, shape (n,): the last surface's lobe times the mirrors."""
    program, stage = render.program, render.stage
    n = paths.weight.shape[0]
    material = [stage.face_material, stage.eps_im]
    power = program.array(n)
    lobe = [p, polarization, paths.bounces[-1].face, *material, paths.cos_half, paths.cos_tilt, zetas[-1]]
    program.launch(kernels.return_kernel, n, lobe, [power])
    for bounce, zeta in zip(paths.bounces[:-1], zetas[:-1], strict=True):
        left = program.array(n)
        mirror = [polarization, render.geometry.wavenumber, bounce.face, *material, bounce.cos_incidence, zeta, power]
        program.launch(kernels.mirror_kernel, n, mirror, [left])
        power = left
    return power


def trace_paths(render: Recorder, max_bounces: int) -> list[BouncePaths | None]:
    """Paths of 2, 3, ... `max_bounces` bounces, with the density and seed of the view's hits.

    None stands where there are no paths of that number of bounces.
    """
    hits, target = render.hits, render.stage.target
    # Rays that enter beside the image may leave inside: half of it on each side, and no farther than the mesh.
    grid = hits.grid
    shape = grid.shape[0], round((1.0 + 2.0 * grid.strip.beside) * grid.shape[1])
    wide = BinGrid(shape, grid.spacing_m, strip=grid.strip)
    area = render.spacing_m[0] * render.spacing_m[1]
    rays = ray_grid(target, hits.geometry, wide, hits.rays_per_m2, area)
    first, last = rays.first_cell, rays.end_cell
    width = _band_width(rays, max_bounces, target.device)
    wp.load_module(kernels, device=target.device)
    tasks = [
        partial(_band, render, rays, max_bounces, begin, min(width, last - begin))
        for begin in range(first, last, width)
    ]
    parts = [part for part in threads.ordered(tasks, target.device) if part is not None]
    found: list[BouncePaths | None] = []
    for index in range(max_bounces - 1):
        mine = [arrays for part in parts if (arrays := part[index]) is not None]
        if not mine:
            found.append(None)
            continue
        arrays = {
            name: concatenate([getattr(one, name) for one in mine], dtype, target.device)
            for name, dtype in _ARRAYS.items()
        }
        found.append(_paths(fill(kernels.PathRecords, **arrays), index + 2, rays, target))
    return found


def _band_width(rays: RayGrid, max_bounces: int, device: wp.Device) -> int:
    """Azimuth cells that are traced in one launch: as many as the memory for their records allows."""
    cells = rays.end_cell - rays.first_cell
    workers = threads.thread_count() if device.is_cpu else 1
    room = int(DEFAULT_MEMORY_GIB * 2**30 / workers / (_RECORD_BYTES * rays.elevation_cells * (max_bounces - 1)))
    # at least 8 bands for the threads to share
    return max(1, min(room, -(-cells // 8) if device.is_cpu else cells))


def _band(render: Recorder, rays: RayGrid, max_bounces: int, begin: int, width: int) -> list[Any] | None:
    """Paths of `width` azimuth cells from `begin` on, merged, by number of bounces; None without any (`_merge`)."""
    hits, target = render.hits, render.stage.target
    grid, device = hits.grid, target.device
    segment = rays.elevation_cells if device.is_cpu else _SEGMENT
    dim = (width, -(-rays.elevation_cells // segment))
    size = float(np.linalg.norm(np.ptp(target.corners, axis=0)))
    band = fill(Band, first_cell=begin, end_cell=begin + width, seed=hits.seed)
    columns = fill(kernels.ImageColumns, start=grid.start_m[1], spacing=grid.spacing_m[1], count=grid.shape[1])
    inputs = [rays, target.triangles, band, columns, target.bvh.id, segment, max_bounces, size]
    capacity = max(4096, dim[0] * rays.elevation_cells // 4)
    while True:
        records = _records(capacity, device)
        wp.launch(kernels.path_kernel, dim, inputs=inputs, outputs=[records], device=device)
        count = int(records.count.numpy()[0])
        if count <= capacity:
            return _merge(records, count, max_bounces, device) if count else None
        capacity = count


def _records(capacity: int, device: wp.Device) -> kernels.PathRecords:
    """Room for `capacity` records: a `kernels.PathRecords`."""
    count: wp.array = wp.zeros(1, dtype=int, device=device)
    records: kernels.PathRecords = allocate(kernels.PathRecords, capacity, device, count=count)
    return records


def _merge(records: kernels.PathRecords, count: int, max_bounces: int, device: wp.Device) -> list[Any]:
    """Records of one bin and the same faces become one path: `PathRecords` by number of bounces, 2 first, or None."""
    order = wp.empty(2 * count, dtype=int, device=device)
    key = wp.empty(2 * count, dtype=wp.int64, device=device)
    wp.launch(merging.number_kernel, count, outputs=[order], device=device)
    for what in (2, 1, 0) if max_bounces > 2 else (1, 0):
        wp.launch(kernels.sort_key_kernel, count, inputs=[records, order, what], outputs=[key], device=device)
        wp.utils.radix_sort_pairs(key, order, count, 0, 64)
    start, rank = (wp.empty(count, dtype=int, device=device) for _ in range(2))
    wp.launch(
        kernels.mark_path_starts_kernel,
        count,
        inputs=[records, order],
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

    def between(a: int, b: int) -> Any:
        return fill(kernels.PathRecords, **{name: getattr(merged, name)[a:b] for name in _ARRAYS}) if b > a else None

    return [between(a, b) for a, b in pairwise(ends.tolist())]


def _paths(paths: kernels.PathRecords, bounces: int, rays: RayGrid, target: Target) -> BouncePaths:
    """Merged paths of one number of bounces, with the angles at their faces."""
    device, mesh, n = target.device, target.triangles, paths.bin.shape[0]
    angles = allocate(kernels.PathAngles, n, device)
    inputs = [rays, mesh, paths, bounces]
    wp.launch(kernels.path_geometry_kernel, n, inputs=inputs, outputs=[angles], device=device)
    each = []
    for k in range(bounces):
        one = allocate(kernels.Bounce, n, device)
        wp.launch(kernels.bounce_kernel, n, inputs=[mesh, paths, angles, k], outputs=[one], device=device)
        each.append(one)
    return BouncePaths(each, paths.bin, angles.weight, paths.point, angles.cos_half, angles.cos_tilt)


EFFECT = Multibounce()
