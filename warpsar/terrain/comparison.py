"""Measured pixels beside the simulated ones: is anything of the terrain to be seen, and what is left?

Pixels are averaged to cells, about as large as the elevation model's, so speckle is a few dB at most. Three questions
are asked, each beside a rival that knows no terrain:

- Do the patterns agree? The correlation of dB, against the same after far shifts of one image over the other. Terrain
  is alike from cell to cell, and shifted terrain is as much so.
- Does the simulation predict cells that decided nothing? Level and trends are fitted in half of the squares of a
  checkerboard, with the simulation and without it, and judged in the other half.
- Are the same cells bright? How many of the brightest tenth are among the simulation's brightest tenth.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.io.bands import bands_of, median, release
from warpsar.terrain.memory import LEAST_PIXELS, MOST_CELLS
from warpsar.terrain.result import SimulatedProduct

F64 = NDArray[np.float64]
LEAST_CELLS = 200
SHIFTS = 12
"""Along each axis: far shifts that the correlation is set against."""
CONFIDENCE = 0.95
SQUARE = 6
"""Cells along a square of the checkerboard."""
BRIGHT = 0.1
NEAR_CELLS = 4
"""How far off, in cells, a better place for the simulation is looked for."""


@dataclass(frozen=True)
class TerrainComparison:
    """Correlations are of dB; residuals are measured less simulated, less their median [dB]."""

    cell: tuple[int, int]
    """Lines and pixels averaged."""
    cells: int
    correlation: float
    by_chance: float
    """What 95 % of far shifts stay below."""
    best_correlation: float
    best_shift: tuple[int, int]
    """Lines and pixels by which the measured image lies off the simulated one, where they agree best; whole cells."""
    bright_shared: float
    """Of the brightest tenth of cells: the share that is also in the simulation's; 0.1 by chance."""
    level_db: float
    """Median of measured less simulated."""
    left_db: float
    """RMS of what is left in the squares that decided nothing, with level, trends and the simulation."""
    left_without_db: float
    """The same without the simulation."""
    slope: float
    """dB measured for a dB simulated, where it was fitted."""
    seen: bool
    words: tuple[str, ...]
    residual_db: F64
    """(rows, columns) of cells."""
    measured_db: F64
    simulated_db: F64

    def content(self) -> dict[str, Any]:
        left_out = ("residual_db", "measured_db", "simulated_db", "words")
        found = {name: value for name, value in asdict(self).items() if name not in left_out}
        return {**found, "words": list(self.words)}


def compared(found: SimulatedProduct) -> TerrainComparison | str | None:
    """None for a product without pixels; words where there are too few to say anything."""
    if not found.measured:
        return None
    image, cell = found.image, cell_of(found)

    def powers(rows: slice) -> tuple[F64, F64]:
        model = image["beta0"][rows] + (image["noise"][rows] if "noise" in image else 0.0)
        known = np.isfinite(model) & np.isfinite(image["measured"][rows])
        return np.where(known, model, np.nan), np.where(known, image["measured"][rows], np.nan)

    simulated, measured = averaged_in_bands(found, cell, powers)
    with np.errstate(all="ignore"):
        x, y = (10.0 * np.log10(power) for power in (simulated, measured))
    usable = np.isfinite(x) & np.isfinite(y)
    x, y = np.where(usable, x, np.nan), np.where(usable, y, np.nan)
    if usable.sum() < LEAST_CELLS:
        return f"{int(usable.sum())} cells of {cell[0]} x {cell[1]} pixels with values: too few to compare"
    if np.nanstd(x) < 1e-3:
        return "the simulated image is the same everywhere: there is nothing to compare"
    own = _correlation(x, y)
    chance = float(np.quantile(_shifted(x, y), CONFIDENCE))
    best, shift = _best(x, y)
    x_bright, y_bright = (each[usable] >= np.quantile(each[usable], 1.0 - BRIGHT) for each in (x, y))
    shared = float((x_bright & y_bright).sum() / y_bright.sum())
    level = float(np.median((y - x)[usable]))
    left, without, slope = _predicted(x, y, usable)
    seen = own > chance and left < without
    words = [
        f"{int(usable.sum())} cells of {cell[0]} lines x {cell[1]} pixels are compared; measured less simulated is "
        f"{level:+.1f} dB in the middle",
        f"correlation {own:+.2f}; far shifts stay below {chance:+.2f} in {CONFIDENCE:.0%}",
        f"in squares that decided nothing {left:.2f} dB are left with the simulation, {without:.2f} dB without it",
        f"of the brightest {BRIGHT:.0%} of cells {shared:.0%} are also the simulation's",
    ]
    if any(shift) and best > chance:
        words.append(
            f"they agree best ({best:+.2f}) with the measured image {shift[0] * cell[0]:+d} lines and "
            f"{shift[1] * cell[1]:+d} pixels from where it should be"
        )
    words.append("terrain is seen in this image" if seen else "terrain cannot be told from chance in this image")
    return TerrainComparison(
        cell, int(usable.sum()), own, chance, best, (shift[0] * cell[0], shift[1] * cell[1]), shared, level, left,
        without, slope, seen, tuple(words), y - x - level, y, x,
    )  # fmt: skip


