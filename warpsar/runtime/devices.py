"""The Warp device of a name, and the kernels loaded for it."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from importlib import import_module
from itertools import count
from typing import TYPE_CHECKING

from warpsar.errors import DeviceError
from warpsar.runtime.busy import busy
from warpsar.runtime.distributed.torchrun import number_here
from warpsar.runtime.threads import in_threads

if TYPE_CHECKING:
    import warp as wp

_KEPT_SHARE = 0.25
"""Of a CUDA device's memory: what a process keeps between views instead of handing it back."""


def resolve_device(name: str | None = None) -> wp.Device:
    """The Warp device called `name`: "cpu", "cuda" or "cuda:1". None takes CUDA if there is one, else the CPU.

    "cuda" is the first CUDA device; where torchrun started several processes, it is that of the process's LOCAL_RANK.
    Raises DeviceError (exit status 3) for a device that is not there.
    """
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    with no_driver_warning():
        wp.init()
    if name is None:
        name = "cuda" if wp.get_cuda_device_count() else "cpu"
    known = ["cpu"] + [d.alias for d in wp.get_cuda_devices()]
    # one process for each GPU; under SLURM a process may see only its own, as cuda:0
    own = number_here() % max(len(known) - 1, 1)
    wanted = f"cuda:{own}" if name == "cuda" else name
    if wanted not in known:
        raise DeviceError(f"--device {name}: there is no such device here; there is {', '.join(known)}")
    found = wp.get_device(wanted)
    if found.is_cpu:
        _keep_memory()
    elif wp.is_mempool_enabled(found):
        wp.set_mempool_release_threshold(found, _KEPT_SHARE)
    return found


@cache
def _keep_memory() -> None:
    """Let glibc keep up to 1 GiB of freed memory.

    It would hand large arrays back to the kernel at once. To get the same pages again, zeroed one by one, takes half as
    long as an image.
    """
    try:
        adjust = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    for parameter in (-1, -3):  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD
        adjust(parameter, 2**30)


def load_kernels(device: wp.Device, *names: str, alone: Iterable[wp.Kernel] = ()) -> None:
    """Compile the named modules of `warpsar.kernels` side by side, or load them from Warp's cache; and kernels `alone`
    in modules of their own.

    At their first launches they would be compiled one after the other. A module's `BLOCK` is the block size of its
    launches, where that is not Warp's default: on CUDA each size is compiled by itself. A terminal sees how many are
    ready; from the cache they load before it would.
    """
    import warp as wp

    modules = [import_module(f"warpsar.kernels.{name}") for name in names]
    load = [partial(wp.load_module, m, device=device, block_dim=getattr(m, "BLOCK", None)) for m in modules]
    load += [partial(wp.load_module, kernel.module, device=device) for kernel in alone]
    what, ready = f"compiling kernels for {device.alias} (first run only)", count(1)

    with busy(what) as say:

        def counted(task: Callable[[], object]) -> None:
            task()
            say(f"{what}: {next(ready)} of {len(load)}")

        for _ in in_threads([partial(counted, task) for task in load]):
            pass


_WARNING = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver"


@contextmanager
def no_driver_warning() -> Iterator[None]:
    """Around `wp.init`. Warp's native library writes the line to stderr itself, and no setting of Warp leaves it out
    (native/cuda_util.cpp of 1.19): what it writes is held back here, and all but that line is then passed on."""
    try:
        sys.stderr.flush()
        kept = os.dup(2)
    except (AttributeError, OSError):  # no stderr
        yield
        return
    with tempfile.TemporaryFile() as held:
        os.dup2(held.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
            held.seek(0)
            for line in held:
                if not line.startswith(_WARNING):
                    os.write(2, line)
