"""A mesh on a device."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpsar.kernels import raster
from warpsar.kernels import trace as kernels
from warpsar.kernels.geometry import Triangles
from warpsar.kernels.wide import WARP
from warpsar.runtime.structs import fill
from warpsar.world.frame import ViewGeometry
from warpsar.world.mesh import Mesh


@dataclass
class Target:
    """A mesh on a device, its coordinates [m] about the reference point."""

    device: wp.Device
    vertices: wp.array
    """vec3 [m], shape (n,)."""
    faces: wp.array
    """int, shape (m, 3)."""
    corners: np.ndarray
    """The vertices on the host: float64 [m], shape (n, 3)."""
    places: wp.array
    """The vertices on the device in double precision: vec3d [m], shape (n,)."""
    _ends: dict[bytes, np.ndarray] = field(default_factory=dict)
    _bvh: wp.Mesh | None = None
    _building: Lock = field(default_factory=Lock)

    @classmethod
    def upload(cls, mesh: Mesh, reference_point_m: ArrayLike, device: wp.Device) -> Target:
        """Copy a mesh to a device; `reference_point_m` (3,) [m] becomes the origin."""
        corners = np.asarray(mesh.vertices, np.float64) - np.asarray(reference_point_m, np.float64)
        vertices: wp.array = wp.array(corners.astype(np.float32), dtype=wp.vec3, device=device)
        faces: wp.array = wp.array(np.ascontiguousarray(mesh.faces, np.int32), dtype=int, device=device)
        places: wp.array = wp.array(corners, dtype=wp.vec3d, device=device, copy=False)
        return cls(device, vertices, faces, corners, places)

    @cached_property
    def triangles(self) -> Any:
        """Vertices and faces as kernels take them."""
        return fill(Triangles, vertices=self.vertices, faces=self.faces)

    @cached_property
    def corner_numbers(self) -> np.ndarray:
        """The faces on the host: int32, shape (m, 3)."""
        return self.faces.numpy()

    @cached_property
    def places_once(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices of faces, those at one place as one, shape (n, 3), and the faces' corners among them, (m, 3).

        Outlines are found by shared edges. Of a mesh in several views they are the same.
        """
        return self.places_of(self.corner_numbers)

    def places_of(self, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`places_once` of some of the faces, the numbers of their corners, shape (m, 3)."""
        index, corners = np.unique(faces.ravel(), return_inverse=True)
        used, once = np.unique(self.corners[index], axis=0, return_inverse=True)
        return used, once.ravel()[corners.ravel()].reshape(-1, 3)

    @property
    def bvh(self) -> wp.Mesh:
        """The faces as a tree, built when a ray first asks for it: most views are traced without one (`Raster`)."""
        with self._building:  # bands ask for it side by side
            if self._bvh is None:
                # Measured on CUDA (docs/benchmarks.md): cuBQL with two faces a leaf traces fastest, and is built in a
                # sixth of SAH's time.
                constructor, leaf = ("sah", None) if self.device.is_cpu else ("cubql", 2)
                faces = self.faces.flatten()
                self._bvh = wp.Mesh(self.vertices, faces, bvh_constructor=constructor, bvh_leaf_size=leaf)
        return self._bvh

    def ends(self, geometry: ViewGeometry) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest (X . d, X . u, elevation, distance from the track) of the mesh, float64, shape (4,) each.

        Elevation is X . v [m]; with a track it is the angle about the track [rad]. The device finds them, because the
        host takes as long for a million vertices as CUDA does for all of their image. They are stored: a view's rays
        are counted first and traced later.
        """
        track = geometry.slant_range_m or 0.0
        key = np.concatenate([geometry.d, geometry.u, geometry.v, [track]]).tobytes()
        if key in self._ends:
            return self._ends[key][:4], -self._ends[key][4:]
        axes = [wp.vec3d(*axis) for axis in (geometry.d, geometry.u, geometry.v)]
        threads = 1 if self.device.is_cpu else 512 * WARP
        ends = wp.empty((-(-threads // WARP), 8), dtype=wp.float64, device=self.device)
        inputs = [self.places, *axes, track, threads]
        wp.launch(
            kernels.extent_kernel, threads, inputs=inputs, outputs=[ends], device=self.device, block_dim=kernels.BLOCK
        )
        self._ends[key] = found = ends.numpy().min(axis=0)
        return found[:4], -found[4:]

    @cached_property
    def area_m2(self) -> float:
        """Area of all faces together."""
        area = wp.empty(1 if self.device.is_cpu else 16384, dtype=wp.float64, device=self.device)
        inputs = [self.triangles]
        wp.launch(
            raster.area_kernel, area.shape[0], inputs=inputs, outputs=[area], device=self.device, block_dim=raster.BLOCK
        )
        return float(area.numpy().sum())
