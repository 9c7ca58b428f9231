"""What is left of the measured images once a model is fitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_array, csr_array

from warpsar.compare.observation import TRACE, Observation
from warpsar.learning.problem import FitProblem
from warpsar.runtime import once
from warpsar.speckle.covariance import correlated
from warpsar.speckle.own import Patch, own_autocovariance
from warpsar.speckle.residual import residual_autocovariance

# Standard deviations at which a residual is cut off. Speckle hardly ever goes further (e^-9 at one look). Without the
# cut, a few pixels of what is missing would decide every score and the correlation of speckle.
LARGEST = 8.0
TRIALS = 32  # templates that are made dense at once


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
    def of(cls, problem: FitProblem, x: np.ndarray) -> Evidence:
        """What the problem's model at `x` leaves."""
        seen = problem.observations
        modelled = [once.decide(mu) for mu in problem.modelled(x)]
        silent = _silent(problem, modelled)
        parts = [
            np.clip(np.sqrt(s.looks) * (s.values / (gain * mu) - 1.0), -LARGEST, LARGEST)
            for s, mu, gain in zip(seen, modelled, problem.gains(modelled), strict=True)
        ]
        autocovariance = residual_autocovariance(list(zip(seen, parts, strict=True)))
        roots = np.concatenate([np.full(e.size, np.sqrt(s.looks)) for s, e in zip(seen, parts, strict=True)])
        return cls(seen, modelled, np.concatenate(parts), roots, autocovariance, silent)

    @property
    def area(self) -> float:
        """Correlation area of the speckle, in pixels; 1 for white speckle."""
        return max(float(self.autocovariance.sum() / self.autocovariance.max()), 1.0)

    def price(self) -> float:
        """What a parameter costs in 2 ln L: ln of the independent looks in the data, which are looks times pixels over
        their correlation area (Schwarz, Annals of Statistics 6, 1978), times that area. 2 ln L takes pixels for
        independent, and so counts as many times too much as pixels are correlated. Structure that the model misses is
        no speckle, and raises no price."""
        area = min(self.area, self._own_area())
        return float(area * np.log(once.decide(float(np.sum(self.root_looks**2) / area))))

    def _own_area(self) -> float:
        """`area` of the speckle alone, whatever structure lies in the residual."""
        patches = []
        for seen, part in zip(self.observations, self.split(self.standardised), strict=True):
            ratio = np.zeros(seen.interior.shape)
            ratio[seen.interior] = part / np.sqrt(seen.looks) + 1.0
            patches.append(Patch(seen.interior, ratio, seen.law))
        correlation, variance = own_autocovariance(patches)
        measured = variance != 1.0  # where no block has pixels enough, nothing is told, and the variance is set
        return max(float(correlation.sum()), 1.0) if measured else np.inf

    def split(self, pixels: np.ndarray) -> list[np.ndarray]:
        """An array over all pixels, (n, ...), as one per observation."""
        return np.split(pixels, np.cumsum([mu.size for mu in self.modelled])[:-1])

    def correlated(self, columns: np.ndarray) -> np.ndarray:
        """Covariance of `standardised`, times `columns` of shape (n, k)."""
        parts = zip(self.split(columns), self.observations, strict=True)
        return np.concatenate([correlated(part, seen.interior, self.autocovariance) for part, seen in parts])

    def products(self, columns: np.ndarray | csc_array, k: int) -> np.ndarray:
        """Covariance of sum(column * standardised) within each trial, shape (trials, k, k); `columns`, shape
        (n, trials * k), may be sparse. Work is done for the images that a trial touches."""
        found = np.zeros((columns.shape[1] // k, k, k))
        by_row = columns if isinstance(columns, np.ndarray) else csr_array(columns)
        end = 0
        for seen, mu in zip(self.observations, self.modelled, strict=True):
            first, end = end, end + mu.size
            part = by_row[first:end]
            filled = (
                part.any(axis=0) if isinstance(part, np.ndarray) else np.bincount(part.indices, minlength=part.shape[1])
            )
            touched = np.flatnonzero(filled.reshape(-1, k).any(axis=1))
            for trials in np.split(touched, range(TRIALS, touched.size, TRIALS)):
                chosen = part[:, (trials[:, None] * k + np.arange(k)).ravel()]
                dense = chosen if isinstance(chosen, np.ndarray) else np.asarray(chosen.toarray())
                weighed = correlated(dense, seen.interior, self.autocovariance)
                found[trials] += np.einsum("nti,ntj->tij", *(m.reshape(mu.size, -1, k) for m in (dense, weighed)))
        return found


def _silent(problem: FitProblem, modelled: Sequence[np.ndarray]) -> list[np.ndarray]:
    """`Evidence.silent`, from the images that were rendered last."""
    pairs = [(view, seen) for view in problem.views for seen in view.observations]
    found = []
    for (view, seen), mu in zip(pairs, modelled, strict=True):
        image = view.render.images[seen.polarization].numpy().reshape(seen.interior.shape)
        lit = seen.silent & (image > TRACE * np.median(mu))
        found.append(np.where(lit, -np.sqrt(seen.looks), 0.0))
    return found
