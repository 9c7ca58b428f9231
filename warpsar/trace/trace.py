"""A view traced once: its lit surface as hits in bins of range and azimuth."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpsar.errors import InputError
from warpsar.kernels import hit_lanes, raster, record_lanes
from warpsar.kernels import raster_lanes as lanes
from warpsar.kernels import trace as kernels
from warpsar.kernels.codes import Deposit
from warpsar.kernels.geometry import Band, RayGrid
from warpsar.runtime import threads
from warpsar.runtime.launches import Launch, by_elements
from warpsar.runtime.structs import allocate, fill
from warpsar.trace.hits import ARRAYS, DEFAULT_MEMORY_GIB, BinGrid, Hits, concatenate
from warpsar.trace.merge import rows_by_key, sorted_rows
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target
from warpsar.world.frame import ViewGeometry

# ---- the nearest face of every ray, face by face instead of ray by ray


# Nanoseconds of one core: to look at a face, to test a ray against a face, to send a ray through the BVH
# (benchmarks/rays.py).
_FACE_NS, _TEST_NS, _QUERY_NS = 45.0, 6.0, 400.0
# The same for an H200 as a whole: only their ratios count.
_CUDA_FACE_NS, _CUDA_TEST_NS, _CUDA_QUERY_NS = 0.2, 0.02, 0.1
_GROUPS = 2**17  # groups of CUDA threads that walk the strips of large faces


class Raster:
    """The faces of `target` as the rays of `grid` meet them.

    Sources: Pineda 1988 (edge functions); Catmull 1974 (a depth per ray); Woop, Benthin and Wald 2013 (differences
    taken per ray, so that faces with a common edge leave no gap).
    """

    def __init__(self, target: Target, grid: RayGrid, cells: tuple[int, int] | None = None) -> None:
        """`tests` becomes the number of (ray, face) pairs in the azimuth `cells`: the first and the last, or all."""
        self.target, self.grid = target, grid
        cells = cells or (grid.first_cell, grid.end_cell - 1)
        device, faces = target.device, target.faces.shape[0]
        self._mesh = _projected(target, grid)
        self._cells: wp.array = wp.empty(faces, dtype=wp.vec4i, device=device)
        pieces = by_elements([target.faces, self._cells])
        Launch(raster.extent_kernel, faces, [grid, self._mesh], [self._cells], device, pieces).launch()
        first, order = wp.empty(grid.cols + 1, dtype=int, device=device), wp.zeros(faces, dtype=int, device=device)
        counts = wp.zeros(2, dtype=wp.float64, device=device)
        inputs, outputs = [self._cells, grid.cells_per_column, *cells], [first, order, counts]
        wp.launch(lanes.sort_kernel, 1, inputs=inputs, outputs=outputs, device=device)
        self._begin, self._order = first.numpy(), order
        self.tests, widest = counts.numpy().tolist()
        self._widest = int(widest) // grid.cells_per_column + 1

    @classmethod
    def where_it_pays(cls, target: Target, grid: RayGrid, first: int, last: int) -> Raster | None:
        """The raster, if all rays of the azimuth cells `first` to `last` - 1 take less time in it than in the BVH."""
        query = _QUERY_NS * (last - first) * grid.elevation_cells - _FACE_NS * target.faces.shape[0]
        if query < 0:
            return None
        raster = cls(target, grid, (first, last - 1))
        return raster if _TEST_NS * raster.tests < query else None

    def nearest(self, first: int, last: int, seed: int) -> wp.array:
        """The face that each ray of the azimuth cells `first` to `last` - 1 meets first, or -1.

        int32, shape ((last - first) * elevation_cells,). Of faces at the same distance it is the first in the mesh.
        """
        device, grid = self.target.device, self.grid
        columns = first // self.grid.cells_per_column - self._widest, -(-last // self.grid.cells_per_column)
        near = slice(int(self._begin[max(0, columns[0])]), int(self._begin[columns[1]]))
        rays = (last - first) * grid.elevation_cells
        room = rays + lanes.LANES
        # what only rays about a track need
        needless = {} if grid.slant_range else dict.fromkeys(("along", "cosine", "sine"))
        band, each = (
            fill(Band, first_cell=first, end_cell=last, seed=seed),
            allocate(lanes.BandRays, room, device, **needless),
        )
        found = fill(
            lanes.Nearest,
            depth=wp.full(room, np.inf, dtype=float, device=device),
            face=wp.full(room, -1, dtype=int, device=device),
        )
        wp.launch(lanes.ray_kernel, last - first, inputs=[grid, band], outputs=[each], device=device)
        mine = fill(lanes.InColumns, cells=self._cells, order=self._order, begin=near.start)
        inputs = [grid, self._mesh, mine, band, each]
        wp.launch(lanes.raster_kernel, near.stop - near.start, inputs=inputs, outputs=[found], device=device)
        return found.face[:rays]


class ParallelRaster:
    """`Raster` for a device that takes many faces at once.

    A ray's nearest face is the least of the numbers that hold (distance, face): the same in any order of the faces.
    """

    def __init__(self, target: Target, grid: RayGrid) -> None:
        self.target, self.grid = target, grid
        self._mesh = _projected(target, grid)

    @classmethod
    def where_it_pays(cls, target: Target, grid: RayGrid, first: int, last: int) -> ParallelRaster | None:
        """As for `Raster`, but estimated from the mesh's area: for an exact count the host would have to wait."""
        share = (last - first) / max(grid.end_cell - grid.first_cell, 1)
        across = grid.elevation_step * (grid.slant_range or 1.0)
        # Half of a surface's area is seen on average over all directions, in rectangles of twice that.
        tests = share * target.area_m2 / (grid.azimuth_step * across)
        query = _CUDA_QUERY_NS * (last - first) * grid.elevation_cells
        return cls(target, grid) if _CUDA_FACE_NS * target.faces.shape[0] + _CUDA_TEST_NS * tests < query else None

    def nearest(self, first: int, last: int, seed: int) -> wp.array:
        """As for `Raster`; a view of every other element of an array twice as long."""
        grid, device = self.grid, self.target.device
        faces, rays = self.target.faces.shape[0], (last - first) * grid.elevation_cells
        found: wp.array = wp.full(rays, raster.NO_FACE, dtype=wp.int64, device=device)
        large = allocate(raster.LargeFaces, faces, device, count=wp.zeros(1, dtype=wp.int64, device=device))
        seen = [grid, self._mesh, fill(Band, first_cell=first, end_cell=last, seed=seed)]
        wp.launch(
            raster.draw_kernel,
            faces * raster.FACE_LANES,
            inputs=seen,
            outputs=[found, large],
            device=device,
            block_dim=raster.BLOCK,
        )
        wp.launch(
            raster.draw_large_kernel,
            _GROUPS * raster.FACE_LANES,
            inputs=[*seen, large, _GROUPS],
            outputs=[found],
            device=device,
            block_dim=raster.BLOCK,
        )
        return _low_half(found)


