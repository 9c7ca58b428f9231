"""A sign of life for work that cannot say how far it is."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tqdm import tqdm

from warpsar.runtime import console
from warpsar.runtime.distributed.torchrun import is_first

TICK_S = 1.0


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """While the block runs, from its second second on: `what` and the time it has taken, on stderr where that is a
    terminal. The block gets a function that puts other words in the place of `what`."""
    bar = tqdm(
        desc=what,
        bar_format="{desc} [{elapsed}]",
        file=sys.stderr,
        disable=True if console.quiet() or not is_first() else None,
        delay=TICK_S,
        leave=False,
    )
    if bar.disable:
        yield lambda words: None
        return
    done = threading.Event()

    def tick() -> None:
        while not done.wait(TICK_S):
            bar.refresh()

    thread = threading.Thread(target=tick, daemon=True)
    thread.start()
    try:
        yield lambda words: bar.set_description_str(words, refresh=False)
    finally:
        done.set()
        thread.join()
        bar.close()
