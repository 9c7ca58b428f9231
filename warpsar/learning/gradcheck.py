"""The tape's gradient against finite differences, on the scene that is about to be fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from warpsar.learning.problem import FitProblem

STEP = 2e-2  # in the coordinates of x
# float32 images leave about 1e-4 of a derivative over STEP, and Richardson's extrapolation no truncation beside it.
TOLERANCE = 1e-2
SHORTEST = 2e-3  # step, where halving does not settle it
CHECKS = 12
# The check is made this far from x, and no derivative counts as smaller than the curvature times this distance: a run
# may begin at a minimum, where derivatives are 0 and their differences noise.
AWAY = 0.1


@dataclass(frozen=True)
class GradientCheck:
    """The largest difference between adjoint and central differences over `directions` directions.

    It is relative to the derivative.
    """

    worst: float
    directions: int

    @property
    def passed(self) -> bool:
        return self.worst < TOLERANCE


def check_gradient(problem: FitProblem, x: np.ndarray) -> GradientCheck:
    """Compare near x, along one random direction in each group of x: a material's or an effect's parameter, a table.

    Where there are more than `CHECKS` groups, several share a direction.
    """
    groups = _groups(problem)
    chosen = [np.concatenate(groups[number::CHECKS]) for number in range(min(CHECKS, len(groups)))]
    random = np.random.default_rng(0)
    low, high = problem.bounds
    x = np.clip(x + AWAY * random.choice([-1.0, 1.0], x.size), low + 2.0 * STEP, high - 2.0 * STEP)
    middle, gradient = problem.gradient(x)
    middle, gradient = middle - problem.prior.value(x), gradient - problem.prior.gradient(x)  # it would hide the rest
    adjoint, numeric, least = [], [], []
    for members in chosen:
        direction = np.zeros_like(x)
        direction[members] = random.choice([-1.0, 1.0], members.size)
        adjoint.append(float(gradient @ direction))
        slope, curvature = _differences(partial(_along, problem, x, direction), middle, adjoint[-1])
        numeric.append(slope)
        # a table or a term that the images do not tell still has its prior's curvature, which is 1
        least.append(AWAY * (abs(curvature) + float(np.sum(direction[problem.of_values] ** 2))))
    difference = np.abs(np.array(adjoint) - np.array(numeric))
    scale = np.maximum(np.abs(numeric), least)
    scale = np.maximum(scale, 1e-3 * max(float(scale.max()), 1e-300))
    return GradientCheck(float((difference / scale).max()), len(chosen))


def _differences(loss: Callable[[float], float], middle: float, expected: float) -> tuple[float, float]:
    """First derivative at 0, extrapolated from central differences (Richardson), and the second one over `STEP`.

    Near a bright point the nulls of a sinc, sampled at pixel centres, bend the loss over hundredths. So the step is
    halved, where the first derivative is not the expected one, until halving changes nothing more.
    """
    step, (up, down) = STEP, (loss(STEP), loss(-STEP))
    curvature, slope = (up - 2.0 * middle + down) / step**2, np.inf
    while True:
        upper, lower = loss(step / 2.0), loss(-step / 2.0)
        before, slope = slope, (8.0 * (upper - lower) - (up - down)) / (6.0 * step)
        change = min(abs(slope - before), abs(slope - expected))
        if change < 0.3 * TOLERANCE * max(abs(slope), AWAY * abs(curvature)) or step < SHORTEST:
            return slope, curvature
        step, up, down = step / 2.0, upper, lower


def _along(problem: FitProblem, x: np.ndarray, direction: np.ndarray, distance: float) -> float:
    there = x + distance * direction
    return problem.loss_at(there) - problem.prior.value(there)


def _groups(problem: FitProblem) -> list[np.ndarray]:
    """Indices of each group of x."""
    groups: dict[tuple[str, str], list[np.ndarray]] = {}
    start = 0
    for block in problem.surface.blocks:
        if block.learn:
            groups[block.material, block.kind.key] = [np.arange(start, start + block.size)]
            start += block.size
    for index, c in enumerate(problem.effect_coordinates, start):
        groups.setdefault((c.effect, c.key), []).append(np.array([index]))
    whole = np.arange(problem.x0.size)[problem.of_values]
    groups |= {(block.material, block.key): [whole[part]] for block, part in problem.values.parts}
    return [np.concatenate(members) for members in groups.values()]
