"""Tables over lines and pixels, such as annotations give for calibration and noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class LineTable:
    """Vectors of values along range, each at its line; linear between pixels, and between lines.

    Beyond the outer lines and pixels the outer values hold.
    """

    lines: F64
    """(n,), ascending."""
    pixels: tuple[F64, ...]
    """Of each line, ascending."""
    values: tuple[F64, ...]

    def at(self, line: ArrayLike, pixel: ArrayLike) -> F64:
        """Values (...) at lines and pixels (...)."""
        line, pixel = np.asarray(line, np.float64), np.asarray(pixel, np.float64)
        if line.ndim == pixel.ndim == 2 and line.shape[1] == pixel.shape[0] == 1 < self.lines.size:
            return self._window(line[:, 0], pixel[0])
        line, pixel = np.broadcast_arrays(line, pixel)
        if self.lines.size == 1:
            return np.interp(pixel, self.pixels[0], self.values[0])
        earlier, share = self._between(line)
        found = np.empty(line.shape)
        for i in np.unique(earlier).tolist():
            here = earlier == i
            first, second = (np.interp(pixel[here], self.pixels[j], self.values[j]) for j in (i, i + 1))
            found[here] = (1.0 - share[here]) * first + share[here] * second
        return found

    def _window(self, line: F64, pixel: F64) -> F64:
        """Values (n, m) at all of lines (n,) and pixels (m,): each vector is looked up once, not for each line."""
        earlier, share = self._between(line)
        found = np.empty((line.size, pixel.size))
        for i in np.unique(earlier).tolist():
            here = earlier == i
            first, second = (np.interp(pixel, self.pixels[j], self.values[j]) for j in (i, i + 1))
            found[here] = (1.0 - share[here, None]) * first + share[here, None] * second
        return found

    def _between(self, line: F64) -> tuple[NDArray[np.int64], F64]:
        """The vector before each line, and how far it is to the next one, from 0 to 1."""
        earlier = np.clip(np.searchsorted(self.lines, line) - 1, 0, self.lines.size - 2)
        share = np.clip((line - self.lines[earlier]) / (self.lines[earlier + 1] - self.lines[earlier]), 0.0, 1.0)
        return earlier, share
