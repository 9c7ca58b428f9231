"""What is left of the measured images once a model is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.learning.identify import residual_autocovariance, score_products
from warpsar.learning.observation import Observation
from warpsar.learning.problem import FitProblem
from warpsar.learning.verdict import TRACE
from warpsar.runtime.distributed import ONE, Ranks

# Standard deviations at which a residual is cut off. Speckle hardly ever goes further (e^-9 at one look). Without the
# cut, a few pixels of what is missing would decide every score and the correlation of speckle.
LARGEST = 8.0


@dataclass(frozen=True)
class Evidence:
    """Residuals of all observations' pixels, one after the other: arrays of shape (n,).

    `standardised` is sqrt(L) (I - mu) / mu within +-`LARGEST`, of unit variance for white speckle and a true model;
    `root_looks` is sqrt(L) of the pixel. `modelled` is mu before the gain of images that are not calibrated.
    `autocovariance` is the standardised residual's own, shape (lags, lags). `silent` is an image per observation,
    shape (rows, cols): the residual -sqrt(L) where a pixel measures exactly 0 and the model puts more than a trace of
    light, 0 elsewhere.
    """

    observations: Sequence[Observation]
    modelled: Sequence[np.ndarray]
    standardised: np.ndarray
    root_looks: np.ndarray
    autocovariance: np.ndarray
    silent: Sequence[np.ndarray]

    @classmethod
    def of(cls, problem: FitProblem, x: np.ndarray, ranks: Ranks = ONE) -> Evidence:
        """What the problem's model at `x` leaves."""
        seen = problem.observations
        modelled = [ranks.same(mu) for mu in problem.modelled(x)]
        silent = _silent(problem, modelled)
        parts = [
            np.clip(np.sqrt(s.looks) * (s.values / (gain * mu) - 1.0), -LARGEST, LARGEST)
            for s, mu, gain in zip(seen, modelled, problem.gains(modelled), strict=True)
        ]
        autocovariance = residual_autocovariance(list(zip(seen, parts, strict=True)))
        roots = np.concatenate([np.full(e.size, np.sqrt(s.looks)) for s, e in zip(seen, parts, strict=True)])
        return cls(seen, modelled, np.concatenate(parts), roots, autocovariance, silent)

    def split(self, pixels: np.ndarray) -> list[np.ndarray]:
        """An array over all pixels, (n, ...), as one per observation."""
        return np.split(pixels, np.cumsum([mu.size for mu in self.modelled])[:-1])

    def products(self, scaled: np.ndarray) -> np.ndarray:
        """Variance of sum(scaled * standardised), shape (k, k), for `scaled` of shape (n, k)."""
        parts = zip(self.split(scaled), self.observations, strict=True)
        return np.sum([score_products(part, self.autocovariance, seen) for part, seen in parts], axis=0)


def _silent(problem: FitProblem, modelled: Sequence[np.ndarray]) -> list[np.ndarray]:
    """`Evidence.silent`, from the images that were rendered last."""
    pairs = [(view, seen) for view in problem.views for seen in view.observations]
    found = []
    for (view, seen), mu in zip(pairs, modelled, strict=True):
        image = view.render.images[seen.polarization].numpy().reshape(seen.interior.shape)
        lit = seen.silent & (image > TRACE * np.median(mu))
        found.append(np.where(lit, -np.sqrt(seen.looks), 0.0))
    return found
