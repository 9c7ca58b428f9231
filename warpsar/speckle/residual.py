"""The autocovariance of a residual, structure and all."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from warpsar.speckle.compared import ComparedPixels
from warpsar.speckle.own import LAGS, TAPER


def residual_autocovariance(
    pairs: Sequence[tuple[ComparedPixels, np.ndarray]], over_views: Callable[[np.ndarray], np.ndarray] = np.asarray
) -> np.ndarray:
    """Autocovariance of the standardised residuals, shape (2 LAGS + 1, 2 LAGS + 1).

    `pairs`: an observation, and the residual of its interior pixels divided by the speckle's own standard deviation.
    `over_views` gives the sum over all views of what is found for those of `pairs`. The taper is flat to half the
    lags (Politis and Romano, 1995). One that falls from the first lag on makes intervals a quarter too short where
    speckle is correlated over two pixels. Lags below three times their sampling error are set to zero, and so are
    negative ones: correlation can only widen an interval.
    """
    lags, size = LAGS, 2 * LAGS + 1
    total, count = np.zeros((size, size)), np.zeros((size, size))
    for seen, standardised in pairs:
        grid = np.zeros(seen.interior.shape)
        grid[seen.interior] = standardised
        inside = seen.interior.astype(float)
        for i, j in np.ndindex(lags + 1, size):  # a lag and its opposite have one product
            if i == lags and j > lags:
                continue
            for sums, image in ((total, grid), (count, inside)):
                sums[i, j] += np.einsum("ij,ij->", *_overlapping(image, lags - i, lags - j))
            total[-1 - i, -1 - j], count[-1 - i, -1 - j] = total[i, j], count[i, j]
    total, count = over_views(total), over_views(count)
    covariance = total / np.maximum(count, 1.0)
    variance = covariance[lags, lags]
    noise = covariance < 3.0 * variance / np.sqrt(np.maximum(count, 1.0))
    noise[lags, lags] = False
    return np.where(noise, 0.0, covariance) * TAPER


def _overlapping(image: np.ndarray, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """The image and the image moved by so many rows, 0 or more, and columns, where both are."""
    right, left = max(columns, 0), max(-columns, 0)
    height, width = (n - abs(move) for n, move in zip(image.shape, (rows, columns), strict=True))
    one = image[: max(height, 0), left : left + max(width, 0)]
    return one, image[rows:, right : right + max(width, 0)][: max(height, 0)]
