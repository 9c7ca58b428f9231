"""Independent tasks side by side on one CUDA device."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import warp as wp

MOST = 16  # streams on one device


class Streams:
    """CUDA streams that are made when first needed and kept.

    One small view does not fill the device, and its arithmetic idles while memory is cleared. `views`: how many there
    are, for two streams each.
    """

    def __init__(self, device: wp.Device, views: int) -> None:
        self._device, self._count = device, min(2 * views, MOST)
        self._streams: list[wp.Stream] = []

    def run(self, tasks: Sequence[Callable[[], None]]) -> None:
        """Queue the tasks; work that is queued after this waits for all of them."""
        if not self._streams:
            self._streams = [wp.Stream(self._device) for _ in range(self._count)]
        for task, stream in zip(tasks, itertools.cycle(self._streams), strict=False):
            with wp.ScopedStream(stream):  # which waits for what came before
                task()
        for stream in self._streams[: len(tasks)]:
            wp.wait_stream(stream)
