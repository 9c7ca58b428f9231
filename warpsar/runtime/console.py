"""Words for people: messages, and progress."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from tqdm import tqdm

from warpsar.runtime.threads import thread_count
from warpsar.runtime.torchrun import of_torchrun as of_torchrun

if TYPE_CHECKING:
    pass


def say(message: str) -> None:
    """A message for people: stderr, so that stdout carries results only. Of several processes, the first one speaks."""
    if of_torchrun("RANK", 0) == 0:
        print(message, file=sys.stderr)


def say_device(device: Any) -> None:
    """One line on stderr: where the work is done."""
    where = f"{thread_count()} threads" if device.is_cpu else device.name
    say(f"device: {device.alias} ({where})")


def progress(total: int, what: str, unit: str = "it") -> Any:
    """A tqdm bar on stderr, silent where stderr is no terminal and for work that ends within a second."""
    hidden = True if of_torchrun("RANK", 0) else None
    return tqdm(total=total, desc=what, unit=unit, file=sys.stderr, disable=hidden, delay=1.0, leave=False)
