"""The response of a system to a point: widths, and the area that makes power of sigma."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from warpsar.formats.base.taper import taper


@cache
def width_in_cells(window: str) -> float:
    """Half-power width of a tapered band's response, in cells of the band: 0.886 without a taper."""
    position = (np.arange(1024) + 0.5) / 1024 - 0.5
    weights = taper(window, position)
    low, high = 0.3, 2.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        power = (weights @ np.cos(np.pi * middle * position)) ** 2 / weights.sum() ** 2
        low, high = (middle, high) if power > 0.5 else (low, middle)
    return 0.5 * (low + high)


def band_weights(window: str, count: int) -> NDArray[np.float64]:
    """The taper of a band's `count` samples, as `measured.focus` applies it."""
    return taper(window, (np.arange(count) + 0.5) / count - 0.5)
