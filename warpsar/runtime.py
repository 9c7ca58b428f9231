"""Device and threads: the only place that knows that a CPU launch of Warp is serial."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, TypeVar

from warpsar.errors import DeviceError

if TYPE_CHECKING:
    import warp as wp

T = TypeVar("T")


def resolve_device(name: str | None = None) -> wp.Device:
    """The Warp device called `name` ("cpu", "cuda", "cuda:1"); None takes CUDA if there is one, else the CPU.

    Raises DeviceError (exit 3) for a device that is not there.
    """
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    wp.init()
    if name is None:
        name = "cuda:0" if wp.get_cuda_device_count() else "cpu"
    known = ["cpu"] + [d.alias for d in wp.get_cuda_devices()]
    wanted = "cuda:0" if name == "cuda" else name
    if wanted not in known:
        raise DeviceError(f"--device {name}: there is no such device here; there is {', '.join(known)}")
    return wp.get_device(wanted)


def say(message: str) -> None:
    """A message for people: stderr, so that stdout carries results only."""
    print(message, file=sys.stderr)


def say_device(device: Any) -> None:
    """One line on stderr: where the work is done."""
    where = f"{thread_count()} threads" if device.is_cpu else device.name
    say(f"device: {device.alias} ({where})")


def thread_count() -> int:
    """Threads for CPU work: WARPSAR_THREADS, else the cores this process may use. Results do not depend on it."""
    asked = os.environ.get("WARPSAR_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def ordered(tasks: Iterable[Callable[[], T]], device: Any) -> Iterator[T]:
    """Results of independent `tasks`, in their order: on all cores for the CPU, one after the other for CUDA.

    Each task must own every array it writes: two CPU launches that add into one array lose sums.
    """
    if device.is_cpu and thread_count() > 1:
        yield from in_threads(tasks)
    else:
        yield from (task() for task in tasks)


def in_threads(tasks: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Results of independent NumPy tasks, in their order, on all cores whatever the device."""
    with ThreadPoolExecutor(thread_count()) as pool:
        yield from pool.map(lambda task: task(), tasks)


def progress(total: int, what: str, unit: str = "it") -> Any:
    """A tqdm bar on stderr, silent where stderr is no terminal and for work that ends within a second."""
    from tqdm import tqdm

    return tqdm(total=total, desc=what, unit=unit, file=sys.stderr, disable=None, delay=1.0, leave=False)
