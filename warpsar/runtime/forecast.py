"""What is said before long work: how long it will take."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

LONG_S = 2.0
"""Work that is shorter is not announced [s]."""


def duration(seconds: float) -> str:
    """In words: seconds, minutes or hours."""
    for unit, name in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} s"


def timed(task: Callable[[], T]) -> tuple[float, T]:
    """Seconds of a task with all that it has launched, and what it returns."""
    import warp as wp

    started = time.perf_counter()
    found = task()
    wp.synchronize()
    return time.perf_counter() - started, found
