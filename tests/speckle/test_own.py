"""The correlation that speckle itself has in a residual, where parts of an image measured no power."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from warpsar.speckle.law import Law
from warpsar.speckle.own import BLOCK, LAGS, Patch, own_autocovariance

pytestmark = pytest.mark.unit


def test_a_block_without_power_says_nothing() -> None:
    """It has no level to stand about: the rest says the same as if it were outside of the image's interior."""
    law, side = Law(4.0), 8 * BLOCK
    ratio = np.random.default_rng(2).gamma(4.0, 0.25, (side, side))
    interior = np.ones((side, side), bool)
    dark = (slice(0, BLOCK), slice(BLOCK, 3 * BLOCK))
    ratio[dark] = 0.0
    ratio[0, BLOCK] = 1.0  # most of a block is enough
    without = interior.copy()
    without[dark] = False
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        correlation, variance = own_autocovariance([Patch(interior, ratio, law)])
    expected, own = own_autocovariance([Patch(without, np.where(without, ratio, 1.0), law)])
    np.testing.assert_array_equal(correlation, expected)
    assert variance == own
    assert variance == pytest.approx(1.0, abs=0.1)  # 9000 pixels of 4 looks, and medians of blocks


@pytest.mark.parametrize("sigma", [0.0, 0.7, 1.2])
@pytest.mark.parametrize("axes", [(0,), (1,), (0, 1)])
def test_what_lines_share_is_no_correlation_of_speckle(sigma: float, axes: tuple[int, ...]) -> None:
    """A ripple of 22 % (0.94 dB) along rows, columns or both lies in every block, and pixels of a line share it however
    far apart they are. The rest is the field's correlation: exp(-d^2 / (2 sigma^2))."""
    random, side = np.random.default_rng(4), 120
    patches = []
    for _ in range(6):
        fields = gaussian_filter(random.standard_normal((16, side, side)), (0.0, sigma, sigma), mode="wrap")
        power = (fields**2).mean(axis=0) / (fields**2).mean()
        for axis in axes:
            power *= np.exp(0.216 * np.sin(2.0 * np.pi * np.indices(power.shape)[axis] / 8.8))
        patches.append(Patch(np.ones(power.shape, bool), power, Law(8.0)))
    correlation, variance = own_autocovariance(patches)
    assert variance == pytest.approx(1.0, abs=0.15)
    away = np.hypot(*np.mgrid[-LAGS : LAGS + 1, -LAGS : LAGS + 1])
    expected = np.exp(-(away**2) / (2.0 * sigma**2)) if sigma else (away == 0.0).astype(float)
    np.testing.assert_allclose(correlation, expected, atol=0.06)
