"""Scene + View -> Hits: the geometry of one view, traced once and kept."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any

import warp as wp

from warpsar.errors import InputError
from warpsar.kernels import hit_lanes, record_lanes
from warpsar.kernels import trace as kernels
from warpsar.kernels.codes import Deposit
from warpsar.runtime import threads
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, BinGrid, Hits, concatenate
from warpsar.trace.merge import rows_by_key, sorted_rows
from warpsar.trace.nearest import ParallelRaster, Raster
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target
from warpsar.world.frame import ViewGeometry

if TYPE_CHECKING:
    pass


_RAY_BYTES = 96  # at most: its face, what the raster keeps of it, two rows of its band's table, their marks and ranks


_BAND_RAYS = 2**20  # of a CPU's band; smaller ones share more faces, and larger ones leave cores without


_TILE = (4, 8)  # rays of a CUDA warp: across azimuth, along elevation


_SEGMENT = 4  # rays of one CUDA thread when they are recorded


def trace(
    target: Target,
    geometry: ViewGeometry,
    grid: BinGrid,
    rays_per_m2: float,
    *,
    seed: int = 0,
    deposit: str = "footprint",
    merge: bool = True,
    cells_multiple: int = 1,
    pixel_area_m2: float | None = None,
    only_columns: tuple[int, int] | None = None,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    progress: Any = None,
) -> Hits:
    """Trace one view and bin it.

    `rays_per_m2` counts rays over the plane across the look direction. `deposit`: a ray's power goes to the bin
    of its sample ("nearest"), to the range bins its cell covers on the facet's plane ("footprint"), or is split
    between the two nearest bin centres in range ("linear", differentiable). `pixel_area_m2` divides the weights
    and is the grid's own unless the grid is finer than the image. `only_columns`: the first of the grid's and the one
    after the last, with the rays that they would have in the whole. Memory stays near `max_memory_gib` beside the hits
    themselves; the result does not depend on it, nor on the number of threads, nor on the order of CUDA's.
    """
    device = target.device
    rays = ray_grid(target, geometry, grid, rays_per_m2, cells_multiple, pixel_area_m2 or grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    if only_columns is not None:
        first = max(first, only_columns[0] * rays.cells_per_column)
        last = max(first, min(last, only_columns[1] * rays.cells_per_column))
    faces = int(target.faces.shape[0])
    face_bits = max(1, (faces - 1).bit_length())
    key_bits = face_bits + max(1, (grid.shape[0] * grid.shape[1] - 1).bit_length())
    if key_bits > 62:
        raise InputError(
            f"[image] shape: {grid.shape[0]} x {grid.shape[1]} pixels with {faces} faces cannot be "
            f"numbered in 62 bits; allowed are {2 ** (62 - face_bits)} pixels"
        )
    codes = {code.name.lower(): code for code in Deposit}
    segment, block = rays.elevation_cells if device.is_cpu else _SEGMENT, kernels.BLOCK
    workers = threads.thread_count() if device.is_cpu else 1
    most = min(max_memory_gib * 2**30 / workers / _RAY_BYTES, 2**29)  # rays of a band; rows are numbered in 31 bits

    def rows_expected(begin: int, end: int) -> float:
        """Rows of the table for the azimuth cells `begin` to `end`, with as many left free."""
        expected = 2.0 * (end - begin) * rays.elevation_cells
        if merge:
            # As many (pixel, face) as two nets of cells cut one another into, one surface deep; more is retried.
            pixels = grid.shape[0] * (end - begin) / rays.cells_per_column
            lit = faces * (end - begin) / max(rays.end_cell - rays.first_cell, 1)
            expected = min(expected, 2.0 * (math.sqrt(pixels) + math.sqrt(lit)) ** 2)
        return expected

    # whole columns of pixels, so that no two bands share one; at least 8 bands for the threads to share
    columns = -(-(last - first) // rays.cells_per_column)
    room = int(most / max(rays.elevation_cells, 1)) // rays.cells_per_column
    if device.is_cpu:
        # not by the number of threads: the bands' order is that of the hits
        pieces = max(8, (last - first) * rays.elevation_cells // _BAND_RAYS)
        room = min(room, -(-columns // pieces))
    width = max(1, min(room, columns)) * rays.cells_per_column

    kind: type[Raster | ParallelRaster] = Raster if device.is_cpu else ParallelRaster
    raster = kind.where_it_pays(target, rays, first, last)

    def recorded(begin: int, end: int, capacity: int) -> tuple[Any, Any, Any]:
        """Records of a band's rays in a table of `capacity` rows, or of more where they find no room; their keys in
        order, and their rows."""
        face = nearest_faces(target, rays, begin, end, seed) if raster is None else raster.nearest(begin, end, seed)
        records = kernels.Records()
        # a ray's own weight is at least 2^29 quanta, and at grazing incidence 1e6 times as much
        records.quanta = 2.0 ** (30 - math.floor(math.log2(1.0 / (rays_per_m2 * rays.pixel_area))))
        if device.is_cpu and merge:
            records.rows, taken = recorded_in_columns(
                target, rays, face, begin, end, capacity, seed, codes[deposit], face_bits, records.quanta
            )
            return records, *rows_by_key(records.rows, taken, key_bits)
        while True:
            records.rows = wp.zeros((capacity, 4), dtype=wp.int64, device=device)
            records.merge = int(merge)
            records.count = wp.zeros(2, dtype=int, device=device)
            inputs = [rays, target.vertices, target.faces, face, begin, segment, seed, int(codes[deposit]), face_bits]
            dim = (-(-rays.elevation_cells // segment), end - begin)
            wp.launch(kernels.record_kernel, dim, inputs=inputs, outputs=[records], device=device, block_dim=block)
            lost, taken, key, row = sorted_rows(records.rows, records.count, key_bits)
            if not lost:
                return records, key, row
            capacity = 4 * capacity if merge else taken

    def band(begin: int) -> tuple[Any, ...] | None:
        end = min(begin + width, last)
        sent = (end - begin) * rays.elevation_cells
        records, key, row = recorded(begin, end, int(rows_expected(begin, end)) + 1024)
        if progress is not None:
            progress.update(sent)
        n = row.shape[0]
        if not n:
            return None
        found = tuple(wp.empty(n, dtype=dtype, device=device) for dtype in dtypes)
        mesh = [rays, target.vertices, target.faces]
        if device.is_cpu:
            inputs = [*mesh, records.rows, records.quanta, key, row, face_bits]
            blocks = -(-n // hit_lanes.LANES)
            wp.launch(hit_lanes.hit_kernel, blocks, inputs=inputs, outputs=list(found), device=device)
        else:
            inputs = [*mesh, records, key, row, face_bits]
            wp.launch(kernels.hit_kernel, n, inputs=inputs, outputs=list(found), device=device, block_dim=block)
        return found

    names = ("pixel", "face", "barycentric", "weight", "point", "cos_incidence", "cos_twist", "cos2_azimuth")
    dtypes = (int, int, wp.vec2, float, wp.vec3, float, float, float)
    for module in [kernels, record_lanes, hit_lanes] if device.is_cpu else [kernels]:
        wp.load_module(module, device=device, block_dim=block)
    tasks = [partial(band, begin) for begin in range(first, last, width)]
    parts = [part for part in threads.ordered(tasks, device) if part is not None]
    total_rays = (last - first) * rays.elevation_cells
    whole = [partial(concatenate, [part[k] for part in parts], dtype, device) for k, dtype in enumerate(dtypes)]
    arrays: dict[str, Any] = dict(zip(names, threads.ordered(whole, device), strict=True))
    return Hits(grid, geometry, rays_per_m2=rays_per_m2, seed=seed, rays=total_rays, **arrays)


def nearest_faces(target: Target, rays: Any, begin: int, end: int, seed: int) -> Any:
    """The face that each ray of the azimuth cells `begin` to `end` meets first, or -1; int, shape (rays of the band,),
    the elevation cells of one azimuth cell side by side."""
    face = wp.empty((end - begin) * rays.elevation_cells, dtype=int, device=target.device)
    # a CPU launch walks its threads one after the other: down the columns
    tile = (1, rays.elevation_cells) if target.device.is_cpu else _TILE
    dim = (-(-(end - begin) // tile[0]), -(-rays.elevation_cells // tile[1]), tile[0] * tile[1])
    inputs = [rays, target.bvh.id, begin, end, *tile, seed]
    wp.launch(kernels.query_kernel, dim, inputs=inputs, outputs=[face], device=target.device, block_dim=kernels.BLOCK)
    return face


def recorded_in_columns(
    target: Target,
    rays: Any,
    face: Any,
    begin: int,
    end: int,
    capacity: int,
    seed: int,
    deposit: int,
    face_bits: int,
    quanta: float,
) -> tuple[Any, int]:
    """Records of the band's rays on the CPU, merged, in the order in which their columns left them: rows as in
    `kernels.trace.Records`, with the key itself, and how many. `capacity` of them are expected at most."""
    device, columns = target.device, (end - begin) // rays.cells_per_column
    across, along = (wp.empty(face.shape[0] + record_lanes.LANES, dtype=float, device=device) for _ in range(2))
    inputs = [rays, begin, seed]
    wp.launch(record_lanes.jitter_kernel, end - begin, inputs=inputs, outputs=[across, along], device=device)
    while True:
        taken = wp.zeros(1, dtype=int, device=device)
        rows = wp.empty((capacity, 4), dtype=wp.int64, device=device)
        link = wp.empty(capacity, dtype=int, device=device)
        head = wp.empty(1 << (capacity // columns).bit_length(), dtype=int, device=device)
        inputs = [rays, target.vertices, target.faces, face, across, along, begin, int(deposit), face_bits, quanta]
        outputs = [head, link, taken, rows]
        wp.launch(record_lanes.record_kernel, columns, inputs=inputs, outputs=outputs, device=device)
        found = int(taken.numpy()[0])
        if found <= capacity:
            return rows, found
        capacity = found
