"""What every view of a scene shares on a device."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from warpsar.kernels.codes import Variant
from warpsar.runtime import devices
from warpsar.surface.surface import Surface
from warpsar.surface.tables import Tables
from warpsar.surface.terms import Terms
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
    places: wp.array
    """vec4i, (materials, 4)"""
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
        own = ["shade_lanes", "raster_lanes", "record_lanes", "hit_lanes"] if device.is_cpu else []
        devices.load_kernels(device, "trace", "merge", "shade", "raster", *own)
        surface = Surface.of(scene)
        if surface.model.any():
            own = ["models_lanes", "crossed_table_lanes", "crossed_spline_lanes"] if device.is_cpu else []
            devices.load_kernels(device, "models", "facet", "crossed_table", "crossed_spline", *own)
        uv = np.zeros((0, 2), np.float32) if scene.mesh.uv is None else scene.mesh.uv
        return cls(
            target=Target.upload(scene.mesh, scene.reference_point_m, device),
            surface=surface,
            variant=Variant[scene.radar.variant.upper()],
            local_basis=scene.radar.polarization_basis == "local",
            face_material=wp.array(scene.mesh.face_material, dtype=int, device=device),
            uv=wp.array(uv, dtype=wp.vec2, device=device),
            places=wp.array(surface.places, dtype=wp.vec4i, device=device),
            spectrum=wp.array(surface.spectrum, dtype=int, device=device),
            eps_im=wp.array(surface.eps_im, dtype=float, device=device),
            aspect=wp.array(surface.aspect, dtype=float, device=device),
            tables=Tables.of(surface.sigma0, device),
            terms=Terms.of(surface.learned_term, device),
        )

    @cached_property
    def nodes(self) -> wp.array:
        """The surface's nodes on the device, float32."""
        return wp.array(self.surface.nodes.astype(np.float32), dtype=float, device=self.target.device)
