"""The nearest face of every ray of a view on the CPU, face by face instead of ray by ray.

All rays of a view are one grid across the look direction, so a face can be held against the few rays whose cells it
covers, and the nearest face of each ray be kept. That asks no BVH, walks memory in order, and finds the same faces
several times faster (docs/benchmarks.md). Rays that go anywhere, such as those of a second bounce, still need the
BVH.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import warp as wp

    from warpsar.trace import Target

# Nanoseconds of one core: a face looked at, a ray held against a face, a ray through the BVH (benchmarks/rays.py).
_FACE_NS, _TEST_NS, _QUERY_NS = 60.0, 20.0, 400.0


class Raster:
    """The faces of `target` as the rays of `grid` (a RayGrid) meet them.

    Sources: Pineda 1988 (edge functions); Catmull 1974 (a depth per ray); Woop, Benthin and Wald 2013 (differences
    taken per ray, so that faces with a common edge leave no gap).
    """

    def __init__(self, target: Target, grid: Any) -> None:
        import warp as wp

        from warpsar.kernels import raster as kernels

        self.target, self.grid = target, grid
        device, vertices, faces = target.device, target.vertices.shape[0], target.faces.shape[0]
        # float32 leaves a corner's own cell uncertain by 2^-22 or so of the grid
        self._slack = 1e-3 + 1e-6 * max(grid.elevation_cells, grid.cols * grid.cells_per_column)
        self._corner: Any = wp.empty(vertices, dtype=wp.vec4, device=device)
        self._cells: Any = wp.empty(faces, dtype=wp.vec4i, device=device)
        wp.load_module(kernels, device=device)
        wp.launch(
            kernels.project_kernel, vertices, inputs=[grid, target.vertices], outputs=[self._corner], device=device
        )
        wp.launch(
            kernels.extent_kernel,
            faces,
            inputs=[grid, self._corner, target.faces, self._slack],
            outputs=[self._cells],
            device=device,
        )
        cells = self._cells.numpy()
        # Faces by their first column: 16 bits, where they do, are sorted in one pass.
        column = (cells[:, 0] // grid.cells_per_column).astype(np.uint16 if grid.cols < 2**16 else np.int32)
        self._order = np.argsort(column, kind="stable").astype(np.int32)
        self._begin = np.searchsorted(column[self._order], np.arange(grid.cols + 1))
        self._last = cells[self._order, 1]
        self._widest = int((cells[:, 1] - cells[:, 0]).max(initial=0)) // grid.cells_per_column + 1

    @classmethod
    def where_it_pays(cls, target: Target, grid: Any, first: int, last: int) -> Raster | None:
        """The raster, if all rays of the azimuth cells `first` to `last` - 1 take less time in it than in the BVH."""
        query = _QUERY_NS * (last - first) * grid.elevation_cells - _FACE_NS * target.faces.shape[0]
        if query < 0:
            return None
        raster = cls(target, grid)
        cells = raster._cells.numpy()
        width = np.minimum(cells[:, 1], last - 1) - np.maximum(cells[:, 0], first) + 1.0
        height = cells[:, 3] - cells[:, 2] + 1.0
        tests = float(np.sum(np.maximum(width, 0) * np.maximum(height, 0)))
        return raster if _TEST_NS * tests < query else None

    def nearest(self, first: int, last: int, seed: int) -> wp.array:
        """The face that each ray of the azimuth cells `first` to `last` - 1 meets first, or -1.

        Shape ((last - first) * elevation_cells,), int32; of faces at the same distance the one that comes first.
        """
        import warp as wp

        from warpsar.kernels import raster as kernels

        device = self.target.device
        columns = first // self.grid.cells_per_column - self._widest, -(-last // self.grid.cells_per_column)
        near = slice(self._begin[max(0, columns[0])], self._begin[columns[1]])
        listed: Any = self._order[near][self._last[near] >= first]
        rays = (last - first) * self.grid.elevation_cells
        sample: Any = wp.empty(rays, dtype=wp.vec2, device=device)
        depth: Any = wp.full(rays, np.inf, dtype=float, device=device)
        found: Any = wp.full(rays, -1, dtype=int, device=device)
        wp.launch(kernels.sample_kernel, last - first, inputs=[self.grid, first, seed], outputs=[sample], device=device)
        wp.launch(
            kernels.raster_kernel,
            len(listed),
            inputs=[
                self.grid,
                self._corner,
                self.target.faces,
                self._cells,
                wp.array(listed, dtype=int, device=device),
                sample,
                first,
                last - 1,
                self._slack,
            ],
            outputs=[depth, found],
            device=device,
        )
        return found
