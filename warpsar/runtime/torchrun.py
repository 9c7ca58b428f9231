"""What torchrun tells this process about the others."""

from __future__ import annotations

import os


def of_torchrun(name: str, alone: int) -> int:
    """The number `name` of torchrun's environment; `alone` where there is one process, or no such number."""
    if os.environ.get("WORLD_SIZE", "1") == "1":
        return alone
    value = os.environ.get(name, "")
    return int(value) if value.isdigit() else alone


def processes_here() -> int:
    """Processes of this run on this host."""
    return max(1, of_torchrun("LOCAL_WORLD_SIZE", 1))
