"""How long a simulation will take, and how much memory: said before long work."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from warpsar.runtime.memory import kept_bytes
from warpsar.trace.hits import Hits

LONG_S = 2.0
_FEW_RAYS, _FEW_PIXELS = 2**23, 2**22  # so few take less than LONG_S on one core
_SAMPLE_RAYS = 2**20
# One view of 8000 x 8000 pixels on two cores: 36 s from the last ray to the last file, of which the quick look is 16.
_SECONDS_PER_PIXEL = 5e-7
_BYTES_PER_PIXEL = 40  # the quick look's copies in float64


@dataclass(frozen=True)
class Estimate:
    """Of all views together, but `gib`: of the largest."""

    views: int
    pixels: int
    rays: int
    seconds: float
    gib: float

    def __str__(self) -> str:
        took = f"{self.seconds:.0f} s" if self.seconds < 120 else f"{self.seconds / 60:.0f} min"
        return (
            f"{self.views} view{'s' if self.views > 1 else ''} of {self.pixels:.3g} pixels, {self.rays:.3g} rays: "
            f"about {took} and {self.gib:.2g} GiB"
        )


def estimate(
    rays: Sequence[int], pixels: int, columns: int, polarizations: int, traced: Callable[[int, int, float], Hits]
) -> Estimate | None:
    """What views of so many `rays` each, and so many `pixels` and `columns`, will take; None where that is not long.

    `traced(begin, end, share)` makes the hits of some columns of the view with the most rays, from a share of them. A
    first, small piece only warms up; the second is timed, and stands for the rest.
    """
    if sum(rays) < _FEW_RAYS and len(rays) * pixels < _FEW_PIXELS:
        return None
    width = max(1, min(columns, columns * _SAMPLE_RAYS // max(max(rays), 1)))
    share = min(1.0, _SAMPLE_RAYS * columns / width / max(max(rays), 1))
    middle = (columns - width) // 2
    traced(middle, middle + 1, share)
    started = time.perf_counter()
    hits = traced(middle, middle + width, share)
    spent = time.perf_counter() - started
    seconds = len(rays) * pixels * _SECONDS_PER_PIXEL
    seconds += sum(rays) * spent / hits.rays if hits.rays else 0.0
    held = kept_bytes(round(hits.count * columns / width), polarizations, 0)
    gib = (held + pixels * (_BYTES_PER_PIXEL + 8 * polarizations)) / 2**30
    return Estimate(len(rays), pixels, sum(rays), seconds, gib) if seconds > LONG_S else None
