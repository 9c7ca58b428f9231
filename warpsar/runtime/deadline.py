"""A time by which work shall end: long fits ask whether it has come."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager


class TimeUp(Exception):  # noqa: N818 - no error: whoever sets a time expects it
    """The time of a run is over. Whoever set it catches this, and goes on with what is there."""


class _Until:
    at: float | None = None


@contextmanager
def deadline(seconds: float | None) -> Iterator[None]:
    """Within it, `check` raises TimeUp once so many seconds have passed; None sets no time."""
    before, _Until.at = _Until.at, None if seconds is None else time.monotonic() + seconds
    try:
        yield
    finally:
        _Until.at = before


def check() -> None:
    """Raises TimeUp where the time is over."""
    if _Until.at is not None and time.monotonic() > _Until.at:
        raise TimeUp
