"""Messages and progress for people, on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from tqdm import tqdm

from warpsar.runtime.distributed.torchrun import is_first
from warpsar.runtime.threads import thread_count

if TYPE_CHECKING:
    import warp as wp


DELAY_S = 1.0
"""Work that ends within it shows no bar [s]."""


class _Quiet:
    on = False  # set by the command line's --quiet, before any work


def be_quiet(on: bool) -> None:
    """Whether messages and progress are left out; warnings and errors are not."""
    _Quiet.on = on


def quiet() -> bool:
    return _Quiet.on


def say(message: str) -> None:
    """Print a message on stderr: stdout carries results only. Of several processes the first one speaks."""
    if not quiet():
        _print(message)


def warn(warnings: Iterable[str]) -> None:
    """Say each warning on a line of its own, on stderr."""
    for warning in warnings:
        _print(f"warning: {warning}")


def say_written(out: Path, *names: str) -> None:
    """Say what a command has written into its folder."""
    say(f"written to {out}: {', '.join(names)}")


def _print(message: str) -> None:
    if is_first():
        print(message, file=sys.stderr)


def say_device(device: wp.Device) -> None:
    """Say on stderr which device does the work."""
    where = f"{thread_count()} threads" if device.is_cpu else device.name
    say(f"device: {device.alias} ({where})")


def progress(total: int, what: str, unit: str = "it") -> tqdm[NoReturn]:
    """A tqdm bar on stderr. It is silent where stderr is no terminal, and for work that ends within a second."""
    hidden = True if quiet() or not is_first() else None
    return tqdm(total=total, desc=what, unit=unit, file=sys.stderr, disable=hidden, delay=DELAY_S, leave=False)


def share(what: str, total: float) -> tqdm[NoReturn]:
    """As `progress`, for work that is counted in fractions: the bar shows per cent."""
    bar = progress(1, what)
    bar.total, bar.bar_format = total, "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    return bar
