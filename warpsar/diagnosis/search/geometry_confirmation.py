"""Whether a change of geometry holds beside all that was added: its gain, and what views left out say of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpsar.diagnosis.found import Confirmed
from warpsar.diagnosis.models.all_pixels import Exact, log_likelihood, still
from warpsar.diagnosis.models.bench import Bench
from warpsar.diagnosis.models.change import ABSENT, kind_of, object_of, without_change
from warpsar.diagnosis.models.left_out import LeftOut, summed
from warpsar.diagnosis.models.movable import own_material, refined_words, standing, with_words
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.turn.geometry_trial import fitted_beside
from warpsar.effects.registry import get
from warpsar.learning.pose import PosedProblem, descend
from warpsar.learning.pose_coordinates import Poses
from warpsar.learning.results import learned_scene
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import loss_terms
from warpsar.world.world import posed


def taken_back(bench: Bench, fitted: Fitted, declared: Scene, name: str) -> Fitted:
    """The model without one of its changes of geometry, fitted to the pixels that both light.

    Effects of the changed body's own material go with it.
    """
    scene = without_change(declared, fitted.scene, name)
    effects = {effect: table for effect, table in scene.effects.items() if not get(effect).check(scene, table)}
    return fitted_beside(bench, replace(scene, effects=effects), declared)[1]


def asked_of(bench: Bench, fitted: Fitted, without: Fitted, declared: Scene, name: str) -> Confirmed:
    """What the change gains on all usable pixels, for how many numbers."""
    gain = 2.0 * (log_likelihood(bench, fitted) - log_likelihood(bench, without))
    if kind_of(name) == ABSENT:
        return Confirmed(name, gain, 1)
    free = _freed(declared, fitted.scene, name)
    on_ground = standing(free)
    numbers = sum(
        (c.word, c.index) != ("position", 2) or free.objects[c.object].label not in on_ground
        for c in Poses(free).coordinates
    )
    own = own_material(declared, fitted.scene, object_of(name))
    return Confirmed(name, gain, numbers + (len(fitted.scene.materials[own].learn) if own else 0))


def views_left_out(bench: Bench, fitted: Fitted, without: Fitted, declared: Scene, name: str, quiet: bool) -> LeftOut:
    """Explain each view with the object as the other views have it, and without the change.

    The others place the object. They also give the size and the own material of one that was missing. All else is
    fitted to all views in both models, on all usable pixels above a common floor.
    """
    names = [view.view.name for view in fitted.problem.views]
    if len(names) < 2:
        return LeftOut(0.0, 0.0, len(names))
    exact = Exact.of(bench, fitted)
    lacking, end = exact.settled(still(without.scene))
    free, own = _freed(declared, fitted.scene, name), own_material(declared, fitted.scene, object_of(name))
    seen, gains = [], []
    for view in names:
        scene = still(fitted.scene)
        if any(one.learn for one in free.objects):
            others = exact.problem(free, [each for each in names if each != view])
            known = descend(others, others.x0)
            scene = _with_own(posed(scene, others.poses.at(known.x[others.size :])), others, known.x, own)
        whole, there = exact.settled(still(scene))
        pairs = zip(exact.images(lacking, end.x, view), exact.images(whole, there.x, view), strict=True)
        for (one, before), (_, after) in pairs:
            seen.append(one)
            gains.append(
                np.stack(
                    [
                        loss_terms("gamma", beta0, before, one.looks) - loss_terms("gamma", beta0, after, one.looks)
                        for beta0 in (one.values, after)
                    ]
                )
            )
    return summed(bench, seen, gains, len(names), quiet)


def _with_own(scene: Scene, problem: PosedProblem, x: np.ndarray, own: str | None) -> Scene:
    """The scene whose material `own` is that of x, and is learned no more."""
    if own is None:
        return scene
    found = learned_scene(*problem.split(x)).materials[own].model_copy(update={"learn": ()})
    return replace(scene, materials={**scene.materials, own: found})


def _freed(declared: Scene, scene: Scene, name: str) -> Scene:
    """The scene with what a fit may change of the object alone; nothing of an absent one."""
    words = {label: each for label, each in refined_words(declared, scene).items() if label == object_of(name)}
    return with_words(scene, words)
