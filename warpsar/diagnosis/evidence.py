"""What is left of the measured images once the declared model is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.learning.identify import residual_autocovariance, score_products
from warpsar.learning.observation import Observation
from warpsar.learning.problem import FitProblem
from warpsar.runtime.distributed import ONE, Ranks

# Standard deviations beyond which a residual counts no more: speckle hardly ever goes there (e^-9 at one look), and a
# few pixels of what is missing would else decide every score, and say how speckle is correlated.
LARGEST = 8.0


@dataclass(frozen=True)
class Evidence:
    """Residuals of all observations' pixels, one after the other: arrays of shape (n,).

    `standardised` is sqrt(L) (I - mu) / mu within +-`LARGEST`, of unit variance for white speckle and a true model;
    `root_looks` is sqrt(L) of the pixel. `modelled` is mu before the gain of images that are not calibrated.
    `autocovariance` is that of the standardised residual, from itself.
    """

    observations: Sequence[Observation]
    modelled: Sequence[np.ndarray]
    standardised: np.ndarray
    root_looks: np.ndarray
    autocovariance: np.ndarray

    @classmethod
    def of(cls, problem: FitProblem, x: np.ndarray, ranks: Ranks = ONE) -> Evidence:
        seen = problem.observations
        modelled = [ranks.same(mu) for mu in problem.modelled(x)]
        parts = [
            np.clip(np.sqrt(s.looks) * (s.values / (gain * mu) - 1.0), -LARGEST, LARGEST)
            for s, mu, gain in zip(seen, modelled, problem.gains(modelled), strict=True)
        ]
        autocovariance = residual_autocovariance(list(zip(seen, parts, strict=True)))
        roots = np.concatenate([np.full(e.size, np.sqrt(s.looks)) for s, e in zip(seen, parts, strict=True)])
        return cls(seen, modelled, np.concatenate(parts), roots, autocovariance)

    def split(self, pixels: np.ndarray) -> list[np.ndarray]:
        """An array over all pixels, (n, ...), as one per observation."""
        return np.split(pixels, np.cumsum([mu.size for mu in self.modelled])[:-1])

    def products(self, scaled: np.ndarray) -> np.ndarray:
        """Variance of sum(scaled * standardised), shape (k, k), for `scaled` of shape (n, k)."""
        parts = zip(self.split(scaled), self.observations, strict=True)
        return np.sum([score_products(part, self.autocovariance, seen) for part, seen in parts], axis=0)
