"""Whether something is left beside speckle, and where: the residual's largest mean over small windows.

Speckle of few looks is far-tailed upwards and bounded downwards, and a small window keeps that. Next to the bright
spots of speckle a shadow is nothing. So two questions are asked, and each is judged by its own distribution
(`tail.Tails`). `POWER`: which window is the brightest, by its mean. `LIKELIHOOD`: which one is the least likely, bright
or dark, by the signed root of its likelihood ratio: of 2 k (f - 1 - ln f), for a window of k looks in all and f times
the power (Kulldorff, Communications in Statistics 26, 1997, for a law of counts). Under speckle that is nearly normal,
whatever the size and the looks. One dark pixel alone is not asked for: it is a zero of the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import window_lanes
from warpsar.runtime.devices import load_kernels
from warpsar.runtime.structs import fill
from warpsar.speckle.compared import ComparedPixels
from warpsar.speckle.tail import Tails

Window = tuple[int, int]
"""Rows and columns of pixels."""

WINDOWS: tuple[Window, ...] = ((3, 3), (5, 5), (9, 9))
POWER, LIKELIHOOD = 0, 1  # what is asked of windows
ONE_PIXEL = (1, 1)  # a window; dark ones of it are not asked for
LEAST_RATIO = 1e-2  # of power: a pixel that is 0 lies a hair beyond all that are nearly 0
FULL = 0.5  # share of a window that must be compared pixels


@dataclass(frozen=True)
class Spot:
    """The strongest `window` about a pixel: `z` is its mean over its standard deviation under speckle."""

    z: float
    observation: int
    row: int
    col: int
    window: Window

    @classmethod
    def from_content(cls, content: Mapping[str, Any]) -> Spot:
        """The spot that `asdict` gave, back from JSON."""
        window = content["window"]  # one number in checkpoints of before
        return cls(**{**content, "window": (window, window) if isinstance(window, int) else tuple(window)})


class Scan:
    """Window sums over the pixels of every observation; built once, run on many residuals.

    `silent` (see `Evidence`) holds the residual of pixels that the model lights and that measure exactly 0. They count
    in the data. In the draws they stay 0.
    """

    def __init__(
        self,
        observations: Sequence[ComparedPixels],
        autocovariance: np.ndarray,
        silent: Sequence[np.ndarray] | None = None,
        windows: Sequence[Window] = WINDOWS,
    ) -> None:
        self.windows = tuple(windows)
        self.masks = [seen.interior for seen in observations]
        self.silent = [np.zeros(mask.shape) for mask in self.masks] if silent is None else silent
        self.boxes, self.scales = [], []
        inflation = max(float(autocovariance.sum()), 1e-3)
        self.looks = [[seen.looks * r * c / inflation for r, c in self.windows] for seen in observations]
        for mask, zeros in zip(self.masks, self.silent, strict=True):
            every = mask | (zeros != 0)
            rows, cols = np.nonzero(every)
            box = (slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1))
            counts = _sums(every[box][None].astype(float), self.windows)
            self.boxes.append(box)
            self.scales.append(
                [
                    np.where(n >= FULL * rows * cols, 1.0 / np.sqrt(np.maximum(n, 1.0) * inflation), 0.0)
                    for (rows, cols), n in zip(self.windows, counts, strict=True)
                ]
            )

    def _windows(self, index: int, residuals: np.ndarray, *, silent: bool = False) -> list[np.ndarray]:
        """z of every window size, shape (draws, rows, cols) of the mask's box; `residuals` (pixels, draws)."""
        mask, box = self.masks[index], self.boxes[index]
        grid = np.zeros((residuals.shape[1], *mask[box].shape), residuals.dtype)
        grid[:, mask[box]] = residuals.T
        if silent:
            grid += self.silent[index][box]
        windows = _sums(grid, self.windows)
        for total, scale in zip(windows, self.scales[index], strict=True):
            total *= scale.astype(total.dtype, copy=False)
        return windows

    def largest(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """The largest answer to each question of each draw, shape (2, draws); `parts`: (pixels, draws) per
        observation, float32."""
        found = np.zeros((2, parts[0].shape[1]))
        for native, part, sizes in zip(self._native, parts, self.looks, strict=True):
            for window, looks, high, low in zip(self.windows, sizes, *_extremes(native, part), strict=True):
                unlikely = _root(high, looks)
                if window != ONE_PIXEL:
                    unlikely = np.maximum(unlikely, -_root(low, looks))
                found = np.maximum(found, [high, unlikely])
        return found

    @cached_property
    def _native(self) -> list[Any]:
        """A `window_lanes.Windows` of each observation, without what is silent."""
        load_kernels(wp.get_device("cpu"), "window_lanes")
        size: wp.array = wp.array(np.array(self.windows, np.int32), dtype=wp.vec2i, device="cpu")
        return [
            fill(
                window_lanes.Windows,
                size=size,
                scale=wp.array(np.concatenate(scales).astype(np.float32), device="cpu"),
                inside=wp.array(mask[box].astype(np.uint8), device="cpu"),
            )
            for mask, box, scales in zip(self.masks, self.boxes, self.scales, strict=True)
        ]

    def strongest(
        self, parts: Sequence[np.ndarray], granted: Sequence[np.ndarray] | None = None
    ) -> tuple[list[Spot], np.ndarray]:
        """The answer to each question for one residual, an array (pixels,) per observation: the window and, shape (2,),
        what `largest` says of it.

        `granted`, of the same shapes: a residual that is granted either way. A window's z is less by what it makes
        there, and 0 where that is more.
        """
        best, most = [Spot(0.0, 0, 0, 0, self.windows[0])] * 2, np.zeros(2)
        for index, part in enumerate(parts):
            found = self._windows(index, part[:, None], silent=True)
            less = [np.zeros(1)] * len(found) if granted is None else self._windows(index, granted[index][:, None])
            for window, z, free, looks in zip(self.windows, found, less, self.looks[index], strict=True):
                z = np.sign(z[0]) * np.maximum(np.abs(z[0]) - free[0], 0.0)
                high, low = z.argmax(), z.argmin()
                answers = [(POWER, high, z.flat[high]), (LIKELIHOOD, high, _root(z.flat[high], looks))]
                if window != ONE_PIXEL:
                    answers.append((LIKELIHOOD, low, -_root(z.flat[low], looks)))
                for question, at, value in answers:
                    if value > most[question]:
                        row, col = np.unravel_index(int(at), z.shape)
                        box = self.boxes[index]
                        place = (int(row + box[0].start), int(col + box[1].start))
                        best[question], most[question] = Spot(float(z[row, col]), index, *place, window), value
        return best, most


def _root(z: np.ndarray, looks: float) -> np.ndarray:
    """The signed root of the likelihood ratio of windows of so many looks, from their z."""
    factor = np.maximum(1.0 + z / np.sqrt(looks), LEAST_RATIO)
    return np.asarray(np.sign(z) * np.sqrt(2.0 * looks * np.maximum(factor - 1.0 - np.log(factor), 0.0)))


def surest(spots: Sequence[Spot], values: np.ndarray, tails: Tails) -> tuple[Spot, float]:
    """Of the `Scan.strongest` windows the most improbable, by draws of speckle, and -ln p of any so improbable."""
    return spots[tails.first(values)], float(tails(values))


def _extremes(windows: Any, residuals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The largest and the smallest z of each window, shape (windows, draws); `residuals` (pixels, draws)."""
    values = np.ascontiguousarray(residuals, np.float32)
    high, low = (np.empty((windows.size.shape[0], values.shape[1]), np.float32) for _ in range(2))
    rows, cols = windows.inside.shape
    total: wp.array = wp.empty((rows + 2) * (cols + 1) * window_lanes.LANES, dtype=float, device="cpu")
    placed: list[wp.array] = [wp.array(each, device="cpu", copy=False) for each in (values, high, low)]
    wp.launch(window_lanes.scan_kernel, 1, inputs=[windows, placed[0], total], outputs=placed[1:], device="cpu")
    return high, low


def _sums(grids: np.ndarray, windows: Sequence[Window]) -> list[np.ndarray]:
    """Sums over centred windows of every pixel of (draws, rows, cols), zeros outside, one array per window."""
    up, side = (max(window[axis] for window in windows) // 2 for axis in (0, 1))
    rows, cols = grids.shape[1:]
    total = np.zeros((len(grids), rows + 2 * up + 1, cols + 2 * side + 1), grids.dtype)
    total[:, up + 1 : up + 1 + rows, side + 1 : side + 1 + cols] = grids
    total.cumsum(axis=1, out=total).cumsum(axis=2, out=total)
    found = []
    for high, wide in windows:
        first, last = up - high // 2, up + high // 2 + 1
        bands = total[:, last : last + rows] - total[:, first : first + rows]
        first, last = side - wide // 2, side + wide // 2 + 1
        found.append(bands[:, :, last : last + cols] - bands[:, :, first : first + cols])
    return found
