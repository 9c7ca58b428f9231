"""The views of a scene without rays: hits of exact areas, for whatever takes `Rays`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays, effects_grid, view_seed
from warpsar.trace.exact import exact_hits
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, Hits
from warpsar.world.tables import View
from warpsar.world.world import geometry_of


class ExactRays(Rays):
    """`Rays` whose hits have no sampling noise: images are smooth in the mesh's vertices (`trace.exact`)."""

    def trace(
        self,
        scene: Scene,
        view: View,
        effects: list[DeclaredEffect],
        only_columns: tuple[int, int] | None = None,
        max_memory_gib: float = DEFAULT_MEMORY_GIB,
        *,
        only_faces: np.ndarray | None = None,
    ) -> Hits:
        """As `Rays.trace`. Effects that send rays of their own take the scene's density and seed. `only_faces` as in
        `exact_hits`."""
        found = exact_hits(
            self.stage.target,
            geometry_of(scene, view),
            effects_grid(scene, effects),
            self.rays_per_m2 or scene.sampling.density_per_m2(scene.grid),
            seed=view_seed(self.seed, [v.name for v in scene.views].index(view.name)),
            pixel_area_m2=scene.grid.pixel_area_m2,
            only_columns=only_columns,
            only_faces=only_faces,
        )
        return replace(found, coarse=self.coarse)