def _projected(target: Target, grid: RayGrid) -> Any:
    """The mesh's `kernels.raster.Projection`."""
    device, vertices = target.device, target.vertices.shape[0]
    wp.load_module(raster, device=device, block_dim=raster.BLOCK)
    corner: wp.array = wp.empty(vertices, dtype=wp.vec4, device=device)
    inputs = [grid, target.vertices]
    wp.launch(raster.project_kernel, vertices, inputs=inputs, outputs=[corner], device=device, block_dim=raster.BLOCK)
    # in float32 a corner's place is uncertain by about 2^-22 of the grid
    slack = 1e-3 + 1e-6 * max(grid.elevation_cells, grid.cols * grid.cells_per_column)
    return fill(raster.ProjectedVertices, corner=corner, faces=target.faces, slack=slack)


def _low_half(values: wp.array) -> wp.array:
    """The low 32 bits of int64 `values`, as int in the same memory."""
    halves: wp.array = wp.array(
        ptr=values.ptr, dtype=int, shape=values.shape, strides=(8,), device=values.device, copy=False
    )
    halves._ref = values  # type: ignore[assignment]  # Warp frees the memory with its last owner
    return halves


# Bytes of a ray at most: its face, what the raster keeps of it, two rows of its band's table, their marks and ranks.
_RAY_BYTES = 96
_BAND_RAYS = 2**20  # of a CPU's band: smaller bands share more faces, larger ones leave cores without work
_LEAST_RAYS = 2**16  # of a CPU's band where there are fewer than 8: starting its kernels takes as long as they do
_TILE = (4, 8)  # rays of a CUDA warp: across azimuth, along elevation
_SEGMENT = 4  # rays of one CUDA thread when they are recorded
_DEPOSITS = {code.name.lower(): code for code in Deposit}


