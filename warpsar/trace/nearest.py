"""The nearest face of every ray of a view, face by face instead of ray by ray.

All rays of a view form one grid across the look direction. So a face is tested only against the rays whose cells it
covers, and each ray keeps its nearest face. This needs no BVH, reads memory in order, and finds the same faces several
times faster (docs/benchmarks.md). Rays in any other direction, such as those of a second bounce, still need the BVH.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import raster
from warpsar.kernels import raster_lanes as lanes
from warpsar.kernels.geometry import Band, RayGrid
from warpsar.runtime.launches import Launch, by_elements
from warpsar.runtime.structs import allocate, fill
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
