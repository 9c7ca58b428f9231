"""Score tests where some fitted parameters are known to a tolerance.

A tolerance is one more measurement of its parameter, in units of its own standard deviation. So it is a row under the
standardised pixels: d deviation / dx in the tangent, minus the deviation in the residual, and 0 in every template. The
tangent space of all rows is projected out. On the pixels that is not a projection but a ridge: with A the tangent and D
the rows, A (A'A + D'D)^-1 A' is taken off. A parameter that is known well is hardly free to imitate an effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpsar.learning.problem import FitProblem


@dataclass(frozen=True)
class PartlyKnown:
    """The rows of k tolerances: `slopes`, shape (k, p), and `residual`, shape (k,), of unit variance."""

    slopes: np.ndarray
    residual: np.ndarray

    @classmethod
    def of(cls, problem: FitProblem) -> PartlyKnown:
        """What the problem's scene knows, at its own values."""
        return cls(problem.prior.slopes(problem.x0), -problem.prior.deviations(problem.x0))

    def under(self, tangent: np.ndarray) -> np.ndarray:
        """The tangent, shape (n, q), with these rows under it; columns beyond x (gains) are not known."""
        rows = np.zeros((len(self.slopes), tangent.shape[1]))
        rows[:, : self.slopes.shape[1]] = self.slopes
        return np.vstack([tangent, rows])

    def drawn(self, random: np.random.Generator, draws: int) -> np.ndarray | None:
        """Errors of what is known, shape (k, draws); None where nothing is."""
        count = self.residual.size
        return random.normal(size=(count, draws)) if count else None


NOTHING = PartlyKnown(np.zeros((0, 0)), np.zeros(0))
