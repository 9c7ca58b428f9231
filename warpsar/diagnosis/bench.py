"""What every fit of a diagnosis shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import warp as wp

from warpsar.effects.registry import get
from warpsar.learning.observation import Observation
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import Roughness
from warpsar.runtime.distributed import ONE, Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays


@dataclass(frozen=True)
class Bench:
    """Rays and frozen pixels that all models are compared on. `observations` by view name.

    `bound` is that of the gamma loss in every fit (`speckle.likelihood.bounded`); 0 for none. `roughness` is
    what every fit expects of the learned fields; None where there are none. Every one of the `ranks` holds all views,
    and fits whole models by itself.
    """

    device: wp.Device
    rays: Rays
    observations: Mapping[str, list[Observation]]
    ranks: Ranks = ONE
    bound: float = 0.0
    roughness: Roughness | None = None

    def problem(self, scene: Scene, views: Sequence[str] | None = None, *, dark: bool | None = None) -> FitProblem:
        """The scene's fit problem; its dark pixels are used where it has an additive effect, or as `dark` says."""
        if dark is None:
            dark = any(get(name).additive for name in scene.effects)
        seen = self.observations
        if dark:
            seen = {name: [one.with_dark() for one in found] for name, found in seen.items()}
        return FitProblem(
            scene,
            self.device,
            views=views,
            rays=self.rays,
            observations=seen,
            bound=self.bound,
            roughness=self.roughness,
        )
