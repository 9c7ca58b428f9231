"""How much memory hits take and may take, and smaller parts of work where memory runs out."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

from warpsar.errors import WarpsarError
from warpsar.runtime import console
from warpsar.runtime.distributed.torchrun import processes_here

if TYPE_CHECKING:
    import warp as wp

T = TypeVar("T")

SHARE = 0.6  # of a device's memory for the hits of a fit: the mesh, its BVH and tracing need the rest
PARTS = (1, 4, 16, 64, 256)  # numbers of parts that work is cut into, one after the other, while memory runs out
_HIT = 44 + 32  # bytes: trace.Hits; the learned coordinates and their gradients
_SIGMA = 8  # bytes: sigma0 and its gradient, for each polarization and each effect that changes it
_SLOPES = 16  # bytes: derivatives of sigma0 by the learned coordinates, for each polarization


class OutOfMemoryError(WarpsarError):
    """No memory left, even for the smallest part of the work."""


def kept_bytes(hits: int, polarizations: int, effects: int) -> int:
    """Device memory of one view whose hits are kept for a fit."""
    return hits * (_HIT + polarizations * (_SIGMA * (1 + effects) + _SLOPES))


def default_gib(device: wp.Device) -> float:
    """The default bound on the hits of a fit [GiB].

    It is `SHARE` of the device's memory, or of this process's part of the host's memory.
    """
    if device.is_cuda:
        total = float(device.total_memory)
    else:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 2**33
        total /= processes_here()
    return float(SHARE * total / 2**30)


def ran_out(error: BaseException) -> bool:
    """Whether an exception says that a device or the host had no memory left."""
    return isinstance(error, MemoryError | OutOfMemoryError) or "Failed to allocate" in str(error)


def in_parts(task: Callable[[int], T], what: str, parts: Sequence[int] = PARTS) -> T:
    """The result of `task(1)`; where memory runs out, of `task(4)` and so on. `task` gets the number of parts to use.

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
