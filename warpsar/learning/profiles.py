"""95 % intervals of single parameters by the profile of the likelihood.

Permittivity, height and correlation length of a surface trade along a valley that is bent. A standard deviation goes
straight on where the valley turns, and its interval lies to one side of the truth. So each value is held in turn, all
others are fitted beside it, and the interval ends where 2 ln L has fallen by what speckle alone explains in 95 % of
images (Venzon and Moolgavkar, Applied Statistics 37, 1988).

A fit beside a held value can end before its minimum, or in another valley, and the interval would then be too narrow.
So it reaches as far as the profile or 1.96 standard deviations say, whichever is farther.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from warpsar.learning.identify import Z_95, Identified
from warpsar.learning.optimise import FitState, levenberg_marquardt
from warpsar.learning.problem import FitProblem

CLOSE = 0.05  # of `Z_95`, the root of what 2 ln L falls by at an end: off by less, it is found
MOST_TRIES, MOST_STEPS, FLAT = 6, 8, 0.05


def with_profiles(problem: FitProblem, x: np.ndarray, identified: Identified) -> Identified:
    """`identified` with `ends`: of every element of x the 95 % interval, shape (p, 2), in the coordinates of x.

    An end is infinite where no value within the bounds is refused, and where the standard deviation is infinite: a
    valley that the data leave open may have another one beside it. What correlated speckle adds to a variance (the
    sandwich over the inverse information) divides the gain in likelihood that it is held against. Priors count.
    """
    ends = np.full((x.size, 2), [-np.inf, np.inf])
    if x.size:
        valley = _Valley.about(problem, x, identified)
        for k in range(x.size):
            ends[k] = [valley.end(k, -1.0), valley.end(k, 1.0)]
    return replace(identified, ends=ends)


@dataclass(frozen=True)
class _Valley:
    """The likelihood about its maximum at `x`. `covariance` is that of independent pixels, `wider`, (p,), by what the
    variance of each element exceeds it."""

    problem: FitProblem
    x: np.ndarray
    loss: float
    sd: np.ndarray
    covariance: np.ndarray
    wider: np.ndarray

    @classmethod
    def about(cls, problem: FitProblem, x: np.ndarray, identified: Identified) -> _Valley:
        scale = np.sqrt(np.maximum(np.diag(identified.information), 1e-300))
        unit = identified.information / np.outer(scale, scale)
        covariance = np.linalg.pinv(unit, rcond=1e-9, hermitian=True) / np.outer(scale, scale)
        with np.errstate(divide="ignore", invalid="ignore"):
            wider = identified.sd**2 / np.diag(covariance)
        known = np.isfinite(wider) & (wider > 0.0)
        wider = np.where(known, wider, np.median(wider[known]) if known.any() else 1.0)
        return cls(problem, x, _loss(problem, x), identified.sd, covariance, wider)

    def end(self, k: int, way: float) -> float:
        """The value of element k that is refused, from x upwards (`way` 1) or downwards (-1); infinite where none
        is."""
        low, high = (bound[k] for bound in self.problem.bounds)
        room = high - self.x[k] if way > 0 else self.x[k] - low
        straight = Z_95 * float(self.sd[k])
        if not straight < room:
            return way * np.inf
        return float(self.x[k] + way * self._reach(k, way, straight, room))

    def _reach(self, k: int, way: float, least: float, room: float) -> float:
        """How far the profile reaches, `least` or farther; infinite beyond the `room` to the bound."""
        inside, outside = (0.0, 0.0), (room, np.inf)  # step and root on either side of the end
        step, along = least, self._straight(k)
        for _ in range(MOST_TRIES):
            best, loss = self._profile(k, way * step, along)
            along = (best - self.x) / (way * step)
            root = self._root(k, loss)
            if abs(root - Z_95) < CLOSE * Z_95 or (root > Z_95 and step == least):
                return step
            if root < Z_95:
                if step >= room:
                    return np.inf
                inside = step, root
            else:
                outside = step, root
            step = self._between(inside, outside, room)
        return step

    @staticmethod
    def _between(inside: tuple[float, float], outside: tuple[float, float], room: float) -> float:
        """Where the root would be `Z_95`: it rises about evenly with the step."""
        if np.isfinite(outside[1]):
            share = (Z_95 - inside[1]) / (outside[1] - inside[1])
            return inside[0] + float(np.clip(share, 0.05, 0.95)) * (outside[0] - inside[0])
        return min(inside[0] * float(np.clip(1.05 * Z_95 / max(inside[1], 1e-6), 1.2, 3.0)), room)

    def _root(self, k: int, loss: float) -> float:
        return float(np.sqrt(max(2.0 * (loss - self.loss) / self.wider[k], 0.0)))

    def _straight(self, k: int) -> np.ndarray:
        """How all elements follow element k along a straight valley, for each unit of it, shape (p,)."""
        along = self.covariance[:, k] / max(self.covariance[k, k], 1e-300)
        along[k] = 1.0
        return along

    def _profile(self, k: int, step: float, along: np.ndarray) -> tuple[np.ndarray, float]:
        """The likeliest x with element k moved by `step`, and its loss. The fit starts where all follow it as `along`
        says, or in a straight valley, whichever is likelier."""
        starts = [np.clip(self.x + step * each, *self.problem.bounds) for each in (self._straight(k), along)]
        start = min(starts, key=lambda each: _loss(self.problem, each))
        start[k] = self.x[k] + step
        moving = np.arange(self.x.size) != k
        state = FitState(start, np.inf, start, np.inf)
        for _ in range(MOST_STEPS):
            state = levenberg_marquardt(self.problem, state, moving, flat=FLAT)
            if state.arrived:
                break
        return np.asarray(state.best_x), state.best_loss


def _loss(problem: FitProblem, x: np.ndarray) -> float:
    return problem.value(problem.modelled(x)) + problem.penalty(x)
