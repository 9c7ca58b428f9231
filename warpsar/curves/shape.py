"""Parameters by likelihood: the likeliest values, and an interval for each by its profile."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from warpsar.curves.noise import fit
from warpsar.curves.observed import ObservedCurve

CONFIDENCE = 0.95
TWICE_LOG_LIMIT = float(chdtri(1, 1.0 - CONFIDENCE))
"""By how much 2 ln L falls from its peak to the ends of an interval."""


@dataclass(frozen=True)
class ProfileInterval:
    """What a grid of likelihoods tells of one parameter."""

    value: float
    low: float
    high: float
    """Ends of the interval. An end that the grid did not reach is the grid's own."""
    open: bool
    """Whether the interval runs into an end of the grid."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {"value": self.value, "interval_95": [self.low, self.high], "open": self.open}


def likelihood(curves: Sequence[ObservedCurve], names: Sequence[str]) -> float:
    """2 ln L of some curves, the noise fitted."""
    return 2.0 * fit(curves, names).log_likelihood


def on_grid(
    axes: Mapping[str, NDArray[np.float64]], twice_log: Callable[[Mapping[str, float]], float]
) -> NDArray[np.float64]:
    """2 ln L on every point of a grid, in the order of the axes."""
    found = [twice_log(dict(zip(axes, map(float, point), strict=True))) for point in product(*axes.values())]
    return np.array(found).reshape([len(axis) for axis in axes.values()])


def profiles(axes: Mapping[str, NDArray[np.float64]], twice_log: NDArray[np.float64]) -> dict[str, ProfileInterval]:
    """The likeliest value of every parameter and its interval: where the profile is within chi-square's of its peak.

    The profile is the largest 2 ln L over all other parameters. Between the points of the grid it is a line for the
    ends, and a parabola through three points for the peak. Where the profile jumps from point to point, since tubes
    change with the shape, the interval is wider by two standard deviations of such a difference.
    """
    found = {}
    for number, (name, axis) in enumerate(axes.items()):
        profile = twice_log.max(axis=tuple(k for k in range(twice_log.ndim) if k != number))
        peak, top = _peak(axis, profile)
        level = top - TWICE_LOG_LIMIT - 2.0 * np.sqrt(2.0) * jump(profile)
        inside = np.flatnonzero(profile >= level)
        if not len(inside):  # the parabola's peak stands over all points
            inside = np.array([int(profile.argmax())])
        low, high = _cross(axis, profile, inside[0], -1, level), _cross(axis, profile, inside[-1], 1, level)
        found[name] = ProfileInterval(peak, low, high, bool(inside[0] == 0 or inside[-1] == len(axis) - 1))
    return found


def jump(profile: NDArray[np.float64]) -> float:
    """Standard deviation of what is not smooth in a profile, from its third differences; 0 for fewer than five points.

    Third differences leave nothing of a parabola, and 20 times the variance of independent jumps.
    """
    if len(profile) < 5:
        return 0.0
    return float(np.sqrt(np.mean(np.diff(profile, 3) ** 2) / 20.0))


def _peak(axis: NDArray[np.float64], profile: NDArray[np.float64]) -> tuple[float, float]:
    i = int(profile.argmax())
    if 0 < i < len(axis) - 1:
        a, b, c = np.polyfit(axis[i - 1 : i + 2] - axis[i], profile[i - 1 : i + 2] - profile[i], 2)
        if a < 0.0:
            return float(axis[i] - b / (2 * a)), float(profile[i] + c - b * b / (4 * a))
    return float(axis[i]), float(profile[i])


def _cross(axis: NDArray[np.float64], profile: NDArray[np.float64], i: int, step: int, level: float) -> float:
    j = i + step
    if not 0 <= j < len(axis):
        return float(axis[i])
    share = np.clip((profile[i] - level) / max(profile[i] - profile[j], 1e-12), 0.0, 1.0)
    return float(axis[i] + share * (axis[j] - axis[i]))
