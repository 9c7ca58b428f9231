"""What a run does once, however many processes it has: files, decisions, and tasks that its processes share.

Who uses this need not know whether there are several. All processes go the same way through the program, and call the
same functions in the same order. Within a task that is one process's own (`write`, `find`, `share`, `alone`) there is
that process and no other. What is made once for a lifetime, as the views of a fit, keeps the `Sharing` that `join`
gives, or `ALONE` where each process does all of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from warpsar.errors import WarpsarError
from warpsar.runtime.distributed.processes import ALONE, Sharing, alone, here, join, restarts

__all__ = [
    "ALONE",
    "Sharing",
    "agree",
    "alone",
    "counter",
    "decide",
    "find",
    "gather",
    "join",
    "mine",
    "number",
    "processes",
    "refusal",
    "restarts",
    "share",
    "wait",
    "write",
]

T = TypeVar("T")


def processes() -> int:
    """How many processes the run has."""
    return here().size


def write(task: Callable[[], T]) -> T | None:
    """Run a task that writes files on the first process; None on the others, which do not wait."""
    return alone(task) if here().first else None


def find(task: Callable[[], T]) -> T:
    """What a task gives on the first process, for all of them: a value as in `distributed/travel.py`. A refusal is
    raised on all."""
    ranks = here()
    return ranks.hand_out(ranks.agree(lambda: write(task)))  # type: ignore[return-value]


def decide(numbers: ArrayLike) -> np.ndarray:
    """The first process's numbers, float64, any shape, for all: last bits differ from one device to another, and all
    must go the same way."""
    return here().same(numbers)


def agree(task: Callable[[], T]) -> T:
    """Run a task on every process; a refusal on one of them is raised on all, and said once."""
    return here().agree(task)


def share(tasks: Sequence[Callable[[], T]], **how: Any) -> list[T]:
    """Results of independent tasks, in their order, for all: each process runs some. `how` as `Sharing.deal_out`."""
    return here().deal_out(tasks, **how)


def mine(costs: Sequence[float]) -> list[int]:
    """Which of the tasks of these costs are this process's, ascending: each task is one process's."""
    return here().mine(costs)


def gather(value: T) -> list[T]:
    """The values of all processes, in one order for all; this one's own stays as it is."""
    return here().gather(value)


def counter() -> Callable[[int], int]:
    """A counter of all processes together, from 0: it adds its argument and returns the count before."""
    return here().counter()


def number() -> int:
    """Which of the processes this is, from 0: it tells the files apart that each of them writes."""
    return here().rank


def wait() -> None:
    """Wait until every process is here."""
    here().barrier()


def refusal(error: WarpsarError) -> WarpsarError:
    """An error that every process raises: one of them says it."""
    error.quiet = not here().first
    return error
