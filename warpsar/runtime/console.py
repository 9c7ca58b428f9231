"""Messages and progress for people.

Messages go to the logger "warpsar": who calls the library decides whether they are seen. The command line shows them on
stderr. Progress bars appear on a terminal alone.
"""

from __future__ import annotations

import logging
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


LOGGER = logging.getLogger("warpsar")
"""Messages have the level INFO, warnings WARNING. Python shows a warning on stderr where nobody sets up logging."""


class _Stderr(logging.Handler):
    """Prints to what `sys.stderr` is when a message comes, not to what it was at the start."""

    def emit(self, record: logging.LogRecord) -> None:
        prefix = "warning: " if record.levelno >= logging.WARNING else ""
        print(f"{prefix}{record.getMessage()}", file=sys.stderr)


_STDERR = _Stderr()


def show_messages() -> None:
    """Show messages and warnings on stderr, as the command line does. A second call changes nothing."""
    LOGGER.addHandler(_STDERR)
    LOGGER.setLevel(logging.INFO)
    LOGGER.propagate = False  # a root logger's handlers would print each a second time


class _Quiet:
    on = False  # set by the command line's --quiet, before any work


def be_quiet(on: bool) -> None:
    """Whether messages and progress are left out; warnings and errors are not."""
    _Quiet.on = on


def quiet() -> bool:
    return _Quiet.on


def say(message: str) -> None:
    """Log a message: stdout carries results only. Of several processes the first one speaks."""
    if not quiet() and is_first():
        LOGGER.info("%s", message)


def warn(warnings: Iterable[str]) -> None:
    """Log each warning by itself. Of several processes the first one speaks."""
    for warning in warnings:
        if is_first():
            LOGGER.warning("%s", warning)


def say_written(out: Path, *names: str) -> None:
    """Say what a command has written into its folder."""
    say(f"written to {out}: {', '.join(names)}")


def say_device(device: wp.Device) -> None:
    """Say which device does the work."""
    where = f"{thread_count()} threads" if device.is_cpu else device.name
    say(f"device: {device.alias} ({where})")


def progress(total: int | None, what: str, unit: str = "it") -> tqdm[NoReturn]:
    """A tqdm bar on stderr, which counts where there is no total.

    It is silent where stderr is no terminal, and for work that ends within a second.
    """
    hidden = True if quiet() or not is_first() else None
    return tqdm(total=total, desc=what, unit=unit, file=sys.stderr, disable=hidden, delay=DELAY_S, leave=False)


def share(what: str, total: float) -> tqdm[NoReturn]:
    """As `progress`, for work that is counted in fractions: the bar shows per cent."""
    bar = progress(1, what)
    bar.total, bar.bar_format = total, "{desc}: {percentage:3.0f}%|{bar}| {elapsed}<{remaining}"
    return bar
