"""How long a simulation will take, and how much memory: said before long work."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.runtime.forecast import LONG_S, duration
from warpsar.runtime.memory import kept_bytes

STRIPS = 5
"""Places of a view where a stretch of its columns is made."""
_FEW_RAYS = 2**17
"""Of a first strip."""
_SHARE, _MOST_S = 0.05, 4.0
"""How long the strips may take: a share of the whole, and seconds."""
_PICTURE_S = 0.2
"""Least time of a quick look: so short, it is timed where it could matter."""
_BYTES_PER_PIXEL = 40  # the quick look's copies in float64


@dataclass(frozen=True)
class SimulationForecast:
    """Of all views together, but `gib`: of the largest."""

    views: int
    pixels: int
    rays: int
    seconds: float
    gib: float

    def __str__(self) -> str:
        return (
            f"{self.views} view{'s' if self.views > 1 else ''} of {self.pixels:.3g} pixels, {self.rays:.3g} rays: "
            f"about {duration(self.seconds)} and {self.gib:.2g} GiB"
        )


def estimate(
    rays: Sequence[int],
    shape: tuple[int, int],
    polarizations: int,
    strip: Callable[[int, int], int],
    pictures: int,
    picture: Callable[[], object],
) -> SimulationForecast | None:
    """What views of so many `rays` each, and images of `shape`, will take; None where that is not long.

    `strip(first, columns)` makes so many columns of the view with the most rays, with all that is made of them, and
    returns their hits. Strips at `STRIPS` places, of one column and of several, tell what a column takes, and what a
    view takes whatever its width. `picture()` makes one of the `pictures`, which do not grow with the image.
    """
    rows, columns = shape
    most = max(max(rays), 1)
    strip(columns // 2, 1)  # compiles, loads, and builds what is kept
    narrow, hits = _timed(strip, columns, 1)
    widest = max(columns // STRIPS, min(columns, 2))
    width = min(max(2, min(columns * _FEW_RAYS // most, columns // (10 * STRIPS))), widest)
    wide, each = narrow, 0.0
    while width > 1:
        wide, hits = _timed(strip, columns, width)
        each = max(wide - narrow, 0.0) / (width - 1)
        room = min(_MOST_S, _SHARE * each * columns) / STRIPS
        if room < 2.0 * wide or width == widest:
            break
        width = min(widest, round(width * room / wide))
    fixed = max(narrow - each, 0.0)
    whole = fixed + each * columns if width > 1 else narrow * columns
    seconds = fixed * len(rays) + (whole - fixed) * sum(rays) / most
    if seconds + pictures * _PICTURE_S > LONG_S / 2:
        picture()  # loads the library that draws
        started = time.perf_counter()
        picture()
        seconds += pictures * (time.perf_counter() - started)
    gib = (kept_bytes(hits, polarizations, 0) + rows * columns * (_BYTES_PER_PIXEL + 8 * polarizations)) / 2**30
    return SimulationForecast(len(rays), rows * columns, sum(rays), seconds, gib) if seconds > LONG_S else None


def _timed(strip: Callable[[int, int], int], columns: int, width: int) -> tuple[float, int]:
    """Seconds of a strip of `width` columns, in the mean over the middles of equal parts of the image's `columns`; and
    the hits of all columns."""
    middles = (np.arange(STRIPS) + 0.5) * columns / STRIPS
    firsts = np.clip(np.round(middles - 0.5 * width), 0, columns - width).astype(int).tolist()
    started = time.perf_counter()
    hits = sum(strip(first, width) for first in firsts)
    return (time.perf_counter() - started) / STRIPS, round(hits * columns / (STRIPS * width))
