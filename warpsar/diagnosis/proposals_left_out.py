"""What views say of an object that was placed without them."""

from __future__ import annotations

import numpy as np

from warpsar.diagnosis.left_out import LeftOut, clipped
from warpsar.diagnosis.proposals_fit import Ground, Standing, alone
from warpsar.learning.identify import residual_autocovariance
from warpsar.learning.observation import Observation
from warpsar.speckle.likelihood import loss_terms

STEPS, FLAT = 4, 1.0  # of the fit without a view: it begins where all views have the object


def left_out(ground: Ground, without: Standing, whole: Standing) -> LeftOut:
    """Log-likelihood of every view with an object that the other views place, over that without it.

    The object's pose, size and own material come from the other views. Everything else is a nuisance, and is at its
    best for all views in both models, as `diagnosis.left_out` has it for effects.
    """
    names = list(ground.pixels)
    before = _by_view(without)
    seen: list[Observation] = []
    gains: list[np.ndarray] = []
    for name in names:
        others = [view for view in names if view != name]
        moved = ground.settled(alone(whole.scene), views=others, most=STEPS, flat=FLAT)
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
    return LeftOut(float(measured.sum()), error, len(names), float(expected.sum()))


def _by_view(standing: Standing) -> dict[str, list[tuple[Observation, np.ndarray]]]:
    found: dict[str, list[tuple[Observation, np.ndarray]]] = {}
    for seen, mu in zip(standing.observations, standing.modelled(), strict=True):
        found.setdefault(seen.view.name, []).append((seen, mu))
    return found
