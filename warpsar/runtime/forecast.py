"""What is said before long work: how long it will take."""

from __future__ import annotations

LONG_S = 2.0
"""Work that is shorter is not announced [s]."""


def duration(seconds: float) -> str:
    """In words: seconds, minutes or hours."""
    for unit, name in ((3600.0, "h"), (60.0, "min")):
        if seconds >= 2.0 * unit:
            return f"{seconds / unit:.0f} {name}"
    return f"{seconds:.0f} s"
