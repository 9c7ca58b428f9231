"""Device and threads: the only place that knows that a CPU launch of Warp is serial."""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

from warpsar.errors import DeviceError

if TYPE_CHECKING:
    import warp as wp

T = TypeVar("T")
_worker = threading.local()


def resolve_device(name: str | None = None) -> wp.Device:
    """The Warp device called `name` ("cpu", "cuda", "cuda:1"); None takes CUDA if there is one, else the CPU. "cuda" is
    the first, or that of this process's LOCAL_RANK where torchrun started several.

    Raises DeviceError (exit 3) for a device that is not there.
    """
    import warp as wp

    wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
    wp.init()
    if name is None:
        name = "cuda" if wp.get_cuda_device_count() else "cpu"
    known = ["cpu"] + [d.alias for d in wp.get_cuda_devices()]
    # one process a GPU; under SLURM each may see its own alone, as cuda:0
    own = _of_torchrun("LOCAL_RANK", 0) % max(len(known) - 1, 1)
    wanted = f"cuda:{own}" if name == "cuda" else name
    if wanted not in known:
        raise DeviceError(f"--device {name}: there is no such device here; there is {', '.join(known)}")
    if wanted == "cpu":
        _keep_memory()
    return wp.get_device(wanted)


@cache
def _keep_memory() -> None:
    """Have glibc keep up to 1 GiB of what is freed. It would hand large arrays back to the kernel at once, and to be
    given the same pages again, zeroed one by one, takes as long as half of an image."""
    try:
        adjust = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return
    for parameter in (-1, -3):  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD
        adjust(parameter, 2**30)


def _of_torchrun(name: str, alone: int) -> int:
    """A number of torchrun's environment; `alone` where there is one process, or none of it."""
    if os.environ.get("WORLD_SIZE", "1") == "1":
        return alone
    value = os.environ.get(name, "")
    return int(value) if value.isdigit() else alone


def say(message: str) -> None:
    """A message for people: stderr, so that stdout carries results only. Of several processes, the first one speaks."""
    if _of_torchrun("RANK", 0) == 0:
        print(message, file=sys.stderr)


def say_device(device: Any) -> None:
    """One line on stderr: where the work is done."""
    where = f"{thread_count()} threads" if device.is_cpu else device.name
    say(f"device: {device.alias} ({where})")


def thread_count() -> int:
    """Threads for CPU work: WARPSAR_THREADS, else the cores this process may use, shared with those that torchrun
    started beside it. Results do not depend on it."""
    asked = os.environ.get("WARPSAR_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, cores // processes_here())


def processes_here() -> int:
    """Processes of this run on this host."""
    return max(1, _of_torchrun("LOCAL_WORLD_SIZE", 1))


def load_kernels(device: Any, *names: str) -> None:
    """Compile the named modules of `warpsar.kernels`, or load what Warp's cache has of them, side by side.

    Left to their first launches they would come one after the other. A module's `BLOCK` is the block size of its
    launches, where that is not Warp's own: on CUDA each size is compiled for itself.
    """
    import warp as wp

    modules = [import_module(f"warpsar.kernels.{name}") for name in names]
    load = [partial(wp.load_module, m, device=device, block_dim=getattr(m, "BLOCK", None)) for m in modules]
    for _ in in_threads(load):
        pass


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
    if not hasattr(_worker, "cores"):
        given = list(tasks)
        if len(given) > 1:
            threads = thread_count()
            yield from _pool(threads).map(partial(_work, max(1, threads // len(given))), given)
            return
        tasks = given
    # one task keeps all cores for itself; a task of a task stays in its thread, or all could wait for one another
    yield from (task() for task in tasks)


def _work(cores: int, task: Callable[[], T]) -> T:
    _worker.cores = cores
    return task()


def side_by_side(tasks: Sequence[Callable[[], object]]) -> None:
    """Run independent pieces of one task on the cores that the task may use: this thread, and others that are free.

    Whoever is free takes the next piece, and this thread waits for none that has not begun: it cannot hang.
    """
    helpers = min(getattr(_worker, "cores", None) or thread_count(), len(tasks)) - 1
    if helpers < 1:
        for task in tasks:
            task()
        return
    left = deque(tasks)

    def work() -> None:
        while True:
            try:
                task = left.popleft()
            except IndexError:
                return
            task()

    started = [_pool(thread_count()).submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        left.clear()
        for other in started:
            if not other.cancel():
                other.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    """Kept: a fit hands out small tasks thousands of times, and starting threads costs as much as they do."""
    return ThreadPoolExecutor(threads)


def progress(total: int, what: str, unit: str = "it") -> Any:
    """A tqdm bar on stderr, silent where stderr is no terminal and for work that ends within a second."""
    from tqdm import tqdm

    hidden = True if _of_torchrun("RANK", 0) else None
    return tqdm(total=total, desc=what, unit=unit, file=sys.stderr, disable=hidden, delay=1.0, leave=False)
