"""How often a right result is withdrawn: what test views say in a draw of speckle (limits.py has that of train views).

An effect that has numbers of single views, or that trades with the surface, is known badly from few views. Its model
may then be farther from the test views than the declared one, though it is the true one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from limits import Model, NoiseFree, covariance_sum, step_of

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays

Speckle = Callable[[Observation], np.ndarray]
"""Draws of speckle for an image's compared pixels, shape (draws, pixels)."""


def turned(scene: Scene) -> Scene:
    """The scene with train and test views exchanged."""
    other = {"train": "test", "test": "train"}
    return replace(scene, views=[v.model_copy(update={"role": other[v.role]}) for v in scene.views])


class HeldViews:
    """The noise-free test views of a scene, on rays and pixels that all models share."""

    def __init__(self, noise_free: NoiseFree) -> None:
        self._noise_free = noise_free
        scene, rays = turned(noise_free.scene), noise_free.setup.rays
        other = Rays(rays.stage, rays.rays_per_m2, rays.seed + 1)
        one, two = (FitSetup(noise_free.device, each, {}) for each in (rays, other))
        self._setup = replace(one, observations=frozen(one, two, scene))
        self.seen = [one for found in self._setup.observations.values() for one in found]

    def of(self, model: Model) -> tuple[np.ndarray, np.ndarray]:
        """beta0 of the compared pixels, shape (n,), and d ln(beta0) / dx, (n, p), with x as the model has it.

        Numbers of train views change nothing here.
        """
        problem = self._setup.problem(turned(model.scene), dark=False)
        mu = np.concatenate(problem.modelled_as_declared())
        known = dict(zip(problem.labels, np.concatenate(problem.jacobian(problem.x0)).T, strict=True))
        nothing = np.zeros(mu.size)
        return mu, np.stack([known.get(label, nothing) for label in model.labels], axis=1)

    def stands(self, beta0: np.ndarray, looks: float, model: Model, base: Model, speckle: Speckle) -> np.ndarray:
        """Whether `model` is no farther from the test views than `base`, by more than the standard error of the
        difference, per draw; `beta0` of the train views, shape (n, draws)."""
        truth, _ = self.of(self._noise_free.truth)
        measured = truth[:, None] * np.concatenate([speckle(one) for one in self.seen], axis=1).T
        lost = []
        for one in (base, model):
            mu, jacobian = self.of(one)
            step = step_of(one, beta0 / one.mu[:, None] - 1.0, looks)
            moved = mu[:, None] * np.exp(np.clip(jacobian @ step, -10.0, 10.0))
            lost.append(self._noise_free.lost(measured, moved, looks))
        gained = lost[0] - lost[1]
        error = np.sqrt(np.maximum(len(gained) * covariance_sum(self.seen, gained - gained.mean(axis=0)), 0.0))
        return np.asarray(gained.sum(axis=0) >= -error)
