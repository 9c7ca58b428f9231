"""How wide a point is, from speckle alone: no model of the scene enters (btr70.py).

The power of even ground, seen by one look, is speckle. Two of its pixels are as alike as their point responses overlap:
the correlation of their powers is |sum w^2 exp(2 pi i x p / c) / sum w^2|^2, with the aperture's taper w at places p
and c its resolution cell (Goodman, Speckle Phenomena in Optics, chapter 4).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from btr70_measures import Chip
from measured_loop import impulse_response
from scipy.optimize import brentq

from warpsar.world.taper import taper

EDGE = 22  # rows at the chip's top and bottom: nothing but grass
FAR = (5, 6)  # pixels apart, where speckle has nothing in common: what is left there is the ground's own
PLACES = (np.arange(400) + 0.5) / 400 - 0.5
WEIGHTS = taper("taylor", PLACES) ** 2


def correlation_at(distance_m: float, fwhm_m: float) -> float:
    """Of the powers of two places in speckle, for a Taylor response of this half-power width."""
    cell_m = fwhm_m / _CELLS
    wave = np.exp(2j * np.pi * distance_m / cell_m * PLACES)
    return float(abs((WEIGHTS * wave).sum() / WEIGHTS.sum()) ** 2)


def _half_power() -> float:
    """Full width of the Taylor response at half its power, in resolution cells."""
    return 2.0 * float(brentq(lambda x: float(impulse_response(np.array(x), 1.0, "taylor")) - 0.5, 0.1, 1.5))


_CELLS = _half_power()


def neighbours(power: np.ndarray, axis: int) -> float:
    """Correlation of neighbouring pixels along an axis, in the rows of grass of a chip."""
    found = []
    for rows in (power[:EDGE], power[-EDGE:]):
        off = np.moveaxis(rows / rows.mean() - 1.0, axis, 0)
        lagged = [float((off[lag:] * off[: len(off) - lag]).mean()) for lag in range(max(FAR) + 1)]
        far = float(np.mean([lagged[lag] for lag in FAR]))
        found.append((lagged[1] - far) / (lagged[0] - far))
    return float(np.mean(found))


def width_m(chips: Sequence[Chip], axis: int, spacing_m: float) -> tuple[float, float]:
    """Half-power width of the point response along an axis [m], and its standard deviation: that of the chips' mean."""
    each = np.array([neighbours(chip.power, axis) for chip in chips])

    def width(correlation: float) -> float:
        return float(brentq(lambda w: correlation_at(spacing_m, w) - correlation, 0.5 * spacing_m, 10.0 * spacing_m))

    mean, error = float(each.mean()), float(each.std(ddof=1) / np.sqrt(each.size))
    return width(mean), 0.5 * (width(mean + error) - width(mean - error))
