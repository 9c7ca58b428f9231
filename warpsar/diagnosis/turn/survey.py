"""Where a fit begins whose loss has valleys that no derivative leads out of, such as a shift of bright lines."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.effects.base.trial import Trial
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene

# Log-likelihood that one pixel may cost: a bright line in the wrong row costs thousands until it is in the right one,
# and decides where everything else would lie.
BOUND = 20.0
HALVINGS = 4  # of the first step


def surveyed(setup: FitSetup, scene: Scene, name: str, trial: Trial) -> list[Mapping[str, Any]]:
    """The trial's starts; where it names steps for a search (`Trial.survey`), moved to the lowest bounded loss that a
    compass search finds with all else held (Kolda, Lewis and Torczon, SIAM Review 45, 2003). An effect that another one
    of the scene contains has nothing to move."""
    if not trial.survey:
        return list(trial.starts)
    found: list[Mapping[str, Any]] = []
    for table in trial.starts:
        problem = setup.problem(with_effect(scene, name, table), dark=False)
        moved = [c.key if c.effect == name else "" for c in problem.effect_coordinates]
        if name not in {c.effect for c in problem.effect_coordinates}:
            return list(trial.starts)
        columns = [problem.learned.size + moved.index(key) for key in trial.survey]
        spans = [problem.effect_coordinates[c - problem.learned.size].declared.span for c in columns]
        x = _compass(problem, columns, np.array(list(trial.survey.values())) / spans)
        found.append(problem.effect_tables(x)[name])
    return found


def _compass(problem: FitProblem, columns: list[int], step: np.ndarray) -> np.ndarray:
    low, high = problem.bounds
    x, best = problem.x0, _bounded_loss(problem, problem.x0)
    ways = [np.array(way) for way in product((-1, 0, 1), repeat=len(columns)) if any(way)]
    halvings = 0
    while halvings <= HALVINGS:
        trials = []
        for way in ways:
            there = x.copy()
            there[columns] += way * step
            trials.append(np.clip(there, low, high))
        losses = [_bounded_loss(problem, there) for there in trials]
        lowest = int(np.argmin(losses))
        if losses[lowest] < best:
            x, best = trials[lowest], losses[lowest]
        else:
            step, halvings = step / 2, halvings + 1
    return x


def _bounded_loss(problem: FitProblem, x: np.ndarray) -> float:
    return float(sum(np.minimum(terms, BOUND).sum() for terms in problem.terms(problem.modelled(x))))