class Progress(Protocol):
    """What counts the rays that are done, such as a tqdm bar."""

    def update(self, n: int) -> object: ...


def trace(
    target: Target,
    geometry: ViewGeometry,
    grid: BinGrid,
    rays_per_m2: float,
    *,
    seed: int = 0,
    deposit: str = "footprint",
    merge: bool = True,
    pixel_area_m2: float | None = None,
    only_columns: tuple[int, int] | None = None,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    progress: Progress | None = None,
) -> Hits:
    """Trace one view and bin it.

    `rays_per_m2`: rays over the plane across the look direction [1/m^2].
    `deposit`: where a ray's power goes. "nearest": to the bin of its sample. "footprint": to the range bins that its
    cell covers on the facet's plane. "linear": split between the two nearest bin centres in range (differentiable).
    `merge`: hits of one face in one bin become one.
    `pixel_area_m2` [m^2] divides the weights. It is a bin's own area, unless the grid is finer than the image.
    `only_columns`: trace the grid's columns from the first to the one before the second, with the rays that they have
    in the whole grid.
    `max_memory_gib` [GiB] bounds the memory beside the hits themselves.

    The result does not depend on the memory, on the number of threads, or on the order of CUDA's threads. Raises
    InputError where pixels and faces are too many to be numbered, or where the mesh reaches the track.
    """
    rays = ray_grid(target, geometry, grid, rays_per_m2, pixel_area_m2 or grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    if only_columns is not None:
        first = max(first, only_columns[0] * rays.cells_per_column)
        last = max(first, min(last, only_columns[1] * rays.cells_per_column))
    bands = _Bands(target, rays, (first, last), rays_per_m2, seed, deposit, merge)
    width = bands.width(max_memory_gib)
    bands.prepare()

    def one(begin: int) -> Any:
        end = min(begin + width, last)
        found = bands.hits(begin, end)
        if progress is not None:
            progress.update((end - begin) * rays.elevation_cells)
        return found

    tasks = [partial(one, begin) for begin in range(first, last, width)]
    parts = [part for part in threads.ordered(tasks, target.device) if part is not None]
    whole = [
        partial(concatenate, [getattr(part, name) for part in parts], dtype, target.device)
        for name, dtype in ARRAYS.items()
    ]
    arrays: dict[str, Any] = dict(zip(ARRAYS, threads.ordered(whole, target.device), strict=True))
    total_rays = (last - first) * rays.elevation_cells
    return Hits(grid, geometry, rays_per_m2=rays_per_m2, seed=seed, rays=total_rays, **arrays)


class _Bands:
    """The rays of a view's azimuth `cells` (from the first to the one before the second), traced band by band.

    A band is a stretch of azimuth cells that has its own table of records. It holds whole columns of pixels, so that no
    two bands share a pixel.
    """

    def __init__(
        self,
        target: Target,
        rays: RayGrid,
        cells: tuple[int, int],
        rays_per_m2: float,
        seed: int,
        deposit: str,
        merge: bool,
    ) -> None:
        self.target, self.rays, self.cells = target, rays, cells
        self.seed, self.deposit, self.merge = seed, int(_DEPOSITS[deposit]), merge
        self.device = target.device
        self.faces = int(target.faces.shape[0])
        self.face_bits = max(1, (self.faces - 1).bit_length())
        self.key_bits = self.face_bits + max(1, (rays.rows * rays.cols - 1).bit_length())
        if self.key_bits > 62:
            raise InputError(
                f"[image] shape: {rays.rows} x {rays.cols} pixels with {self.faces} faces cannot be "
                f"numbered in 62 bits; allowed are {2 ** (62 - self.face_bits)} pixels"
            )
        # a ray's own weight is at least 2^29 quanta, and at grazing incidence 1e6 times as much
        self.quanta = 2.0 ** (30 - math.floor(math.log2(1.0 / (rays_per_m2 * rays.pixel_area))))
        self.raster: Raster | ParallelRaster | None = None  # None: rays go through the BVH

    def width(self, max_memory_gib: float) -> int:
        """Azimuth cells of a band: as many whole columns as the memory allows, and 8 bands or more on a CPU if they
        are not too small."""
        rays, (first, last) = self.rays, self.cells
        workers = threads.thread_count() if self.device.is_cpu else 1
        # rows are numbered in 31 bits
        most_rays = min(max_memory_gib * 2**30 / workers / _RAY_BYTES, 2**29)
        columns = -(-(last - first) // rays.cells_per_column)
        room = int(most_rays / max(rays.elevation_cells, 1)) // rays.cells_per_column
        if self.device.is_cpu:
            # not by the number of threads: the bands' order is that of the hits
            count = (last - first) * rays.elevation_cells
            pieces = max(1, min(8, count // _LEAST_RAYS), count // _BAND_RAYS)
            room = min(room, -(-columns // pieces))
        return max(1, min(room, columns)) * rays.cells_per_column

    def prepare(self) -> None:
        """Choose how rays find their faces, and load the kernels."""
        kind: type[Raster | ParallelRaster] = Raster if self.device.is_cpu else ParallelRaster
        self.raster = kind.where_it_pays(self.target, self.rays, *self.cells)
        for module in [kernels, record_lanes, hit_lanes] if self.device.is_cpu else [kernels]:
            wp.load_module(module, device=self.device, block_dim=kernels.BLOCK)

    def hits(self, begin: int, end: int) -> Any:
        """The `kernels.HitArrays` of the azimuth cells `begin` to `end` - 1; None where no ray meets a face."""
        records, key, row = self._recorded(begin, end)
        n = row.shape[0]
        if not n:
            return None
        found = allocate(kernels.HitArrays, n, self.device)
        inputs = [self.rays, self.target.triangles, records, key, row]
        if self.device.is_cpu:
            blocks = -(-n // hit_lanes.LANES)
            wp.launch(hit_lanes.hit_kernel, blocks, inputs=inputs, outputs=[found], device=self.device)
        else:
            block = kernels.BLOCK
            wp.launch(kernels.hit_kernel, n, inputs=inputs, outputs=[found], device=self.device, block_dim=block)
        return found

    def _recorded(self, begin: int, end: int) -> tuple[kernels.Records, wp.array, wp.array]:
        """Records of a band's rays; their keys in order (int64), and their rows (int)."""
        if self.raster is None:
            face = nearest_faces(self.target, self.rays, begin, end, self.seed)
        else:
            face = self.raster.nearest(begin, end, self.seed)
        records = fill(kernels.Records, quanta=self.quanta, face_bits=self.face_bits, merge=int(self.merge))
        capacity = self._expected_rows(begin, end)
        if self.device.is_cpu and self.merge:
            taken = self._record_in_columns(records, face, begin, end, capacity)
            return records, *rows_by_key(records.rows, taken, self.key_bits)
        segment = self.rays.elevation_cells if self.device.is_cpu else _SEGMENT
        dim = (-(-self.rays.elevation_cells // segment), end - begin)
        inputs = [self.rays, self.target.triangles, self._band(begin, end), face, segment, self.deposit]
        device, block = self.device, kernels.BLOCK
        while True:
            records.rows = wp.zeros((capacity, 4), dtype=wp.int64, device=device)
            records.count = wp.zeros(2, dtype=int, device=device)
            wp.launch(kernels.record_kernel, dim, inputs=inputs, outputs=[records], device=device, block_dim=block)
            lost, taken, key, row = sorted_rows(records.rows, records.count, self.key_bits)
            if not lost:
                return records, key, row
            capacity = 4 * capacity if self.merge else taken

    def _expected_rows(self, begin: int, end: int) -> int:
        """Rows of the table for the azimuth cells `begin` to `end` - 1, with as many left free."""
        expected = 2.0 * (end - begin) * self.rays.elevation_cells
        if self.merge:
            # As many (pixel, face) as two nets of cells cut one another into, one surface deep; more is retried.
            pixels = self.rays.rows * (end - begin) / self.rays.cells_per_column
            lit = self.faces * (end - begin) / max(self.rays.end_cell - self.rays.first_cell, 1)
            expected = min(expected, 2.0 * (math.sqrt(pixels) + math.sqrt(lit)) ** 2)
        return int(expected) + 1024

    def _band(self, begin: int, end: int) -> Any:
        return fill(Band, first_cell=begin, end_cell=end, seed=self.seed)

    def _record_in_columns(self, records: kernels.Records, face: wp.array, begin: int, end: int, capacity: int) -> int:
        """Merge the band's rays on the CPU into `records`, in the order in which their columns leave them; how many.

        `capacity` of them are expected at most.
        """
        rays, device, columns = self.rays, self.device, (end - begin) // self.rays.cells_per_column
        band, jitters = (
            self._band(begin, end),
            allocate(record_lanes.Jitters, face.shape[0] + record_lanes.LANES, device),
        )
        wp.launch(record_lanes.jitter_kernel, end - begin, inputs=[rays, band], outputs=[jitters], device=device)
        inputs = [rays, self.target.triangles, band, face, jitters, self.deposit]
        while True:
            records.count = wp.zeros(2, dtype=int, device=device)
            records.rows = wp.empty((capacity, 4), dtype=wp.int64, device=device)
            head = wp.empty(1 << (capacity // columns).bit_length(), dtype=int, device=device)
            chains = allocate(record_lanes.Chains, capacity, device, head=head)
            wp.launch(record_lanes.record_kernel, columns, inputs=inputs, outputs=[chains, records], device=device)
            found = int(records.count.numpy()[1])
            if found <= capacity:
                return found
            capacity = found


def nearest_faces(target: Target, rays: RayGrid, begin: int, end: int, seed: int) -> wp.array:
    """The face that each ray of the azimuth cells `begin` to `end` - 1 meets first in the BVH, or -1.

    int, shape (rays of the band,): the elevation cells of one azimuth cell lie side by side.
    """
    face = wp.empty((end - begin) * rays.elevation_cells, dtype=int, device=target.device)
    # a CPU launch walks its threads one after the other: down the columns
    tile = (1, rays.elevation_cells) if target.device.is_cpu else _TILE
    dim = (-(-(end - begin) // tile[0]), -(-rays.elevation_cells // tile[1]), tile[0] * tile[1])
    inputs = [rays, fill(Band, first_cell=begin, end_cell=end, seed=seed), target.bvh.id, *tile]
    wp.launch(kernels.query_kernel, dim, inputs=inputs, outputs=[face], device=target.device, block_dim=kernels.BLOCK)
    return face
