"""Widths of a system's response to a point, as the header of a complex image declares them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

UNIFORM = 0.886
"""Half-power width of an unweighted band, in cells of the band: no weights make a narrower one."""
WINDOWS = {"UNIFORM": UNIFORM, "HAMMING": 1.303, "HANNING": 1.441, "HANN": 1.441}
"""The same of windows without a parameter (Harris, Proc. IEEE 66(1), 1978, table 1)."""
_AGREE = 0.1


@dataclass(frozen=True)
class Declared:
    """Half-power widths along the image's rows and columns [m], and the bands there [1/m].

    `cells`: the widths of the weights that the header states, in cells of the band; None where it states none.
    """

    width_m: tuple[float, float]
    band: tuple[float, float]
    cells: tuple[float | None, float | None]

    def contradictions(self, source: str) -> list[str]:
        """Where a width is not that of its band and weights."""
        found = []
        for name, width, band, cells in zip(("Row", "Col"), self.width_m, self.band, self.cells, strict=True):
            message = f"{source}: Grid.{name}.ImpRespWid = {width:.4g} m contradicts ImpRespBW = {band:.4g} 1/m, which"
            if cells is not None and abs(width * band / cells - 1.0) > _AGREE:
                found.append(f"{message} gives {cells / band:.4g} m with the header's weights")
            elif cells is None and width * band < UNIFORM * (1.0 - _AGREE):
                found.append(f"{message} holds {UNIFORM / band:.4g} m at best")
        return found


def cells_of(window: str | None, weights: NDArray[np.float64] | None) -> float | None:
    """Half-power width of weights over a band, or of a window by its name, in cells of the band; None without both."""
    if weights is None or len(weights) < 2:
        return WINDOWS.get((window or "").upper())
    values = np.asarray(weights, np.float64)
    if not np.isfinite(values).all() or not values.max() > 0.0 or values.sum() <= 0.0:
        return None
    return half_power_width((np.arange(len(values)) + 0.5) / len(values), values)


def half_power_width(at: NDArray[np.float64], weight: NDArray[np.float64]) -> float:
    """Of the response to samples with their weights at spatial frequencies `at` [1/m], both ways counted, (n,) [m]."""
    about = at - (weight @ at) / weight.sum()
    reach = float(np.ptp(at)) * weight.sum() / (len(at) * weight.max())  # of a band without a taper
    low, high = 0.2 / reach, 1.0 / reach
    for _ in range(60):
        middle = 0.5 * (low + high)
        power = np.abs(weight @ np.exp(2j * np.pi * middle * about)) ** 2 / weight.sum() ** 2
        low, high = (middle, high) if power > 0.5 else (low, middle)
    return float(low + high)
