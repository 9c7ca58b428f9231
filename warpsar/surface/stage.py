"""What every view of a scene shares on a device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels.codes import PAGE, Polarization, Variant
from warpsar.kernels.lane_kernels import at_once
from warpsar.kernels.scatter import page_kernels, places_of, scatter_kernel
from warpsar.kernels.shade import HitSurfaces, NodeMap
from warpsar.models import registry
from warpsar.models.base.model import DEFAULT
from warpsar.runtime import devices
from warpsar.runtime.structs import fill
from warpsar.surface.surface import Surface
from warpsar.surface.surface import places_of as stated_places
from warpsar.surface.tables import Tables
from warpsar.surface.terms import Terms
from warpsar.trace.hits import Hits
from warpsar.trace.target import Target
from warpsar.world.world import World


@dataclass
class Stage:
    """Mesh, materials, and the variant of the equations, on a device; all views of a scene share them."""

    target: Target
    surface: Surface
    variant: int
    local_basis: bool
    face_material: wp.array
    """int, (faces,)"""
    uv: wp.array
    """vec2, (vertices,), or empty"""
    spectrum: wp.array
    """int, (materials,)"""
    eps_im: wp.array
    """float, (materials,)"""
    aspect: wp.array
    """float, (materials,)"""
    tables: Tables | None = None
    """Of materials whose sigma0 comes from a table; None without any"""
    terms: Terms | None = None
    """Of materials with a learned term; None without any"""

    @classmethod
    def of(cls, scene: World, device: wp.Device) -> Stage:
        """Load the kernels, and copy the scene's mesh and surface to the device."""
        surface = Surface.of(scene)
        own = ["shade_lanes", "raster_lanes", "record_lanes", "hit_lanes", "deposit_lanes"] if device.is_cpu else []
        scatter = _scatter_kernels(surface, scene.radar.polarizations, device)
        devices.load_kernels(device, "trace", "merge", "shade", "raster", *own, alone=scatter)
        uv = np.zeros((0, 2), np.float32) if scene.mesh.uv is None else scene.mesh.uv
        return cls(
            target=Target.upload(scene.mesh, scene.reference_point_m, device),
            surface=surface,
            variant=Variant[scene.radar.variant.upper()],
            local_basis=scene.radar.polarization_basis == "local",
            face_material=wp.array(scene.mesh.face_material, dtype=int, device=device),
            uv=wp.array(uv, dtype=wp.vec2, device=device),
            spectrum=wp.array(surface.spectrum, dtype=int, device=device),
            eps_im=wp.array(surface.eps_im, dtype=float, device=device),
            aspect=wp.array(surface.aspect, dtype=float, device=device),
            tables=Tables.of(surface.sigma0, device),
            terms=Terms.of(surface.learned_term, device),
        )

    @cached_property
    def node_maps(self) -> list[Any]:
        """Which nodes a place on the mesh has, as kernels take it: one for each vector of learned coordinates."""
        mesh = {"faces": self.target.faces, "face_material": self.face_material, "uv": self.uv}
        pages = np.split(self.surface.places, self.surface.places.shape[1] // PAGE, axis=1)
        device = self.target.device
        return [
            fill(NodeMap, **mesh, places=wp.array(np.ascontiguousarray(page), dtype=wp.vec4i, device=device))
            for page in pages
        ]

    @property
    def node_map(self) -> Any:
        """That of the first vector."""
        return self.node_maps[0]

    def hit_surfaces(self, hits: Hits, polarization: int, spectrum: wp.array | None = None) -> Any:
        """The `kernels.HitSurfaces` of hits; `spectrum`, (materials,) int, takes the place of the materials' own."""
        return fill(
            HitSurfaces,
            polarization=int(polarization),
            variant=self.variant,
            wavenumber=hits.geometry.wavenumber,
            local_basis=int(self.local_basis),
            face_material=self.face_material,
            spectrum=self.spectrum if spectrum is None else spectrum,
            eps_im=self.eps_im,
            aspect=self.aspect,
            **{name: getattr(hits, name) for name in ("face", "cos_incidence", "cos_twist", "cos2_azimuth")},
        )

    @cached_property
    def nodes(self) -> wp.array:
        """The surface's nodes on the device, float32."""
        return wp.array(self.surface.nodes.astype(np.float32), dtype=float, device=self.target.device)


def _scatter_kernels(surface: Surface, polarizations: Sequence[str], device: wp.Device) -> list[wp.Kernel]:
    """Those of the surface's backscatter models: by the default a hit may be of any polarization, as on the CPU."""
    found: list[wp.Kernel] = []
    for model in dict.fromkeys(surface.model):
        if registry.get(model).from_table:
            continue
        places, stated = places_of(model), len(stated_places(model))
        if places != -(-stated // PAGE) * PAGE:
            raise ValueError(f"kernels/models/{model}.py: takes {places} coordinates, and the model has {stated}")
        alike = device.is_cpu or model == DEFAULT
        channels = [None] if alike else [Polarization[one] for one in polarizations]
        own = [
            scatter_kernel(model, slopes, channel, some=model != DEFAULT)
            for slopes in (False, True)
            for channel in channels
        ]
        found += map(at_once, own) if device.is_cpu else own
        found += page_kernels(places) if places > PAGE else ()
    return found
