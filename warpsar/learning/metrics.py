"""How well a fit's images agree with the measured ones, over all views."""

from __future__ import annotations

import numpy as np

from warpsar.learning.coordinates import DeviceX
from warpsar.learning.problem import FitProblem
from warpsar.speckle.likelihood import METRICS, metrics, metrics_of


def pooled_metrics(problem: FitProblem, x: np.ndarray | DeviceX) -> dict[str, float]:
    """The mean of each observation's `likelihood.metrics` over its interior, weighted by its pixels, of all views.

    An x on the device stays there where the images are calibrated: only sums leave it.
    """
    observations = problem.observations
    if isinstance(x, DeviceX) and problem.scene.grid.calibrated:
        moments = problem.moments(x)
        parts = [metrics_of(sums, seen.count, seen.law) for seen, sums in zip(observations, moments, strict=True)]
    else:
        modelled = problem.modelled(x)
        pairs = zip(observations, modelled, problem.gains(modelled), strict=True)
        parts = [metrics(seen.values, gain * mu, seen.law) for seen, mu, gain in pairs]
    total = np.zeros(len(METRICS) + 1)
    for seen, found in zip(observations, parts, strict=True):
        total += seen.count * np.array([*(found[key] for key in METRICS), 1.0])
    *sums, count = problem.over_views(total)
    return {key: float(value / count) for key, value in zip(METRICS, sums, strict=True)}
