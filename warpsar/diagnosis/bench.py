"""What every fit of a diagnosis shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import warp as wp

from warpsar.diagnosis.other_meshes import OtherMeshes, same_surface
from warpsar.effects.registry import get
from warpsar.learning.observation import Observation
from warpsar.learning.problem import FitProblem
from warpsar.runtime.distributed import ONE, Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.world.mesh import Mesh


@dataclass(frozen=True)
class Bench:
    """Rays and frozen pixels that all models are compared on. `observations` by view name.

    `bound` is that of the gamma loss in every fit (`speckle.likelihood.bounded`); 0 for none. Every one of the `ranks`
    holds all views, and fits whole models by itself. `rays` are those of `mesh`; a scene with another mesh has rays of
    its own, `others`, as many and as random. Without a `mesh`, all scenes have the one of `rays`.
    """

    device: wp.Device
    rays: Rays
    observations: Mapping[str, list[Observation]]
    ranks: Ranks = ONE
    bound: float = 0.0
    mesh: Mesh | None = None
    others: OtherMeshes = field(default_factory=OtherMeshes)

    def rays_of(self, scene: Scene) -> Rays:
        """The rays of the scene's mesh."""
        if self.mesh is None or same_surface(scene.mesh, self.mesh):
            return self.rays
        return self.others.rays(scene, self.device, self.rays)

    def problem(self, scene: Scene, views: Sequence[str] | None = None, *, dark: bool | None = None) -> FitProblem:
        """The scene's fit problem; its dark pixels are used where it has an additive effect, or as `dark` says."""
        if dark is None:
            dark = any(get(name).additive for name in scene.effects)
        seen = self.observations
        if dark:
            seen = {name: [one.with_dark() for one in found] for name, found in seen.items()}
        return FitProblem(
            scene, self.device, views=views, rays=self.rays_of(scene), observations=seen, bound=self.bound
        )
