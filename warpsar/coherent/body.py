"""A mesh and its materials on a device, ready for rays, facets and edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from warpsar.coherent.rough import scatterers, surfaces
from warpsar.coherent.shape import Shape, shape_of
from warpsar.kernels.codes import Variant
from warpsar.kernels.coherent import edges, radiate, reflection, rough, tubes
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Material
from warpsar.world.world import World

OFFSET = 1e-5
"""Reflected rays start this share of the body's size off the facet: float32 would hit it again."""


@dataclass
class CoherentBody:
    """A shape on a device."""

    device: wp.Device
    shape: Shape
    tree: wp.Mesh
    rays: tubes.Body
    face_material: wp.array
    region: wp.array
    regions: wp.array
    middle: wp.array
    along: wp.array
    materials: tuple[Material, ...]
    hull: NDArray[np.float64]
    """The vertices that can be outermost, (n, 3) [m]."""
    origin: NDArray[np.float64]
    """The body's middle about the scene's reference point, (3,) [m]. All other places are about the middle."""
    variant: int
    surfaces: wp.array
    scatterers: wp.array | None
    """Of rough faces; None without."""
    scatterer_points: wp.array
    scatterer_normals: wp.array

    @classmethod
    def of(cls, world: World, device: wp.Device) -> CoherentBody:
        """Upload the mesh of a scene. Rays see it about its own middle, where float32 is finest."""
        mesh = world.mesh
        middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        vertices = mesh.vertices - middle
        shape = shape_of(vertices, mesh.faces, mesh.face_material)
        constructor, leaf = ("sah", None) if device.is_cpu else ("cubql", 2)
        points = wp.array(vertices.astype(np.float32), dtype=wp.vec3, device=device)
        indices = wp.array(mesh.faces.ravel(), dtype=int, device=device)
        tree = wp.Mesh(points, indices, bvh_constructor=constructor, bvh_leaf_size=leaf)
        rays = tubes.Body()
        rays.tree = tree.id
        rays.vertices = wp.array(vertices, dtype=wp.vec3d, device=device)
        rays.faces = wp.array(mesh.faces, dtype=int, device=device)
        rays.normals = wp.array(shape.normals, dtype=wp.vec3d, device=device)
        rays.curved = wp.array(shape.curved, dtype=int, device=device)
        rays.offset = OFFSET * shape.size
        rays.reach = 8.0 * shape.size
        flat = shape.regions
        packed = np.zeros(len(flat.area), radiate.Region.numpy_dtype())
        for name in ("normal", "centre", "area", "reach", "material", "first", "end"):
            packed[name] = getattr(flat, name)
        materials = tuple(world.materials[name] for name in mesh.materials)
        spacing = 0.5 * SPEED_OF_LIGHT / world.radar.frequency_hz
        places = scatterers(shape, mesh.face_material, materials, spacing, world.sampling.seed)
        return cls(
            device,
            shape,
            tree,
            rays,
            wp.array(mesh.face_material, dtype=int, device=device),
            wp.array(shape.region, dtype=int, device=device),
            wp.array(packed, dtype=radiate.Region, device=device),
            wp.array(flat.middle, dtype=wp.vec3d, device=device),
            wp.array(flat.along, dtype=wp.vec3d, device=device),
            materials,
            _hull(vertices),
            middle - np.asarray(world.reference_point_m, np.float64),
            int(Variant[world.radar.variant.upper()]),
            wp.array(surfaces(materials), dtype=rough.RoughSurface, device=device),
            wp.array(places, dtype=rough.Scatterer, device=device) if len(places) else None,
            wp.array(places["point"], dtype=wp.vec3d, device=device),
            wp.array(places["normal"], dtype=wp.vec3d, device=device),
        )

    def stuff(self, frequencies: int) -> wp.array:
        """The materials at each frequency, shape (frequencies, materials)."""
        packed = np.zeros((frequencies, len(self.materials)), reflection.Face.numpy_dtype())
        for m, material in enumerate(self.materials):
            packed["conductor"][:, m] = material.conductor
            packed["layer"][:, m] = material.thickness_m is not None
            eps = material.eps_r if isinstance(material.eps_r, tuple) else (material.eps_r or 1.0, 0.0)
            packed["permittivity"][:, m] = eps
            packed["thickness"][:, m] = material.thickness_m or 0.0
            packed["rms_height"][:, m] = material.rms_height_m
        return wp.array(packed, dtype=reflection.Face, device=self.device)

    @property
    def radius(self) -> float:
        """Distance of the furthest vertex from the middle [m]."""
        return float(np.linalg.norm(self.hull, axis=1).max())

    def extents(self, axes: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Least and largest coordinate along each axis [m], shape (axes, 2)."""
        along = self.hull @ np.stack(axes, axis=1)
        return np.stack([along.min(axis=0), along.max(axis=0)], axis=1)

    def edge_pieces(self, longest_m: float) -> wp.array:
        """The wedges between conductors in pieces of at most `longest_m`."""
        wedges = self.shape.wedges
        conducting = np.array([bool(m.conductor) for m in self.materials])
        some = np.flatnonzero(conducting[wedges.material].all(axis=1))
        length = np.linalg.norm(wedges.end - wedges.start, axis=1)[some]
        cuts = np.ceil(length / longest_m).astype(int).clip(1)
        which = np.repeat(some, cuts)
        step = np.arange(len(which)) - np.repeat(np.cumsum(cuts) - cuts, cuts)
        along = (wedges.end - wedges.start)[which] / np.repeat(cuts, cuts)[:, None]
        packed = np.zeros(len(which), edges.Edge.numpy_dtype())
        packed["along"] = along
        packed["middle"] = wedges.start[which] + (step + 0.5)[:, None] * along
        for name in ("first", "second", "normal_first", "normal_second", "outer", "share"):
            packed[name] = getattr(wedges, name)[which]
        return wp.array(packed, dtype=edges.Edge, device=self.device)


def _hull(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        hull: NDArray[np.float64] = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # a flat body has no hull with a volume
        return vertices
    return hull
