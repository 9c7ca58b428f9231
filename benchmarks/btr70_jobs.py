"""Independent pieces of work side by side, each kept as a JSON when it is done (btr70.py)."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from measured_loop import kept


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


def done(jobs: Sequence[Job], processes: int) -> list[dict[str, Any]]:
    """What every job found, in their order. Processes share the cores, and have one thread each for linear algebra."""
    missing = [job for job in jobs if not job.path.exists()]
    side_by_side = min(processes, len(missing))
    if side_by_side > 1:
        threads = max(1, (os.cpu_count() or 1) // side_by_side)
        ours = {"WARPSAR_THREADS": str(threads), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        before = dict(os.environ)
        os.environ.update(ours)
        spawn = multiprocessing.get_context("spawn")  # warp does not survive a fork
        with ProcessPoolExecutor(side_by_side, spawn) as pool:
            for one in as_completed([pool.submit(_alone, job) for job in missing]):
                one.result()
        os.environ.clear()
        os.environ.update(before)
    return [job() for job in jobs]
