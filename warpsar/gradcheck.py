"""The tape against finite differences, on the scene that is about to be fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from warpsar.fit import FitProblem

STEP = 2e-2  # in the coordinates of x
# float32 images leave about 1e-4 of a derivative over STEP, and Richardson's extrapolation no truncation beside it.
TOLERANCE = 1e-2
CHECKS = 12
# The check is made this far from x, and no derivative counts as smaller than what the curvature gives over so much: at
# a minimum, where a run may well begin, derivatives are 0 and their differences noise.
AWAY = 0.1


@dataclass(frozen=True)
class GradientCheck:
    """Largest difference between adjoint and central differences, relative to the derivative, over `directions`
    directions."""

    worst: float
    directions: int

    @property
    def passed(self) -> bool:
        return self.worst < TOLERANCE


def check_gradient(problem: FitProblem, x: np.ndarray) -> GradientCheck:
    """Near x, along one random direction in each group of x (a material's parameter, an effect's parameter), or in
    as many joined groups as `CHECKS` allows."""
    groups: dict[str, list[int]] = {}
    for index, label in enumerate(problem.labels):
        groups.setdefault(label.split("[")[0], []).append(index)
    chosen: list[list[int]] = [[] for _ in range(min(CHECKS, len(groups)))]
    for number, members in enumerate(groups.values()):
        chosen[number % CHECKS] += members
    random = np.random.default_rng(0)
    low, high = problem.bounds
    x = np.clip(x + AWAY * random.choice([-1.0, 1.0], x.size), low + 2.0 * STEP, high - 2.0 * STEP)
    _, gradient = problem.gradient(x)
    middle = problem.loss_on_device()
    adjoint, numeric, least = [], [], []
    for members in chosen:
        direction = np.zeros_like(x)
        direction[members] = random.choice([-1.0, 1.0], len(members))
        adjoint.append(float(gradient @ direction))
        up, upper, lower, down = (_loss(problem, x + part * STEP * direction) for part in (1.0, 0.5, -0.5, -1.0))
        numeric.append((8.0 * (upper - lower) - (up - down)) / (6.0 * STEP))
        least.append(AWAY * abs(up - 2.0 * middle + down) / STEP**2)
    difference = np.abs(np.array(adjoint) - np.array(numeric))
    scale = np.maximum(np.abs(numeric), least)
    scale = np.maximum(scale, 1e-3 * max(float(scale.max()), 1e-300))
    return GradientCheck(float((difference / scale).max()), len(chosen))


def _loss(problem: FitProblem, x: np.ndarray) -> float:
    problem.gradient(x)  # runs everything that carries the loss, total variation too
    return problem.loss_on_device()
