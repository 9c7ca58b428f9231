"""Whether something is left beside speckle, and where: the residual's largest mean over small windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.speckle.compared import Compared

SIDES = (3, 5, 9)  # pixels on a side of a window
CACHED = 5  # draws at once: their images stay in the cache
FULL = 0.5  # share of a window that must be compared pixels


@dataclass(frozen=True)
class Spot:
    """The strongest window: `z` is its mean over its standard deviation under speckle."""

    z: float
    observation: int
    row: int
    col: int
    window: int


class Scan:
    """Window sums over the pixels of every observation; built once, run on many residuals. `sides`: of the windows.

    `silent` (see `Evidence`) holds the residual of pixels that the model lights and that measure exactly 0. They count
    in the data. In the draws they stay 0.
    """

    def __init__(
        self,
        observations: Sequence[Compared],
        autocovariance: np.ndarray,
        silent: Sequence[np.ndarray] | None = None,
        sides: Sequence[int] = SIDES,
    ) -> None:
        self.sides = tuple(sides)
        self.masks = [seen.interior for seen in observations]
        self.silent = [np.zeros(mask.shape) for mask in self.masks] if silent is None else silent
        self.boxes, self.scales = [], []
        inflation = max(float(autocovariance.sum()), 1e-3)
        for mask, zeros in zip(self.masks, self.silent, strict=True):
            every = mask | (zeros != 0)
            rows, cols = np.nonzero(every)
            box = (slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1))
            counts = _sums(every[box][None].astype(float), self.sides)
            self.boxes.append(box)
            self.scales.append(
                [
                    np.where(n >= FULL * w * w, 1.0 / np.sqrt(np.maximum(n, 1.0) * inflation), 0.0)
                    for w, n in zip(self.sides, counts, strict=True)
                ]
            )

    def _windows(self, index: int, residuals: np.ndarray, *, silent: bool = False) -> list[np.ndarray]:
        """z of every window size, shape (draws, rows, cols) of the mask's box; `residuals` (pixels, draws)."""
        mask, box = self.masks[index], self.boxes[index]
        grid = np.zeros((residuals.shape[1], *mask[box].shape), residuals.dtype)
        grid[:, mask[box]] = residuals.T
        if silent:
            grid += self.silent[index][box]
        windows = _sums(grid, self.sides)
        for total, scale in zip(windows, self.scales[index], strict=True):
            total *= scale.astype(total.dtype, copy=False)
        return windows

    def largest(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Largest |z| over all windows of each draw, shape (draws,); `parts`: (pixels, draws) per observation."""
        found = np.zeros(parts[0].shape[1])
        for i, part in enumerate(parts):
            for first in range(0, found.size, CACHED):
                some = slice(first, first + CACHED)
                for z in self._windows(i, part[:, some]):
                    ends = z.max(axis=(1, 2)), -z.min(axis=(1, 2))
                    found[some] = np.maximum(found[some], np.maximum(*ends))
        return found

    def strongest(self, parts: Sequence[np.ndarray], granted: Sequence[np.ndarray] | None = None) -> Spot:
        """The strongest window of one residual, an array (pixels,) per observation.

        `granted`, of the same shapes: a residual that is granted either way. A window's z is less by what it makes
        there, and 0 where that is more.
        """
        best = Spot(0.0, 0, 0, 0, self.sides[0])
        for index, part in enumerate(parts):
            windows = self._windows(index, part[:, None], silent=True)
            less = [np.zeros(1)] * len(windows) if granted is None else self._windows(index, granted[index][:, None])
            for window, z, free in zip(self.sides, windows, less, strict=True):
                z = np.sign(z[0]) * np.maximum(np.abs(z[0]) - free[0], 0.0)
                row, col = np.unravel_index(int(np.argmax(np.abs(z))), z.shape)
                if abs(z[row, col]) > abs(best.z):
                    box = self.boxes[index]
                    place = (int(row + box[0].start), int(col + box[1].start))
                    best = Spot(float(z[row, col]), index, *place, window)
        return best


def _sums(grids: np.ndarray, sides: Sequence[int]) -> list[np.ndarray]:
    """Sums over centred windows of every pixel of (draws, rows, cols), zeros outside, one array per window size."""
    reach = max(sides) // 2
    rows, cols = grids.shape[1:]
    total = np.zeros((len(grids), rows + 2 * reach + 1, cols + 2 * reach + 1), grids.dtype)
    total[:, reach + 1 : reach + 1 + rows, reach + 1 : reach + 1 + cols] = grids
    total.cumsum(axis=1, out=total).cumsum(axis=2, out=total)
    found = []
    for window in sides:
        low, high = reach - window // 2, reach + window // 2 + 1
        bands = total[:, high : high + rows] - total[:, low : low + rows]
        found.append(bands[:, :, high : high + cols] - bands[:, :, low : low + cols])
    return found
