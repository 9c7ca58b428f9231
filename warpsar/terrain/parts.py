"""Parts of the land cover that the file does not know: cells of one declared surface that are off together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, gaussian_filter, label, uniform_filter

from warpsar.terrain.comparison import SQUARE
from warpsar.terrain.scatter import FILLED, CellScatter

F64 = NDArray[np.float64]
Cells = NDArray[np.bool_]
WIDTHS = (SQUARE, 2 * SQUARE, 4 * SQUARE)
"""Of the squares of cells over which a part is looked for."""
OFF = 4.0
"""Standard deviations by which the mean of a square must be off to be asked for."""
LEAST_PART = 3 * SQUARE**2 // 4
"""Cells inside of its border: fewer are no part."""
NEAR, CLOSE = 2.0, 1.0
"""Standard deviation, in cells, of the smoothing that finds a border: from half of the cells, and from all."""


def part_in(ratio: F64, known: Cells, may: Cells, scatter: CellScatter) -> Cells | None:
    """The part of `may` that is off most, without its border; None where nothing is.

    `ratio`: logarithm of measured over modelled power, (rows, columns), and its `scatter`. `known`: the cells that may
    be looked at. The part may hold others: those between.
    """
    seen = known & may
    if seen.sum() < LEAST_PART:
        return None
    middle = float(np.median(ratio[seen]))
    values = np.where(seen, ratio - middle, 0.0)
    best, at, level = OFF, (0, 0), 0.0
    for width in WIDTHS:
        share = uniform_filter(1.0 * seen, width, mode="constant")
        fit = share >= FILLED
        mean = uniform_filter(values, width, mode="constant") / np.maximum(share, 1e-9)
        variance = scatter.variances[0] / (np.maximum(share, FILLED) * width**2) + scatter.common(width)
        off = np.where(fit, np.abs(mean) / np.sqrt(variance), 0.0)
        place = np.unravel_index(int(np.argmax(off)), off.shape)
        if off[place] > best:
            best, at, level = float(off[place]), (int(place[0]), int(place[1])), float(mean[place])
    return None if level == 0.0 else _about(ratio, seen, may, at, level, NEAR)


def refined(ratio: F64, known: Cells, may: Cells, part: Cells) -> tuple[Cells, Cells] | None:
    """A part that was found, with the border that all known cells show: its inner cells, and those of the border."""
    seen = known & may
    inside = part & seen
    level = float(np.median(ratio[inside]) - np.median(ratio[seen & ~part])) if inside.any() else 0.0
    rows, columns = np.nonzero(inside)
    if not rows.size or level == 0.0:
        return None
    nearest = int(np.argmin((rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2))
    whole = _grown(ratio, seen, may, (int(rows[nearest]), int(columns[nearest])), level, CLOSE)
    if whole is None:
        return None
    inner = binary_erosion(whole)
    return (inner, whole & ~inner) if inner.sum() >= LEAST_PART else None


def _about(ratio: F64, seen: Cells, may: Cells, at: tuple[int, int], level: float, smooth: float) -> Cells | None:
    whole = _grown(ratio, seen, may, at, level, smooth)
    if whole is None:
        return None
    inner = binary_erosion(whole)
    return inner if inner.sum() >= LEAST_PART else None


def _grown(ratio: F64, seen: Cells, may: Cells, at: tuple[int, int], level: float, smooth: float) -> Cells | None:
    """The cells about `at` that hang together and are off by more than half of `level`."""
    weight = gaussian_filter(1.0 * seen, smooth)
    mean = gaussian_filter(np.where(seen, ratio, 0.0), smooth) / np.maximum(weight, 1e-9)
    mean -= np.median(ratio[seen])
    numbered, count = label(may & (weight > 1e-3) & (np.sign(level) * mean > 0.5 * abs(level)))
    if not count:
        return None
    number = numbered[at]
    if number == 0:  # the middle of a square may be of another surface
        rows, columns = np.nonzero(numbered)
        nearest = int(np.argmin((rows - at[0]) ** 2 + (columns - at[1]) ** 2))
        number = numbered[rows[nearest], columns[nearest]]
    return np.asarray(numbered == number)
