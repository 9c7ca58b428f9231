"""Threads for CPU work: tasks on all cores, in order, and pieces of one task side by side."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from warpsar.runtime.distributed.torchrun import processes_here

if TYPE_CHECKING:
    import warp as wp

T = TypeVar("T")
_worker = threading.local()


def thread_count() -> int:
    """Threads for CPU work: WARPSAR_THREADS, else the cores this process may use, shared with those that torchrun
    started beside it. Results do not depend on it."""
    asked = os.environ.get("WARPSAR_THREADS", "")
    if asked.isdigit() and int(asked) > 0:
        return int(asked)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, cores // processes_here())


def ordered(tasks: Iterable[Callable[[], T]], device: wp.Device) -> Iterator[T]:
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
            cores = max(1, threads // len(given))
            submitted = [_pool(threads).submit(_work, cores, task) for task in given]
            try:
                yield from (one.result() for one in submitted)
            finally:  # after a failure, too: a task left running may wait for a lock of whoever waits for its thread
                wait([one for one in submitted if not one.cancel()])
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
