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
        line, pixel = np.broadcast_arrays(np.asarray(line, np.float64), np.asarray(pixel, np.float64))
        if self.lines.size == 1:
            return np.interp(pixel, self.pixels[0], self.values[0])
        earlier = np.clip(np.searchsorted(self.lines, line) - 1, 0, self.lines.size - 2)
        share = np.clip((line - self.lines[earlier]) / (self.lines[earlier + 1] - self.lines[earlier]), 0.0, 1.0)
        found = np.empty(line.shape)
        for i in np.unique(earlier).tolist():
            here = earlier == i
            first, second = (np.interp(pixel[here], self.pixels[j], self.values[j]) for j in (i, i + 1))
            found[here] = (1.0 - share[here]) * first + share[here] * second
        return found
