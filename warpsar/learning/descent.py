"""A fit from its first iteration to its last: starts, history, checkpoints, and what ends it."""

from __future__ import annotations

import json
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial

import numpy as np

from warpsar.errors import WarpsarError
from warpsar.io.checkpoint import Checkpoint
from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.metrics import pooled_metrics
from warpsar.learning.optimise import FitState, begin, levenberg_marquardt
from warpsar.learning.options import LearnOptions
from warpsar.learning.problem import FitProblem
from warpsar.runtime import console, once

MOST_STEPS = 100  # of Levenberg-Marquardt from one start

History = list[dict[str, float]]
"""A row for each iteration: its number, the start's number, the loss, and metrics of train and test views."""


class FitRecord:
    """How far a run has come, and where it is `kept`; it goes on from an earlier part of it. `tag` names the run
    (`checkpoint.write`)."""

    def __init__(self, kept: Checkpoint, tag: str) -> None:
        self._kept, self._tag = kept, tag
        found = kept.stored(tag)
        stored = None if found is None else dict(found)
        self.history: History = [] if stored is None else json.loads(str(stored.pop("history")))
        spent = 0.0 if stored is None else float(stored.pop("spent_s"))
        self.state = None if stored is None else FitState.from_arrays(stored)
        self._started = time.perf_counter() - spent

    @property
    def seconds(self) -> float:
        """Time spent on all parts of the run."""
        return time.perf_counter() - self._started

    def save(self) -> None:
        """Write the checkpoint."""
        if self.state is not None:
            self._kept.write(partial(self._arrays, self.state), self._tag)

    def _arrays(self, state: FitState) -> dict[str, np.ndarray]:
        extra = {"history": np.array(json.dumps(self.history)), "spent_s": np.array(self.seconds)}
        return {**state.arrays(), **extra}


def descend(
    problem: FitProblem, tests: FitProblem | None, options: LearnOptions, record: FitRecord, *, stoppable: bool
) -> tuple[FitState, str]:
    """Run to the end, with checkpoints; returns the last state, and why the run stopped.

    `stoppable`: a SIGTERM ends the run after a last checkpoint, by a WarpsarError, and so does a Ctrl-C, by a
    KeyboardInterrupt. A second Ctrl-C ends it at once.
    """
    history = record.history
    steps = states(problem, options, record.state)
    bar = console.progress(options.iterations, "learn")
    bar.update(record.state.iteration if record.state else 0)
    stopped = "plateau"
    with _caught(stoppable) as signals, closing(bar):
        while record.state is None or record.state.iteration < options.iterations:
            state = next(steps, None)
            if state is None:
                break
            record.state = state
            history.append(_row(problem, tests, state))
            bar.update(state.iteration - bar.n)
            bar.set_postfix_str(f"loss {state.loss:.6g}", refresh=False)
            asked = problem.largest(max(signals, default=0))
            late = problem.largest(record.seconds) > options.max_time_s
            if asked:
                record.save()
                if asked == signal.SIGINT:
                    raise KeyboardInterrupt
                raise once.refusal(
                    WarpsarError(f"stopped by a signal at iteration {state.iteration}; go on with --resume")
                )
            if late:
                stopped = "time"
                break
            if len(history) % options.checkpoint_every == 0:
                record.save()
        else:
            stopped = "iterations"
    assert record.state is not None
    record.save()
    return record.state, stopped


def stand(
    problem: FitProblem, tests: FitProblem | None, options: LearnOptions, record: FitRecord, *, stoppable: bool
) -> tuple[FitState, str]:
    """A run of no iteration, where nothing but poses is learned: `descend` without a change."""
    x = problem.x0
    loss = problem.value(problem.modelled(x))
    record.state = FitState(x, loss, x, loss)
    record.history.append(_row(problem, tests, record.state))
    return record.state, "nothing but poses is learned"


def states(problem: FitProblem, options: LearnOptions, state: FitState | None) -> Iterator[FitState]:
    """States of the whole run, one per iteration, from `state` on; ends when every start has arrived."""
    kind = options.optimiser
    if kind == "auto":
        kind = "lm" if problem.uniform else "adam"
    starts = options.starts if kind == "lm" else 1
    state = state or begin(problem, 0, options.seed)
    while True:
        if kind == "lm":
            while not state.arrived and state.since_start < MOST_STEPS:
                state = levenberg_marquardt(problem, state)
                yield state
        else:
            surfaces_alone = problem.x0.size == problem.learned.size
            graph = problem.shared_nodes is not None and surfaces_alone and problem.keeps_hits
            descent = (GraphAdam if graph and problem.scene.grid.calibrated else Adam)(problem, state, options.rate)
            while not state.arrived:
                state = descent.step(state)
                yield state
        if state.start + 1 >= starts:
            return
        state = begin(problem, state.start + 1, options.seed, state)


def _row(problem: FitProblem, tests: FitProblem | None, state: FitState) -> dict[str, float]:
    row = {"iteration": state.iteration, "start": state.start, "loss": state.loss}
    row |= {f"train_{k}": v for k, v in pooled_metrics(problem, state.x).items()}
    if tests is not None:
        followed = tests.follow(problem, state.x)
        row |= {f"test_{k}": v for k, v in pooled_metrics(tests, followed).items()}
    return row


@contextmanager
def _caught(wanted: bool) -> Iterator[list[int]]:
    """The SIGTERMs and the SIGINT (Ctrl-C) that arrive meanwhile, if `wanted`; they do not end the process.

    A second SIGINT does. A SIGINT that the process ignores, or handles in its own way, is left alone.
    """
    arrived: list[int] = []

    def note(number: int, frame: object) -> None:
        arrived.append(number)
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        numbers.append(signal.SIGINT)
    # signals belong to the main thread: in another one, whoever runs it keeps them
    wanted = wanted and threading.current_thread() is threading.main_thread()
    previous = {number: signal.signal(number, note) for number in numbers if wanted}
    try:
        yield arrived
    finally:
        for number, handler in previous.items():
            if handler is not None:
                signal.signal(number, handler)
