"""Covariance of correlated residuals, as an operator: no matrix over all pixels is ever built."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

BATCH = 16  # images that are transformed at once: they stay in the cache


def correlated(columns: np.ndarray, inside: np.ndarray, autocovariance: np.ndarray) -> np.ndarray:
    """C @ `columns`, where C is the covariance of residuals on the pixels `inside` one image.

    `columns` has shape (pixels, k), `inside` (rows, cols), bool, and `autocovariance` (lags, lags), odd, symmetric
    about its middle. The sums over lags are products of spectra, on an image padded so that no lag reaches around it.
    """
    if np.count_nonzero(autocovariance) == 1:
        return autocovariance.max() * columns
    rows, cols = np.nonzero(inside)
    box = inside[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    high, wide = box.shape
    reach = autocovariance.shape[0] // 2
    shape = (next_fast_len(high + reach, real=True), next_fast_len(wide + reach, real=True))
    lags = np.arange(-reach, reach + 1)
    kernel = np.zeros(shape)
    np.add.at(kernel, (lags[:, None] % shape[0], lags % shape[1]), autocovariance)
    spectrum = rfft2(kernel)
    found = np.empty(columns.shape)
    for first in range(0, columns.shape[1], BATCH):
        part = columns[:, first : first + BATCH]
        grids = np.zeros((part.shape[1], high, wide))
        grids[:, box] = part.T
        grids = irfft2(rfft2(grids, shape) * spectrum, shape)[:, :high, :wide]
        found[:, first : first + BATCH] = grids[:, box].T
    return found
