"""How often values without a cause look as if they had one: series made up under the model as it stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.differences import Differences
from warpsar.calibration.scatter import ErrorCovariance, ExtraScatter

F64 = NDArray[np.float64]
DRAWS = 1000
"""Made-up series: a chance of 1 % is known to 0.3 %."""
IMAGE_SHARES = (0.0, 0.15, 0.3, 0.5, 0.8, 1.2, 2.0)
"""Scatter from image to image over that from value to value, clutter included, at which series are compared."""

SCALES = 24
"""Of the scatter, from least to largest, with which series are made."""


@dataclass(frozen=True)
class ModelledValues:
    """What a model leaves of the values, (n,), and its slopes by each free parameter, (n, k)."""

    left: F64
    slopes: F64


@dataclass(frozen=True)
class TriedCause:
    """Slopes (n, p) by what a cause would free, and the parameters for which it is charged."""

    slopes: F64
    counted: int


def chance_of_gain(
    data: Differences,
    scatter: ExtraScatter,
    without: ModelledValues,
    chosen: ModelledValues,
    counted: int,
    tried: Sequence[TriedCause],
) -> float:
    """The chance that values of the model `without` a further cause gain as much by the best of all that is tried.

    A gain is twice the log-likelihood, less ln n for each of the `counted` parameters. The errors' scale, between the
    least and the largest scatter that there is, and the share of the images are fitted anew with and without the cause:
    where values or images are few, a large gain is likely. Series are made with scales and shares drawn by their
    restricted likelihood, so what few values leave unknown of them is not taken as known. What is tried moves to first
    order, what the model has already stays free.
    """
    size, rng = len(data), np.random.default_rng(len(data))
    usual, least, most = (
        float(np.sqrt(np.mean(data.sd**2) + each**2)) for each in (scatter.value, data.least_scatter, data.most_scatter)
    )
    several = np.bincount(data.image).max(initial=0) > 1 and np.unique(data.image).size > 2
    images = np.array(IMAGE_SHARES if several else (0.0,)) * usual
    covariances = [ErrorCovariance(data, ExtraScatter(scatter.value, float(image))) for image in images]
    scales = (np.geomspace(least, most, SCALES) / usual) ** 2
    likely = np.array([_restricted(one, without, scales) for one in covariances])
    likely = np.exp(0.5 * (likely.min() - likely)).ravel()
    share, scale = np.divmod(rng.choice(likely.size, DRAWS, p=likely / likely.sum()), SCALES)
    series = np.sqrt(covariances[0].diagonal)[:, None] * rng.normal(size=(size, DRAWS))
    series += images[share] * rng.normal(size=(covariances[0].count, DRAWS))[data.image]
    series *= np.sqrt(scales[scale])

    def cost(misfit: F64 | float, volume: float) -> F64:
        """Minus twice the log-likelihood at the best scale."""
        fitted = np.clip(np.asarray(misfit, np.float64) / size, scales[0], scales[-1])
        return np.asarray(misfit / fitted + size * np.log(fitted) + volume)

    widest = max(one.slopes.shape[1] for one in tried)
    padded = [np.pad(one.slopes, ((0, 0), (0, widest - one.slopes.shape[1]))) for one in tried]
    every = np.concatenate(padded, axis=1)
    bare, best, own_bare, own = np.full(DRAWS, np.inf), np.full((len(tried), DRAWS), np.inf), np.inf, np.inf
    for one in covariances:
        basis = _basis(one.whitened(without.slopes))
        white, columns = (each - basis @ (basis.T @ each) for each in (one.whitened(series), one.whitened(every)))
        misfit = (white**2).sum(axis=0)
        free = np.concatenate([_basis(each, widest) for each in np.split(columns, len(tried), axis=1)], axis=1)
        taken = ((free.T @ white) ** 2).reshape(len(tried), widest, DRAWS).sum(axis=1)
        volume = one.log_determinant
        bare = np.minimum(bare, cost(misfit, volume))
        best = np.minimum(best, cost(np.maximum(misfit - taken, 0.0), volume))
        own_bare = min(own_bare, float(cost(_misfit(one, without), volume)))
        own = min(own, float(cost(_misfit(one, chosen), volume)))
    charged = np.array([one.counted for one in tried]) * np.log(size)
    gains = (bare - best - charged[:, None]).max(axis=0)
    gain = own_bare - own - counted * np.log(size)
    return float(((gains >= gain).sum() + 1.0) / (DRAWS + 1.0))


def _basis(columns: F64, width: int | None = None) -> F64:
    """Of the space that columns span, orthonormal; with columns of zeros up to a width."""
    if not columns.shape[1]:
        return columns
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    kept = vectors * (sizes > 1e-6 * max(float(sizes.max()), 1e-9))
    return kept if width is None else np.pad(kept, ((0, 0), (0, width - kept.shape[1])))


def _misfit(covariance: ErrorCovariance, model: ModelledValues) -> float:
    basis, white = _basis(covariance.whitened(model.slopes)), covariance.whitened(model.left)
    return float(((white - basis @ (basis.T @ white)) ** 2).sum())


def _restricted(covariance: ErrorCovariance, model: ModelledValues, scales: F64) -> F64:
    """Minus twice the restricted log-likelihood at each scale of the variance."""
    sizes = np.linalg.svd(covariance.whitened(model.slopes), compute_uv=False) if model.slopes.shape[1] else np.ones(0)
    sizes = sizes[sizes > 1e-6 * sizes.max(initial=1e-9)]
    volume = covariance.log_determinant + 2.0 * float(np.log(sizes).sum())
    return _misfit(covariance, model) / scales + (model.left.size - sizes.size) * np.log(scales) + volume
