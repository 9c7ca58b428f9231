"""What effects do to the samples of a complex image."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.collection.noise import lines
from warpsar.collection.slc import Slc
from warpsar.effects.base.recorder import lit_pixels
from warpsar.effects.registry import declared, names
from warpsar.scene.scene import Scene
from warpsar.simulation.command import view_render
from warpsar.simulation.rays import trace_view, view_seed
from warpsar.surface.stage import Stage


def with_samples_changed(made: Slc, scene: Scene, index: int, seed: int, device: wp.Device) -> Slc:
    """A complex image with what effects do to its samples; `index` is the number of the view, `seed` the scene's."""
    system = _System(made, scene, index, seed, device)
    images = {}
    for polarization, samples in made.images.items():
        system.polarization = polarization
        for one in made.plan.effects:
            samples = one.effect.samples(system, one.values, one.settings, samples)
        images[polarization] = samples
    return replace(made, images=images)


class _System:
    """The `ComplexImage` that effects see."""

    def __init__(self, made: Slc, scene: Scene, index: int, seed: int, device: wp.Device) -> None:
        self.made, self.scene, self.index, self.seed, self.device = made, scene, index, seed, device
        self.polarization = ""
        self._powers: dict[str, tuple[dict[str, Any], NDArray[np.bool_]]] = {}
        self._random = np.random.default_rng([seed, 3, index])

    def lines(self) -> NDArray[np.complex64]:
        return lines(self.made.plan, self.made.azimuth_m, len(self.made.range_m), self._random)

    def power(self, effect: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        if effect not in self._powers:
            before = names()[: names().index(effect)]
            effects = {name: table for name, table in self.scene.effects.items() if name in before}
            scene = replace(self.scene, effects=effects)
            view, stage = scene.views[self.index], Stage.of(scene, self.device)
            hits = trace_view(scene, stage, view, seed=view_seed(self.seed, self.index), effects=declared(scene, view))
            render = view_render(scene, stage, view, hits)
            self._powers[effect] = render.forward(), lit_pixels(render).reshape(render.shape)
        images, met = self._powers[effect]
        return images[self.polarization], met
