"""The tape against finite differences, on the scene that is about to be fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from warpsar.fit import FitProblem

STEP = 1e-2  # in the coordinates of x; central differences, so the error is of third order
# Third derivatives of the steepest terms, exp(-(kl sin)^2), leave this at STEP; a wrong gradient is off by its own size.
TOLERANCE = 2e-2
CHECKS = 12


@dataclass(frozen=True)
class GradientCheck:
    """Largest difference between adjoint and central differences, relative to the largest derivative of one group of
    parameters, over `directions` directions."""

    worst: float
    directions: int

    @property
    def passed(self) -> bool:
        return self.worst < TOLERANCE


def check_gradient(problem: FitProblem, x: np.ndarray) -> GradientCheck:
    """Along one random direction in each group of x (a material's parameter, an effect's parameter)."""
    groups: dict[str, list[int]] = {}
    for index, label in enumerate(problem.labels):
        groups.setdefault(label.split("[")[0], []).append(index)
    chosen = list(groups.values())[:CHECKS]
    _, gradient = problem.gradient(x)
    random = np.random.default_rng(0)
    adjoint, numeric = [], []
    for members in chosen:
        direction = np.zeros_like(x)
        direction[members] = random.choice([-1.0, 1.0], len(members))
        adjoint.append(float(gradient @ direction))
        up, down = (_loss(problem, x + sign * STEP * direction) for sign in (1.0, -1.0))
        numeric.append((up - down) / (2.0 * STEP))
    difference = np.abs(np.array(adjoint) - np.array(numeric))
    scale = np.maximum(np.abs(numeric), 1e-3 * max(np.abs(numeric).max(), 1e-300))
    return GradientCheck(float((difference / scale).max()), len(chosen))


def _loss(problem: FitProblem, x: np.ndarray) -> float:
    problem.gradient(x)  # runs everything that carries the loss, total variation too
    return problem.loss_on_device()
