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
    """What every job found, in their order. Processes have one thread each, where there are several of them."""
    missing = [job for job in jobs if not job.path.exists()]
    if processes > 1 and len(missing) > 1:
        before = os.environ.get("WARPSAR_THREADS")
        os.environ["WARPSAR_THREADS"] = os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
        spawn = multiprocessing.get_context("spawn")  # warp does not survive a fork
        with ProcessPoolExecutor(min(processes, len(missing)), spawn) as pool:
            for one in as_completed([pool.submit(_alone, job) for job in missing]):
                one.result()
        if before is None:
            del os.environ["WARPSAR_THREADS"]
        else:
            os.environ["WARPSAR_THREADS"] = before
    return [job() for job in jobs]
