"""The correlation that speckle itself has in a residual, where parts of an image measured no power."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from warpsar.speckle.law import Law
from warpsar.speckle.own import BLOCK, Patch, own_autocovariance

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
