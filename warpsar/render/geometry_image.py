"""One view's image as a function of the mesh's vertices, with its gradient: rays keep the faces that they met."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.kernels.geometry_image import geometry_image_kernel
from warpsar.runtime.program import Program
from warpsar.surface.stage import Stage
from warpsar.trace.hits import BinGrid
from warpsar.trace.rays import ray_grid
from warpsar.trace.trace import trace
from warpsar.world.frame import ViewGeometry


class GeometryImage:
    """beta0 from `vertices`, every ray's power split linearly between the two nearest rows ("linear" deposit).

    Range, incidence, twist, area and the place on the surface follow the vertices; the face that a ray meets does
    not. So the gradient is that of surfaces that move and turn inside their outlines. It does not count what appears or
    gets hidden at a silhouette or at a shadow's edge. `vertices` [m] about the reference point, shape (n,), vec3, and
    `nodes` (learned coordinates) are device arrays with gradients.
    """

    def __init__(
        self,
        stage: Stage,
        geometry: ViewGeometry,
        grid: BinGrid,
        rays_per_m2: float,
        polarization: str = "HH",
        *,
        seed: int = 0,
    ) -> None:
        target, device = stage.target, stage.target.device
        hits = trace(target, geometry, grid, rays_per_m2, seed=seed, deposit="nearest", merge=False)
        points = hits.point.numpy().astype(float)
        across = points @ geometry.v
        if geometry.slant_range_m is not None:
            across = np.arctan2(across, geometry.slant_range_m + points @ geometry.d)

        def put(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device=device)

        self.shape = grid.shape
        self.program = Program(device)
        self.vertices = self.program.array(len(target.corners), wp.vec3)
        self.vertices.assign(target.corners.astype(np.float32))
        self.nodes = self.program.array(len(stage.surface.nodes))
        self.nodes.assign(stage.surface.nodes.astype(np.float32))
        self.image = self.program.array(grid.shape[0] * grid.shape[1], sum_into=True)
        self.program.launch(
            geometry_image_kernel,
            hits.count,
            [
                ray_grid(target, geometry, grid, rays_per_m2, grid.pixel_area_m2),
                put(points @ geometry.u, float),
                put(across, float),
                hits.face,
                put(hits.pixel.numpy() % grid.shape[1], int),
                self.vertices,
                target.faces,
                stage.face_material,
                stage.uv,
                stage.places,
                self.nodes,
                Polarization[polarization],
                stage.variant,
                geometry.wavenumber,
                int(stage.local_basis),
                stage.spectrum,
                stage.eps_im,
                stage.aspect,
            ],
            [self.image],
        )

    def forward(self) -> np.ndarray:
        """beta0, shape (rows, cols), float32."""
        self.program.forward()
        return np.asarray(self.image.numpy().reshape(self.shape).copy())

    def gradient(self, seed: np.ndarray) -> np.ndarray:
        """d sum(seed * beta0) / d vertices [1/m], shape (n, 3), after `forward`; `seed` of shape (rows, cols)."""
        self.program.backward({self.image: np.ascontiguousarray(seed, np.float32).ravel()})
        return np.asarray(self.vertices.grad.numpy().copy())