def cell_of(found: SimulatedProduct) -> tuple[int, int]:
    """Lines and pixels of a cell: as large as a post's, at least `LEAST_PIXELS` along a side, and so large that there
    are `MOST_CELLS` about."""
    line_m = line_length_m(found)
    pixel_m = median(found.image["area_sigma"]) / line_m
    post = float(np.mean(found.elevation.spacing_m))
    lines, pixels = (max(round(post / max(step, 1e-3)), LEAST_PIXELS) for step in (line_m, pixel_m))
    grown = math.sqrt(math.prod(found.window.shape) / (lines * pixels * MOST_CELLS))
    return (lines, pixels) if grown <= 1.0 else (math.ceil(lines * grown), math.ceil(pixels * grown))


def line_length_m(found: SimulatedProduct) -> float:
    """Of a line on the ground, in the middle."""
    return median(found.image["area_beta"]) / abs(slant_step_m(found))


def slant_step_m(found: SimulatedProduct) -> float:
    """Of a pixel in the middle; negative where pixels run towards the radar."""
    line, pixel = (0.5 * (a + b - 1) for a, b in (found.window.lines, found.window.pixels))
    return float(found.product.grid.slant_step_m(line, pixel))


def averaged_in_bands(
    found: SimulatedProduct, cell: tuple[int, int], values: Callable[[slice], Sequence[F64]]
) -> list[F64]:
    """`averaged` of rasters of the window, whose rows `values` gives: so they need not be in memory as a whole."""
    parts: list[list[F64]] = []
    for rows in bands_of(found.window.shape, cell[0]):
        parts.append([averaged(each, cell) for each in values(rows)])
        for layer in found.image.values():
            release(layer)
    return [np.concatenate(each) for each in zip(*parts, strict=True)]


def averaged(power: F64, cell: tuple[int, int]) -> F64:
    """Means; NaN where less than half of a cell's pixels are known."""
    rows, columns = (n // step for n, step in zip(power.shape, cell, strict=True))
    cut = power[: rows * cell[0], : columns * cell[1]].reshape(rows, cell[0], columns, cell[1])
    known = np.isfinite(cut)
    count = known.sum(axis=(1, 3))
    total = np.where(known, cut, 0.0).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count >= 0.5 * cell[0] * cell[1], total / np.maximum(count, 1), np.nan)


def _correlation(x: F64, y: F64) -> float:
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < 3 or x[both].std() == 0.0 or y[both].std() == 0.0:
        return 0.0
    return float(np.corrcoef(x[both], y[both])[0, 1])


def _shifted(x: F64, y: F64) -> F64:
    """Correlations after shifts round the edge, by an eighth of a side or more."""
    rows, columns = x.shape
    down, along = (np.unique(np.linspace(n / 8, 7 * n / 8, SHIFTS).astype(int)) for n in (rows, columns))
    return np.array([_correlation(np.roll(x, (i, j), (0, 1)), y) for i in down for j in along])


def _best(x: F64, y: F64) -> tuple[float, tuple[int, int]]:
    """The largest correlation after a small shift of `y` back by (rows, columns), and that shift."""
    found = (-2.0, (0, 0))
    for i in range(-NEAR_CELLS, NEAR_CELLS + 1):
        for j in range(-NEAR_CELLS, NEAR_CELLS + 1):
            rows, columns = x.shape
            mine = x[max(-i, 0) : rows - max(i, 0), max(-j, 0) : columns - max(j, 0)]
            theirs = y[max(i, 0) : rows - max(-i, 0), max(j, 0) : columns - max(-j, 0)]
            found = max(found, (_correlation(mine, theirs), (i, j)))
    return found


def _predicted(x: F64, y: F64, usable: NDArray[np.bool_]) -> tuple[float, float, float]:
    """RMS of what is left in squares that were not fitted, with the simulation and without; and its slope."""
    row, column = np.indices(x.shape)
    fitted = ((row // SQUARE + column // SQUARE) % 2 == 0) & usable
    judged = usable & ~fitted
    ones = np.ones(x.shape)
    trends = [ones, row / x.shape[0], column / x.shape[1], (column / x.shape[1]) ** 2]
    left, slope = [], 0.0
    for terms in ([*trends, x], trends):
        table = np.stack(terms, axis=-1)
        found = np.linalg.lstsq(table[fitted], y[fitted], rcond=None)[0]
        left.append(float(np.sqrt(np.mean((y[judged] - table[judged] @ found) ** 2))))
        slope = float(found[-1]) if len(terms) > len(trends) else slope
    return left[0], left[1], slope
