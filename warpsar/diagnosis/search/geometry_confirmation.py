"""Whether a change of geometry holds beside all that was added: its gain, and what views left out say of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.diagnosis.found import Confirmed
from warpsar.diagnosis.geometry.registry import like_sensor, of, without_change
from warpsar.diagnosis.models.all_pixels import Exact, log_likelihood
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.left_out import ViewsLeftOut, column_blocks, summed
from warpsar.diagnosis.models.movable import own_material
from warpsar.diagnosis.models.names import object_of
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.turn.geometry_trial import fitted_beside
from warpsar.effects.registry import get
from warpsar.learning.geometry import freed, still, with_free
from warpsar.learning.pose import PosedProblem, descend
from warpsar.learning.results import learned_scene
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import loss_terms
from warpsar.world.world import posed

ENOUGH = 0.1  # of ln L, that a descent about a view left out need not gain: the answer's error is larger by far
MOST_STEPS = 12  # of it: it begins at the best of all views


def taken_back(setup: FitSetup, fitted: Fitted, declared: Scene, name: str) -> Fitted:
    """The model without one of its changes of geometry, fitted to the pixels that both light.

    Effects of the changed body's own material go with it.
    """
    scene = without_change(declared, fitted.scene, name)
    effects = {effect: table for effect, table in scene.effects.items() if not get(effect).check(scene, table)}
    return fitted_beside(setup, replace(scene, effects=effects), declared)[1]


def asked_of(setup: FitSetup, fitted: Fitted, without: Fitted, declared: Scene, name: str) -> Confirmed:
    """What the change gains on all usable pixels, for how many numbers."""
    gain = 2.0 * (log_likelihood(setup, fitted) - log_likelihood(setup, without))
    label = object_of(name)
    numbers = of(name).numbers(declared, fitted.scene, label)
    own = own_material(declared, fitted.scene, label)
    return Confirmed(name, gain, numbers + (len(fitted.scene.materials[own].learn) if own else 0))


def views_left_out(
    setup: FitSetup, fitted: Fitted, without: Fitted, declared: Scene, name: str, quiet: bool
) -> ViewsLeftOut:
    """Explain each view with the object as the other views have it, and without the change.

    The others place the object. They also give the size and the own material of one that was missing. All else is
    fitted to all views in both models, on all usable pixels above a common floor.
    """
    names = [view.view.name for view in fitted.problem.views]
    if len(names) < 2:
        return ViewsLeftOut(0.0, 0.0, len(names))
    exact = Exact.of(setup, fitted)
    lacking, end = exact.settled(still(without.scene), flat=ENOUGH)
    label = object_of(name)
    free = with_free(fitted.scene, of(name).coordinates(declared, fitted.scene, label))
    own, only_view = own_material(declared, fitted.scene, label), of(name).only_view(label)
    all_views: PosedProblem | None = None
    seen, gains = [], []
    for view in names:
        scene = still(fitted.scene)
        if only_view is not None:
            if only_view != view:
                continue  # the image is the same with and without
            pairs = _by_halves(exact, free, lacking, end.x, still(fitted.scene), view)
            seen += [one for one, _ in pairs]
            gains += [gain for _, gain in pairs]
            continue
        if next(freed(free), None) is not None:
            others = exact.problem(free, [each for each in names if each != view])
            all_views = all_views or exact.problem(free)
            others.begin_with(all_views)
            known = descend(others, others.x0, most=MOST_STEPS, flat=ENOUGH, near=True)
            there = others.geometry.at(known.x[others.size :])
            scene = like_sensor(scene, there)
            scene = scene if scene.assembly is None else posed(scene, there.objects)
            scene = _with_own(scene, others, known.x, own)
        whole, settled = exact.settled(still(scene), flat=ENOUGH)
        images = zip(exact.images(lacking, end.x, view), exact.images(whole, settled.x, view), strict=True)
        for (one, before), (_, after) in images:
            seen.append(one)
            gains.append(_gain(one, before, after))
    return summed(seen, gains, len(names), quiet)


def _gain(seen: Observation, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Log-likelihood that every pixel gains: as measured, and on average were the model true; shape (2, n)."""
    return np.stack(
        [
            loss_terms("gamma", beta0, before, seen.looks) - loss_terms("gamma", beta0, after, seen.looks)
            for beta0 in (seen.values, after)
        ]
    )


def _by_halves(
    exact: Exact, free: Scene, lacking: PosedProblem, x: np.ndarray, whole: Scene, view: str
) -> list[tuple[Observation, np.ndarray]]:
    """A view's observations with what each pixel gains by its own angle, which the other half of its pixels tells.

    No other view can tell it. The halves are blocks of columns in turn: were the angle no property of the view but a
    body's pose, the halves without the body would speak against it.
    """
    settled, there = exact.settled(whole, flat=ENOUGH)
    befores = exact.images(lacking, x, view)
    afters = [after.copy() for _, after in exact.images(settled, there.x, view)]
    for half in (0, 1):
        own = exact.problem(free, [view], half=half)
        angle = own.geometry.at(descend(own, own.x0, flat=ENOUGH, near=True).x)
        other = exact.problem(like_sensor(whole, angle))
        for (seen, _), into, (_, mu) in zip(befores, afters, exact.images(other, there.x, view), strict=True):
            judged = ~column_blocks(seen, half)[seen.interior]
            into[judged] = mu[judged]
    return [(seen, _gain(seen, before, after)) for (seen, before), after in zip(befores, afters, strict=True)]


def _with_own(scene: Scene, problem: PosedProblem, x: np.ndarray, own: str | None) -> Scene:
    """The scene whose material `own` is that of x, and is learned no more."""
    if own is None:
        return scene
    found = learned_scene(*problem.split(x)).materials[own].model_copy(update={"learn": ()})
    return replace(scene, materials={**scene.materials, own: found})
