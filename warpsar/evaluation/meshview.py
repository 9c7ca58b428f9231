"""Learned parameters on the mesh: as pictures from any side, and as a PLY with vertex attributes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import warp as wp

from warpsar.io.ply import write_ply
from warpsar.kernels import shade
from warpsar.runtime import devices
from warpsar.runtime.structs import fill
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KEYS, KINDS
from warpsar.trace.hits import BinGrid, Hits
from warpsar.trace.trace import trace
from warpsar.world.frame import view_geometry

RAYS = 3  # per picture pixel and axis: edges of 10 shades
TALLEST = 0.75  # of its width: a picture of a tall mesh is made narrower instead


def parameters_at(stage: Stage, face: wp.array, barycentric: wp.array) -> dict[str, np.ndarray]:
    """Surface parameters (SI) at places on the mesh, whatever their layout: `face` (n,) int32, `barycentric` (n,) vec2,
    device arrays. By key, each of shape (n,)."""
    device = stage.target.device
    nodes: wp.array = wp.array(stage.surface.nodes.astype(np.float32), dtype=float, device=device)
    zeta = wp.empty(face.shape[0], dtype=wp.vec4, device=device)
    wp.launch(
        shade.gather_kernel,
        face.shape[0],
        inputs=[fill(shade.OnMesh, face=face, barycentric=barycentric), stage.node_map, nodes],
        outputs=[zeta],
        device=device,
    )
    coordinates = zeta.numpy().astype(float)
    return {kind.key: kind.from_coordinate(coordinates[:, k]) for k, kind in enumerate(KINDS)}


@dataclass(frozen=True)
class MeshView:
    """The mesh as seen from one side: rays that met it, several to a picture pixel, shape (n,).

    `pixel` is row * cols + col of `shape`; `point` [m] is about the reference point, (n, 3); `material` the index of
    the `face`'s; `light` is the cosine between the line of sight and the surface's normal. `stage` and `hits` are what
    was looked at and by which rays.
    """

    shape: tuple[int, int]
    pixel: np.ndarray
    point: np.ndarray
    face: np.ndarray
    material: np.ndarray
    light: np.ndarray
    stage: Stage
    hits: Hits

    @cached_property
    def parameters(self) -> dict[str, np.ndarray]:
        """By key, SI, at every ray."""
        return parameters_at(self.stage, self.hits.face, self.hits.barycentric)

    def paint(self, colours: np.ndarray) -> np.ndarray:
        """A picture, shape (rows, cols, 4), RGBA uint8, nothing behind; `colours` of the rays, (n, 3), 0 to 1."""
        shaded = colours * (0.6 + 0.4 * self.light)[:, None]
        size = self.shape[0] * self.shape[1]
        sums = np.stack([np.bincount(self.pixel, shaded[:, k], size) for k in range(3)], axis=1)
        count = np.bincount(self.pixel, minlength=size)[:, None]
        # rays are jittered: inside an outline a pixel has some more or fewer than RAYS^2, hardly ever less than half
        cover = np.minimum(count / (0.5 * RAYS**2), 1.0)
        picture = np.concatenate([sums / np.maximum(count, 1), cover], axis=1)
        return np.round(255.0 * picture).astype(np.uint8).reshape(*self.shape, 4)


def look(stage: Stage, azimuth_deg: float, incidence_deg: float, width: int = 480) -> MeshView:
    """The mesh in parallel projection from `azimuth_deg` (clockwise from north) and `incidence_deg` (from the zenith).

    Hidden surfaces are hidden by the same rays that make radar images.
    """
    target = stage.target
    geometry = view_geometry(azimuth_deg, incidence_deg, 1e9)  # the frequency means nothing here
    # to the eye of one who looks along d, u points to the left
    across, down, along = (target.corners @ axis for axis in (-geometry.u, geometry.v, geometry.d))
    size = (np.ptp(across), np.ptp(down))
    pixel_m = max(size[0] / width, size[1] / (TALLEST * width), 1e-6)
    shape = (int(np.ceil(size[1] / pixel_m)) + 1, int(np.ceil(size[0] / pixel_m)) + 1)
    cols = 2 * int(np.ceil(np.abs(across).max() / pixel_m)) + 2
    grid = BinGrid((1, cols), (2.2 * float(np.abs(along).max()) + 1.0, pixel_m))
    hits = trace(target, geometry, grid, (RAYS / pixel_m) ** 2, deposit="nearest", merge=False)
    points = hits.point.numpy().astype(float)
    row = np.clip((points @ geometry.v - down.min()) / pixel_m, 0, shape[0] - 1).astype(int)
    col = np.clip((points @ -geometry.u - across.min()) / pixel_m, 0, shape[1] - 1).astype(int)
    face = hits.face.numpy()
    return MeshView(
        shape=shape,
        pixel=row * shape[1] + col,
        point=points,
        face=face,
        material=stage.face_material.numpy()[face],
        light=hits.cos_incidence.numpy().astype(float),
        stage=stage,
        hits=hits,
    )


def write_learned_ply(path: Path, scene: Scene) -> None:
    """The mesh with its surface parameters (SI) and the material's index as attributes of the vertices, binary PLY.

    Vertices are split where materials meet, so that uniform values stay sharp; textures are sampled at the vertices.
    """
    device = devices.resolve_device("cpu")
    stage = Stage.of(scene, device)
    mesh = scene.mesh
    pairs = np.stack([mesh.faces, np.broadcast_to(mesh.face_material[:, None], mesh.faces.shape)], axis=2)
    kept, first, faces = np.unique(pairs.reshape(-1, 2), axis=0, return_index=True, return_inverse=True)
    corner = np.array([[0, 0], [1, 0], [0, 1]], np.float32)[first % 3]
    values = parameters_at(
        stage,
        wp.array((first // 3).astype(np.int32), dtype=int, device=device),
        wp.array(corner, dtype=wp.vec2, device=device),
    )
    scalars = {key: values[key] for key in KEYS} | {"material": kept[:, 1].astype(float)}
    write_ply(path, mesh.vertices[kept[:, 0]], faces.reshape(-1, 3).astype(np.int32), scalars)
