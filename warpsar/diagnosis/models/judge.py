"""Models of a diagnosis beside all measured images, test views among them: as `evaluate` has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.compare.comparison import Comparison, compare
from warpsar.compare.judgement import Judgement, judge
from warpsar.compare.modelled import KeptAreas
from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.refit import descend
from warpsar.effects.registry import get
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.learning.roughness import Roughness
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.speckle.facts import SpeckleFact
from warpsar.surface.stage import Stage
from warpsar.world.tables import View


@dataclass
class Judge:
    """Scenes beside their measured images, each rendered once for each role, and judged once."""

    device: wp.Device
    _kept: list[tuple[Scene, str, bool, list[Comparison]]] = field(default_factory=list)
    _judged: list[tuple[Sequence[Comparison], Judgement]] = field(default_factory=list)
    _areas: KeptAreas = field(default_factory=KeptAreas)

    def __call__(self, scene: Scene, role: str, *, edges: bool = True) -> list[Comparison]:
        """The images of a role, in the order of the views; none where there are none. Without `edges`, for metrics
        alone."""
        for known, of, whole, images in self._kept:
            if known is scene and of == role and (whole or not edges):
                return images
        if not any(view.images and view.role == role for view in scene.views):
            return []
        images = self._compared(scene, role, edges)
        self._kept.append((scene, role, edges, images))
        return images

    def _compared(self, scene: Scene, role: str, edges: bool = True) -> list[Comparison]:
        return compare(scene, self.device, roles=(role,), edges=edges, kept=self._areas).images

    def judgement(self, images: Sequence[Comparison]) -> Judgement:
        """What is left of the images: `judge`, once for the same images."""
        for known, found in self._judged:
            if len(known) == len(images) and all(a is b for a, b in zip(known, images, strict=True)):
                return found
        self._judged.append((images, judge(images)))
        return self._judged[-1][1]

    def with_own_numbers(self, scene: Scene, *, edges: bool = True) -> list[Comparison]:
        """The test views with what effects hold for each view by itself (a gain, a shift) fitted to them.

        No other view can tell these numbers. They are few beside a view's pixels, so what is left is still a test of
        everything else. A view keeps those that pay. As `__call__` where no effect has such numbers.
        """
        own = _with_own_entries(scene)
        if own is None:
            return self(scene, "test", edges=edges)
        return self._compared(self._fitted(scene, own, ("test",)), "test", edges)

    def with_open_surface(self, scene: Scene, roughness: Roughness | None) -> dict[str, list[Comparison]]:
        """Train and test views, by role, with the surface fitted to both; effects stay, but for own numbers.

        Train views may leave a surface open: two that look from one incidence say nothing of another. What a test view
        then shows is no fault of the model, if a surface exists that explains all views. `roughness` is expected of
        learned fields.
        """
        opened = self._fitted(scene, _with_own_entries(scene) or scene, ("train", "test"), roughness)
        return {role: self._compared(opened, role) for role in ("train", "test")}

    def _fitted(self, scene: Scene, own: Scene, roles: tuple[str, ...], roughness: Roughness | None = None) -> Scene:
        """The scene `own` with the test views' own numbers fitted to views of the `roles`, and the surface where train
        views are among them."""
        pixels: dict[str, list[Observation]] = {}
        for role in roles:
            for image in self(scene, role):
                pixels.setdefault(image.view.name, []).append(image.seen)
        rays = ExactRays(Stage.of(own, self.device), seed=own.sampling.seed)
        problem = FitProblem(own, self.device, roles=roles, rays=rays, observations=pixels, roughness=roughness)
        tests = {view.name for view in own.views if view.role == "test"}
        effects = np.array([c.view in tests & set(pixels) for c in problem.effect_coordinates], bool)
        moving = np.concatenate([np.full(problem.learned.size, "train" in roles), effects])
        x = once.alone(lambda: descend(problem, [problem.x0], moving, quick=True))[0]
        return learned_scene(problem, once.alone(lambda: _those_that_pay(problem, x, sorted(tests & set(pixels)))))


def _those_that_pay(problem: FitProblem, x: np.ndarray, views: Sequence[str]) -> np.ndarray:
    """x with the numbers of each of the `views` that gain less than they cost where they began: half a ln(pixels) of
    log-likelihood each. They are fitted away from edges. There a shift of a centimetre is chance, and edges see it."""
    loss = problem.value(problem.modelled(x))
    price = 0.5 * np.log(sum(int(seen.interior.sum()) for seen in problem.observations))
    for view in views:
        own = problem.of_effects.start + np.flatnonzero([c.view == view for c in problem.effect_coordinates])
        without = x.copy()
        without[own] = problem.x0[own]
        lost = problem.value(problem.modelled(without)) - loss
        if lost < price * own.size:
            x, loss = without, loss + lost
    return x


def _with_own_entries(scene: Scene) -> Scene | None:
    """The scene whose tables of values per view name the test views too; None where there are no such tables.

    Effects with a setting for each view (the rows of an interference) stay: no fit finds these.
    """
    tests = [view.name for view in scene.views if view.role == "test" and view.images]
    effects: dict[str, dict[str, Any]] = {}
    for name, table in scene.effects.items():
        if any(setting.per_view for setting in get(name).settings):
            continue
        added = {
            p.name: {**dict.fromkeys(tests, p.default), **table[p.name]}
            for p in get(name).parameters
            if p.per_view and isinstance(table.get(p.name), Mapping)
        }
        if any(len(added[key]) > len(table[key]) for key in added):
            effects[name] = {**table, **added, "fixed": False}
    return replace(scene, effects={**scene.effects, **effects}) if effects else None


def with_speckle(scene: Scene, fact: SpeckleFact) -> Scene:
    """The scene whose views declare the looks and the texture that were found.

    What is common to the train views goes for the test views too. Looks of single views do not: those of others stay.
    """
    if not fact.names:
        return scene
    factors = _factors(scene, fact)
    return replace(scene, views=[_found_of(view, fact, factors) for view in scene.views])


def _factors(scene: Scene, fact: SpeckleFact) -> dict[str, float]:
    """By view, what its declared looks are multiplied by."""
    factors = {}
    for view in scene.views:
        looks = [fact.looks[f"{view.name} {pol}"].value for pol in view.images if f"{view.name} {pol}" in fact.looks]
        if looks and view.looks is not None:
            factors[view.name] = float(np.mean(looks)) / view.looks
    return factors


def _found_of(view: View, fact: SpeckleFact, factors: Mapping[str, float]) -> View:
    changed: dict[str, Any] = {}
    factor = factors.get(view.name)
    if factor is None and fact.common and factors:
        factor = float(np.mean(list(factors.values())))
    if view.looks is not None and factor is not None:
        changed["looks"] = view.looks * factor
    if fact.texture is not None:
        changed["texture"] = fact.texture.value
    return view.model_copy(update=changed)


def under(images: Sequence[Comparison], scene: Scene) -> list[Comparison]:
    """The images with looks and texture as the scene's views declare them."""
    views = {view.name: view for view in scene.views}
    return [image.under(views[image.view.name]) for image in images]
