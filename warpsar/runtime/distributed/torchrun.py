"""What torchrun tells this process about the others, before any of them is spoken to."""

from __future__ import annotations

import os


def is_first() -> bool:
    """Whether this process speaks for all."""
    return _number("RANK", 0) == 0


def number_here() -> int:
    """Which of this host's processes of the run this is, from 0."""
    return _number("LOCAL_RANK", 0)


def processes_here() -> int:
    """Processes of this run on this host."""
    return max(1, _number("LOCAL_WORLD_SIZE", 1))


def _number(name: str, alone: int) -> int:
    """The number `name` of torchrun's environment; `alone` where there is one process, or no such number."""
    if os.environ.get("WORLD_SIZE", "1") == "1":
        return alone
    value = os.environ.get(name, "")
    return int(value) if value.isdigit() else alone
