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
    volumes = np.array([one.log_determinant for one in covariances])
    scales = (np.geomspace(least, most, SCALES) / usual) ** 2
    spaces = [_space(one.whitened(without.slopes)) for one in covariances]
    misfits = np.array(
        [_misfit(one.whitened(without.left), space) for one, (space, _) in zip(covariances, spaces, strict=True)]
    )
    freedom = np.array([size - np.count_nonzero(sizes) for _, sizes in spaces])
    information = np.array([2.0 * np.log(sizes[sizes > 0.0]).sum() for _, sizes in spaces])
    likely = misfits[:, None] / scales + freedom[:, None] * np.log(scales) + (volumes + information)[:, None]
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
    every = np.concatenate([np.pad(one.slopes, ((0, 0), (0, widest - one.slopes.shape[1]))) for one in tried], axis=1)
    charges, charged = np.unique([one.counted for one in tried], return_inverse=True)
    bare, best, own = np.full(DRAWS, np.inf), np.full((charges.size, DRAWS), np.inf), np.inf
    for one, (space, _), volume in zip(covariances, spaces, volumes.tolist(), strict=True):
        white, columns = (each - space @ (space.T @ each) for each in (one.whitened(series), one.whitened(every)))
        misfit = (white**2).sum(axis=0)
        free, _ = _space(columns.reshape(size, len(tried), widest).swapaxes(0, 1))
        parts = free.swapaxes(1, 2).reshape(-1, size).astype(np.float32) @ white.astype(np.float32)  # the most work
        taken = (parts**2).reshape(len(tried), -1, DRAWS).sum(axis=1)
        most_taken = np.stack([taken[charged == k].max(axis=0) for k in range(charges.size)])
        bare = np.minimum(bare, cost(misfit, volume))
        best = np.minimum(best, cost(np.maximum(misfit - most_taken, 0.0), volume))
        after = _misfit(one.whitened(chosen.left), _space(one.whitened(chosen.slopes))[0])
        own = min(own, float(cost(after, volume)))
    gains = (bare - best - charges[:, None] * np.log(size)).max(axis=0)
    own_bare = min(float(cost(*each)) for each in zip(misfits.tolist(), volumes.tolist(), strict=True))
    gain = own_bare - own - counted * np.log(size)
    return float(((gains >= gain).sum() + 1.0) / (DRAWS + 1.0))


def _space(columns: F64) -> tuple[F64, F64]:
    """Of the space that columns (..., n, k) span: orthonormal vectors (..., n, k), and how long the columns are along
    each (..., k). Both are 0 where columns say the same."""
    if not columns.shape[-1]:
        return columns, np.zeros((*columns.shape[:-2], 0))
    vectors, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    kept = sizes > 1e-6 * np.maximum(sizes.max(axis=-1, keepdims=True), 1e-9)
    return vectors * kept[..., None, :], sizes * kept


def _misfit(white: F64, space: F64) -> float:
    """The square of what a space leaves."""
    return float(((white - space @ (space.T @ white)) ** 2).sum())
