"""The nearest face of every ray of a view, face by face instead of ray by ray.

All rays of a view form one grid across the look direction. So a face is tested only against the rays whose cells it
covers, and each ray keeps its nearest face. This needs no BVH, reads memory in order, and finds the same faces several
times faster (docs/benchmarks.md). Rays in any other direction, such as those of a second bounce, still need the BVH.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from warpsar.kernels import raster
from warpsar.kernels import raster_lanes as lanes
from warpsar.kernels.geometry import RayGrid
from warpsar.runtime.launches import Launch, by_elements
from warpsar.trace.target import Target

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
        self._corner, self._slack = _projected(target, grid)
        self._cells: wp.array = wp.empty(faces, dtype=wp.vec4i, device=device)
        inputs = [grid, self._corner, target.faces, self._slack]
        pieces = by_elements([target.faces, self._cells])
        Launch(raster.extent_kernel, faces, inputs, [self._cells], device, pieces).launch()
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
        azimuth, higher = (wp.empty(room, dtype=float, device=device) for _ in range(2))
        # what rays about a track need besides
        track = [wp.empty(room if grid.slant_range else 0, dtype=float, device=device) for _ in range(3)]
        depth: wp.array = wp.full(room, np.inf, dtype=float, device=device)
        found: wp.array = wp.full(room, -1, dtype=int, device=device)
        inputs, outputs = [grid, first, seed], [azimuth, higher, *track]
        wp.launch(lanes.ray_kernel, last - first, inputs=inputs, outputs=outputs, device=device)
        wp.launch(
            lanes.raster_kernel,
            near.stop - near.start,
            inputs=[
                self.grid,
                self._corner,
                self.target.faces,
                self._cells,
                self._order,
                near.start,
                azimuth,
                higher,
                *track,
                first,
                last - 1,
                self._slack,
            ],
            outputs=[depth, found],
            device=device,
        )
        return found[:rays]


class ParallelRaster:
    """`Raster` for a device that takes many faces at once.

    A ray's nearest face is the least of the numbers that hold (distance, face): the same in any order of the faces.
    """

    def __init__(self, target: Target, grid: RayGrid) -> None:
        self.target, self.grid = target, grid
        self._corner, self._slack = _projected(target, grid)

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
        target, grid, device = self.target, self.grid, self.target.device
        faces, rays = target.faces.shape[0], (last - first) * grid.elevation_cells
        found: wp.array = wp.full(rays, raster.NO_FACE, dtype=wp.int64, device=device)
        large: wp.array = wp.zeros(1, dtype=wp.int64, device=device)
        large_face: wp.array = wp.empty(faces, dtype=int, device=device)
        large_begin: wp.array = wp.empty(faces, dtype=wp.int64, device=device)
        wp.launch(
            raster.draw_kernel,
            faces * raster.FACE_LANES,
            inputs=[grid, self._corner, target.faces, first, last - 1, self._slack, seed, found, large],
            outputs=[large_face, large_begin],
            device=device,
            block_dim=raster.BLOCK,
        )
        wp.launch(
            raster.draw_large_kernel,
            _GROUPS * raster.FACE_LANES,
            inputs=[
                grid,
                self._corner,
                target.faces,
                first,
                self._slack,
                seed,
                _GROUPS,
                large,
                large_face,
                large_begin,
            ],
            outputs=[found],
            device=device,
            block_dim=raster.BLOCK,
        )
        return _low_half(found)


def _projected(target: Target, grid: RayGrid) -> tuple[wp.array, float]:
    """The mesh's vertices from `kernels.raster.project_kernel` (vec4), and how far they may be off [cells]."""
    device, vertices = target.device, target.vertices.shape[0]
    wp.load_module(raster, device=device, block_dim=raster.BLOCK)
    corner: wp.array = wp.empty(vertices, dtype=wp.vec4, device=device)
    inputs = [grid, target.vertices]
    wp.launch(raster.project_kernel, vertices, inputs=inputs, outputs=[corner], device=device, block_dim=raster.BLOCK)
    # in float32 a corner's place is uncertain by about 2^-22 of the grid
    return corner, 1e-3 + 1e-6 * max(grid.elevation_cells, grid.cols * grid.cells_per_column)


def _low_half(values: wp.array) -> wp.array:
    """The low 32 bits of int64 `values`, as int in the same memory."""
    halves: wp.array = wp.array(
        ptr=values.ptr, dtype=int, shape=values.shape, strides=(8,), device=values.device, copy=False
    )
    halves._ref = values  # type: ignore[assignment]  # Warp frees the memory with its last owner
    return halves
