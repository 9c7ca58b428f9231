"""How much memory hits take, how much they may, and what is done where a device has no more."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from warpsar.errors import WarpsarError
from warpsar.runtime import console, torchrun

T = TypeVar("T")

SHARE = 0.6  # of a device's memory that kept hits may take: the mesh, its BVH and tracing need the rest
PARTS = (1, 4, 16, 64, 256)  # into how many parts work is cut, one number after the other, where memory runs out
_HIT = 44 + 32  # bytes: trace.Hits; the learned coordinates and their gradients
_SIGMA = 8  # bytes: sigma0 and its gradient, for each polarization and each effect that acts on it
_SLOPES = 16  # bytes: sigma0's slopes to the coordinates, for each polarization


class OutOfMemoryError(WarpsarError):
    """No memory left, even for the smallest part of the work."""


def kept_bytes(hits: int, polarizations: int, effects: int) -> int:
    """Device memory of one view whose hits are kept for a fit."""
    return hits * (_HIT + polarizations * (_SIGMA * (1 + effects) + _SLOPES))


def default_gib(device: Any) -> float:
    """The bound on kept hits where the user gives none: `SHARE` of the device's memory, or of this process's part of
    the host's."""
    if device.is_cuda:
        total = device.total_memory
    else:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 2**33
        total /= torchrun.processes_here()
    return float(SHARE * total / 2**30)


def ran_out(error: BaseException) -> bool:
    """Whether an exception says that a device or the host had no memory left."""
    return isinstance(error, MemoryError | OutOfMemoryError) or "Failed to allocate" in str(error)


def in_parts(task: Callable[[int], T], what: str, parts: Sequence[int] = PARTS) -> T:
    """`task(1)`; where memory runs out, `task(4)` and so on: the number of parts that it is to do its work in.

    Raises OutOfMemoryError where the smallest parts are too large.
    """
    for count in parts:
        if count > parts[0]:
            console.say(f"{what}: out of memory; again in {count} parts")
        try:
            return task(count)
        except (MemoryError, RuntimeError, OutOfMemoryError) as error:
            if not ran_out(error):
                raise
            reason = str(error)
    raise OutOfMemoryError(
        f"{what}: out of memory even in {parts[-1]} parts ({reason}); a smaller mesh or image, fewer rays, or a device "
        f"with more memory would do"
    )
