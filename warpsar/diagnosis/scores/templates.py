"""What each effect would leave in the residual: derivatives at neutral, on rays of their own.

The residual holds the sampling noise of the rays that mu was made with. A template from the same rays holds it too,
and the two agree where nothing is missing; so templates come from an independent set (cross-fitting).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from scipy.sparse import csc_array

from warpsar.compare.observation import Observation
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.effects.registry import declared, get, names, validate
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays, effects_grid


@dataclass(frozen=True)
class Template:
    """One trial of one effect: `columns`, shape (n, k), d ln(mu) / d(score coordinate) over all pixels, sparse, since
    there are hundreds of trials of a few rows of one view; `one_sided` per column."""

    effect: str
    trial: Trial
    columns: csc_array
    one_sided: tuple[bool, ...]


def with_effect(scene: Scene, name: str, table: Mapping[str, Any]) -> Scene:
    """The scene with one more effect declared, or one declared otherwise."""
    return replace(scene, effects={**scene.effects, name: validate(name, dict(table), f"effects.{name}")})


class TemplateMaker:
    """Templates about one scene, whose materials and effects are the fitted ones, on one independent set of rays."""

    def __init__(
        self,
        scene: Scene,
        device: wp.Device,
        rays: Rays,
        observations: Mapping[str, list[Observation]],
        modelled: Sequence[np.ndarray],
    ) -> None:
        """`modelled` is mu of every observation, as the residual divides by it."""
        self.scene, self.modelled = scene, modelled
        self.pixels = sum(mu.size for mu in modelled)
        self.context = Context(scene, float(np.median(np.concatenate(modelled))))
        self._problem = partial(FitProblem, device=device, rays=rays, observations=observations)
        self.neutral = self._problem(scene)
        self.mu = self.neutral.modelled_as_declared()
        self.whole = [
            view.render.images[seen.polarization].numpy().reshape(seen.interior.shape).copy()
            for view in self.neutral.views
            for seen in view.observations
        ]
        self.compared = [(seen.pixels, seen.darkest) for seen in self.neutral.observations]
        self._last: tuple[str, FitProblem] | None = None
        self._shared: tuple[Mapping[str, Any], list[np.ndarray]] | None = None  # a step's table and its images

    def tangent(self) -> np.ndarray:
        """d ln(mu) / dx of everything that is fitted, shape (n, p), with one column per unknown gain."""
        problem = self.neutral
        jacobian = np.concatenate(problem.jacobian(problem.x0))
        if problem.scene.grid.calibrated:
            return jacobian
        sizes = [mu.size for mu in self.mu]
        gains = np.zeros((sum(sizes), len(sizes)))
        ends = np.cumsum(sizes)
        for k, (size, end) in enumerate(zip(sizes, ends, strict=True)):
            gains[end - size : end, k] = 1.0
        return np.hstack([jacobian, gains])

    def templates(self, name: str) -> list[Template]:
        """Every trial of an effect that has a place in this scene."""
        found = []
        for trial in get(name).trials(self.context):
            differences = [self._difference(name, step) for step in trial.steps]
            rows, data = (np.concatenate(parts) for parts in zip(*differences, strict=True))
            ends = np.cumsum([0, *(at.size for at, _ in differences)])
            columns = csc_array((data, rows, ends), shape=(self.pixels, len(differences)))
            found.append(Template(name, trial, columns, tuple(step.one_sided for step in trial.steps)))
        return found

    def _difference(self, name: str, step: ScoreStep) -> tuple[np.ndarray, np.ndarray]:
        """The pixels that a step changes, and its derivative of ln(mu) there."""
        if self._shared is None or self._shared[0] is not step.plus:
            self._shared = step.plus, self._images(name, step.plus, step.views)
        plus = self._shared[1]
        minus = self.mu if step.minus is None else self._images(name, step.minus, step.views)
        size = step.size * (1.0 if step.minus is None else 2.0)
        rows, data, first = [], [], 0
        for p, m, mu, (pixels, _) in zip(plus, minus, self.modelled, self.compared, strict=True):
            if p is not m:
                at = np.flatnonzero(p != m)
                if step.rows is not None:
                    row = pixels[at] // self.scene.grid.shape[1]
                    at = at[(row >= step.rows[0]) & (row < step.rows[1])]
                rows.append(first + at)
                data.append((p[at] - m[at]) / (size * mu[at]))
            first += mu.size
        return np.concatenate(rows), np.concatenate(data)

    def _images(self, name: str, table: Mapping[str, Any], views: Sequence[str] | None) -> list[np.ndarray]:
        """The model's pixels with the effect; only `views` are rendered, the others stay as they are."""
        scene = with_effect(self.scene, name, table)
        if get(name).stage == "image" and not self._later_effects(name):
            return self._finished(scene, name, views)
        problem = self._rendered(scene, name, views)
        changed = iter(problem.standing())
        touched = {view.view.name for view in problem.views}
        return [
            next(changed) if seen.view.name in touched else mu
            for seen, mu in zip(self.neutral.observations, self.mu, strict=True)
        ]

    def _rendered(self, scene: Scene, name: str, views: Sequence[str] | None) -> FitProblem:
        """The views with the effect as declared. Tables of an effect that differ in values alone share one problem."""
        chosen = [view.view for view in self.neutral.views if views is None or view.view.name in views]
        effects = {view.name: declared(scene, view, neutral=True) for view in chosen}
        about = [(v, effects_grid(scene, each), [e.settings for e in each]) for v, each in effects.items()]
        key = f"{name} {about}"
        if self._last is None or self._last[0] != key:
            self._last = key, self._problem(scene, views=views)
        problem = self._last[1]
        for view in problem.views:
            values = {e.effect.name: e.values for e in effects[view.view.name]}
            view.render.set_parameters(None, values)
            view.run_images(at=(b"", values))  # the surface is the same in all
        return problem

    def _later_effects(self, name: str) -> bool:
        """Whether a declared effect acts after this one: then the finished image is not what it acts on."""
        return any(names().index(other) > names().index(name) for other in self.scene.effects)

    def _finished(self, scene: Scene, name: str, views: Sequence[str] | None) -> list[np.ndarray]:
        """An image effect on the finished images: nothing is shaded again."""
        found = []
        views_of = [view for view in self.neutral.views for _ in view.observations]
        for view, mu, whole, (pixels, darkest) in zip(views_of, self.mu, self.whole, self.compared, strict=True):
            if views is None or view.view.name in views:
                effect = next(e for e in declared(scene, view.view, neutral=True) if e.effect.name == name)
                image = view.render.image_with(effect, whole)
                mu = np.maximum(image.ravel()[pixels].astype(float), darkest)
            found.append(mu)
        return found
