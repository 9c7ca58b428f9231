"""A mesh and its materials on a device, ready for rays, facets and edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from warpsar.coherent.patches import PlacedScatterers, RoughPatches
from warpsar.coherent.plates import rims
from warpsar.coherent.records import records, upload
from warpsar.coherent.rough import surfaces
from warpsar.coherent.rough_models import ScattererGroup, refuse_tables
from warpsar.coherent.shape import MeshShape, faces_alone, shape_of
from warpsar.kernels.codes import Variant
from warpsar.kernels.coherent import edge_waves, edges, radiate, reflection, rough, tubes
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Material
from warpsar.world.world import World

OFFSET = 1e-5
"""Reflected rays start this share of the body's size off the facet: float32 would hit it again."""


@dataclass
class CoherentBody:
    """A shape on a device."""

    device: wp.Device
    shape: MeshShape
    tree: wp.Mesh
    rays: tubes.TubeMesh
    face_material: wp.array
    region: wp.array
    regions: wp.array
    middle: wp.array
    along: wp.array
    materials: tuple[Material, ...]
    origin: NDArray[np.float64]
    """The body's middle about the scene's reference point, (3,) [m]. All other places are about the middle."""
    variant: int
    surfaces: wp.array
    patches: RoughPatches
    """Of rough faces, on which scatterers lie."""
    seed: int
    """Of what rough faces draw."""

    @classmethod
    def of(
        cls,
        world: World,
        device: wp.Device,
        *,
        spacing_m: float | None = None,
        seed: int | None = None,
        rough_only: bool = False,
    ) -> CoherentBody:
        """Upload the mesh of a scene. Rays see it about its own middle, where float32 is finest.

        `spacing_m`: of the scatterers of rough faces, half a wavelength without it; `seed`: theirs, else the scene's.
        `rough_only`: for the term "rough" alone. Smooth surfaces, regions and wedges are then not worked out.
        With a spacing there may be more scatterers than fit: they are placed in parts, by `patches`.
        Raises InputError for materials that lack what a term needs.
        """
        refuse_tables(world)
        mesh = world.mesh
        middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        vertices = mesh.vertices - middle
        shape = faces_alone(vertices, mesh.faces) if rough_only else shape_of(vertices, mesh.faces, mesh.face_material)
        constructor, leaf = ("sah", None) if device.is_cpu else ("cubql", 2)
        points = upload(vertices.astype(np.float32), wp.vec3, device)
        indices = upload(mesh.faces.ravel(), int, device)
        tree = wp.Mesh(points, indices, bvh_constructor=constructor, bvh_leaf_size=leaf)
        rays: Any = tubes.TubeMesh()
        rays.tree = tree.id
        rays.vertices = upload(vertices, wp.vec3d, device)
        rays.faces = upload(mesh.faces, int, device)
        rays.normals = upload(shape.normals, wp.vec3d, device)
        rays.curved = upload(shape.curved, int, device)
        rays.offset = OFFSET * shape.size
        rays.reach = 8.0 * shape.size
        flat = shape.regions
        packed = records(radiate.Region, len(flat.area))
        for name in ("normal", "centre", "area", "reach", "material", "first", "end"):
            packed[name] = getattr(flat, name)
        materials = tuple(world.materials[name] for name in mesh.materials)
        spacing = spacing_m or 0.5 * SPEED_OF_LIGHT / world.radar.frequency_hz
        seed = world.seed(seed)
        patches = RoughPatches.of(shape, mesh.face_material, materials, spacing, seed)
        if spacing_m is None:
            patches.refuse_many()
        return cls(
            device,
            shape,
            tree,
            rays,
            upload(mesh.face_material, int, device),
            upload(shape.region, int, device),
            upload(packed, radiate.Region, device),
            upload(flat.middle, wp.vec3d, device),
            upload(flat.along, wp.vec3d, device),
            materials,
            middle - np.asarray(world.reference_point_m, np.float64),
            int(Variant[world.radar.variant.upper()]),
            upload(surfaces(materials), rough.RoughSurface, device),
            patches,
            seed,
        )

    @cached_property
    def hull(self) -> NDArray[np.float64]:
        """The vertices that can be outermost, (n, 3) [m]."""
        return _hull(self.shape.vertices)

    @cached_property
    def placed(self) -> PlacedScatterers:
        """All scatterers of rough faces at once. Raises InputError where they are too many."""
        self.patches.refuse_many()
        return self.patches.on(self.device).placed(slice(0, len(self.patches)))

    @property
    def scatterers(self) -> wp.array | None:
        """All of them; None without."""
        return self.placed.scatterers if len(self.patches) else None

    @property
    def scatterer_groups(self) -> tuple[ScattererGroup, ...]:
        """By their models; that of `ka_spm` comes first."""
        return self.placed.groups

    @property
    def scatterer_points(self) -> wp.array:
        return self.placed.points

    @property
    def scatterer_normals(self) -> wp.array:
        return self.placed.normals

    @cached_property
    def scatterer_faces(self) -> NDArray[np.int64]:
        """(n,)."""
        return self.patches.faces_of(slice(0, len(self.patches)))

    def stuff(self, frequencies: int) -> wp.array:
        """The materials at each frequency, shape (frequencies, materials)."""
        return upload(faces_of(self.materials, frequencies), reflection.Face, self.device)

    @property
    def has_slabs(self) -> bool:
        """Whether there is a slab in air."""
        return any(m.stack and not m.conductor for m in self.materials)

    @property
    def has_coats(self) -> bool:
        """Whether there is a conductor with layers."""
        return any(m.stack and m.conductor for m in self.materials)

    @property
    def has_solids(self) -> bool:
        """Whether there is a solid dielectric, which is neither a conductor nor a layer."""
        return any(m.solid for m in self.materials)

    @property
    def largest_index(self) -> float:
        """Of refraction, of the solid dielectrics; 1 without any."""
        eps = [m.eps_r[0] if isinstance(m.eps_r, tuple) else m.eps_r for m in self.materials if m.solid]
        return float(np.sqrt(max([1.0, *(float(each) for each in eps if not isinstance(each, str) and each)])))

    @property
    def narrowest(self) -> float:
        """Least extent of the hull along an axis [m]."""
        width = np.ptp(self.hull, axis=0)
        return float(width[width > 0.0].min())

    @property
    def radius(self) -> float:
        """Distance of the furthest vertex from the middle [m]."""
        return float(np.linalg.norm(self.hull, axis=1).max())

    @property
    def standoff(self) -> float:
        """How far from the middle rays start [m]: a radar must stand further away."""
        return self.radius + self.shape.size

    def seen_from(self, place: NDArray[np.float64], s: NDArray[np.float64]) -> NDArray[np.float64]:
        """The hull, (n, 3) [m], cast from a place onto the plane through the middle across `s`."""
        height = float(place @ s)
        ratio = height / (height - self.hull @ s)
        return place + ratio[:, None] * (self.hull - place)

    def extents(self, axes: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Least and largest coordinate along each axis [m], shape (axes, 2)."""
        along = np.ascontiguousarray((self.hull @ np.stack(axes, axis=1)).T)  # in rows, where an end is found fast
        return np.stack([along.min(axis=1), along.max(axis=1)], axis=1)

    def cuts(self, longest_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Pieces of the wedges between conductors, (n,) each: of which wedge, the how many-th, of how many."""
        wedges = self.shape.wedges
        conducting = np.array([bool(m.conductor) for m in self.materials])
        some = np.flatnonzero(conducting[wedges.material].all(axis=1))
        length = np.linalg.norm(wedges.end - wedges.start, axis=1)[some]
        cuts = np.ceil(length / longest_m).astype(int).clip(1)
        which = np.repeat(some, cuts)
        step = np.arange(len(which)) - np.repeat(np.cumsum(cuts) - cuts, cuts)
        return which, step, np.repeat(cuts, cuts)

    def edge_pieces(self, longest_m: float) -> wp.array:
        """The wedges between conductors in pieces of at most `longest_m`."""
        wedges = self.shape.wedges
        which, step, cuts = self.cuts(longest_m)
        along = (wedges.end - wedges.start)[which] / cuts[:, None]
        packed = records(edges.Edge, len(which))
        packed["along"] = along
        packed["middle"] = wedges.start[which] + (step + 0.5)[:, None] * along
        for name in ("first", "second", "normal_first", "normal_second", "outer", "share"):
            packed[name] = getattr(wedges, name)[which]
        packed["reach_first"], packed["reach_second"] = wedges.reach(which, packed["middle"]).T
        packed["material_first"], packed["material_second"] = wedges.material[which].T
        return upload(packed, edges.Edge, self.device)

    def plate_rims(self, longest_m: float, thin_m: float) -> tuple[wp.array, wp.array]:
        """Which of `edge_pieces` are rims of plates thinner than `thin_m`, as edges of sheets; and what is opposite.

        Only of plates of bare metal.
        """
        which, step, cuts = self.cuts(longest_m)
        coated = [i for i, m in enumerate(self.materials) if not m.bare]
        bare = np.asarray(~np.isin(self.shape.wedges.material, coated).any(axis=1), np.bool_)
        along = (self.shape.wedges.end - self.shape.wedges.start)[which] / cuts[:, None]
        middle = self.shape.wedges.start[which] + (step + 0.5)[:, None] * along
        packed, opposite = rims(self.shape, which, bare, middle, along, thin_m)
        return upload(packed, edges.Edge, self.device), upload(opposite, edge_waves.Opposite, self.device)


def faces_of(materials: Sequence[Material], frequencies: int = 1) -> Any:
    """Records of `reflection.Face`, (frequencies, materials)."""
    packed = records(reflection.Face, (frequencies, len(materials)))
    for m, material in enumerate(materials):
        packed["conductor"][:, m] = material.conductor
        layers = [(*_parts(one.eps_r), *_parts(one.mu_r), one.thickness_m) for one in material.stack]
        packed["layer"][:, m] = len(layers)
        outer = layers[0] if layers else (*_parts(material.eps_r or 1.0), 1.0, 0.0, 0.0)
        packed["permittivity"][:, m], packed["permeability"][:, m] = outer[:2], outer[2:4]
        packed["thickness"][:, m] = outer[4]
        for row, one in enumerate(layers[1:]):
            packed["under"][:, m, row] = one
        packed["rms_height"][:, m] = material.rms_height_m or 0.0
    return packed


def _parts(value: Any) -> tuple[float, float]:
    return value if isinstance(value, tuple) else (value, 0.0)


def _hull(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    try:
        hull: NDArray[np.float64] = vertices[ConvexHull(vertices).vertices]
    except QhullError:  # a flat body has no hull with a volume
        return vertices
    return hull
