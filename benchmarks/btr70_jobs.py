"""Independent pieces of work side by side, each kept as a JSON when it is done (btr70.py)."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from measured_loop import kept

from warpsar.runtime.threads import thread_count


@dataclass(frozen=True)
class Job:
    """A function of this folder's modules, its arguments, and where its JSON is kept."""

    path: Path
    make: Callable[..., dict[str, Any]]
    arguments: tuple[Any, ...] = ()
    keywords: dict[str, Any] = field(default_factory=dict)

    def __call__(self) -> dict[str, Any]:
        return kept(self.path, lambda: self.make(*self.arguments, **self.keywords))


def _alone(job: Job) -> dict[str, Any]:
    return job()


def _shared(threads: int) -> None:
    os.environ["WARPSAR_THREADS"] = str(threads)


@cache
def _workers(processes: int) -> ProcessPoolExecutor:
    """Processes that share the cores, and stay until the command ends: each loads its kernels once."""
    os.environ.update({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})  # read where NumPy is loaded: in theirs
    spawn = multiprocessing.get_context("spawn")  # warp does not survive a fork
    threads = max(1, thread_count() // processes)
    return ProcessPoolExecutor(processes, spawn, initializer=_shared, initargs=(threads,))


def done(jobs: Sequence[Job], processes: int) -> list[dict[str, Any]]:
    """What every job found, in their order. A job on its own gets all cores."""
    missing = [job for job in jobs if not job.path.exists()]
    if min(processes, len(missing)) > 1:
        for one in as_completed([_workers(processes).submit(_alone, job) for job in missing]):
            one.result()
    return [job() for job in jobs]
