"""Whether an object explains what is seen: in the pixels that it touches, and in views that it was placed without."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.explained import Compared, Explained
from warpsar.diagnosis.models.left_out import ViewsLeftOut, clipped
from warpsar.diagnosis.proposals.fit import Standing, TrialGround, alone
from warpsar.diagnosis.proposals.places import BodyPlace
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import loss_terms
from warpsar.speckle.residual import residual_autocovariance

STEPS, FLAT = 4, 1.0  # of the fit without a view: it begins where all views have the object


def left_out(
    ground: TrialGround, without: Standing, whole: Standing, found: Callable[[str], list[BodyPlace]]
) -> ViewsLeftOut:
    """Log-likelihood of every view with an object that the other views propose, over that without it.

    `found` gives the places that the views without one propose by themselves. Where the object covers none of them, the
    view gains nothing. Else its pose, size and own material come from these views. The fit begins where all views have
    the object, and which primitive it is comes from all of them: a fit from the others' own place ends the same, and
    takes seven times as long. Everything else is a nuisance, and is at its best for all views in both models, as
    `diagnosis.left_out` has it for effects. One view cannot place an object: with two views the place comes from both.
    """
    names = list(ground.pixels)
    before = _by_view(without)
    seen: list[Observation] = []
    gains: list[np.ndarray] = []
    for name in names:
        others = [view for view in names if view != name]
        if len(others) > 1 and not _covers(whole.scene, found(name)):
            for one, _ in before[name]:
                seen.append(one)
                gains.append(np.zeros((2, one.values.size)))
            continue
        moved = ground.trials.settled(alone(whole.scene), views=others, most=STEPS, flat=FLAT)
        problem = ground.problem(moved.scene, views=[name])
        there = Standing(moved.scene, 0.0, problem, problem.x0)
        for (one, plain), (_, mu) in zip(before[name], _by_view(there)[name], strict=True):
            seen.append(one)
            pair = [
                loss_terms("gamma", beta0, plain, one.looks) - loss_terms("gamma", beta0, mu, one.looks)
                for beta0 in (one.values, mu)
            ]
            gains.append(clipped(np.stack(pair)))
    measured, expected = np.concatenate(gains, axis=1)
    covariance = residual_autocovariance([(one, now - mean) for one, (now, mean) in zip(seen, gains, strict=True)])
    error = float(np.sqrt(measured.size * (covariance.sum() + expected.var())))
    return ViewsLeftOut(float(measured.sum()), error, len(names), float(expected.sum()))


def _covers(scene: Scene, places: list[BodyPlace]) -> bool:
    """Whether one of `places` lies in the last object's foot, to a pixel."""
    last = scene.objects[-1]
    assert last.size_m is not None
    pixel_m = max(scene.grid.spacing_m)
    return any(
        math.dist(one.position_m[:2], last.position_m[:2]) < max(one.width_m, *last.size_m[:2]) / 2.0 + pixel_m
        for one in places
    )


def explained(without: Standing, whole: Standing) -> float:
    """How much of what was unlike speckle the object explains, in the pixels that it touches: 1 for all of it."""
    pairs = zip(without.observations, without.modelled(), whole.modelled(), strict=True)
    return Explained.of(
        Compared(seen.looks, seen.values, plain, mu, 0.5 * seen.law.expected_deviance) for seen, plain, mu in pairs
    ).share


def _by_view(standing: Standing) -> dict[str, list[tuple[Observation, np.ndarray]]]:
    found: dict[str, list[tuple[Observation, np.ndarray]]] = {}
    for seen, mu in zip(standing.observations, standing.modelled(), strict=True):
        found.setdefault(seen.view.name, []).append((seen, mu))
    return found
