"""Which candidates get a full fit: those that look likeliest after a few iterations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from warpsar.diagnosis.dark.evidence import Dark
from warpsar.diagnosis.found import Candidate
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.scores.templates import Template, with_effect
from warpsar.diagnosis.turn.screening import Glance, Screening
from warpsar.effects.base.trial import Trial
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene

GLANCED = 8  # candidates that get a few iterations
FAR_BELOW = 0.05  # of the best one's score (-ln p): a candidate below it waits
OFFERED = 40  # of an effect's best trials that its refit may try


@dataclass(frozen=True)
class Refit:
    """A candidate's fit, and the tables that it began from and that may refine it."""

    candidate: Candidate
    fitted: Fitted
    tables: Sequence[Mapping[str, Any]]


def by_rank(passing: Sequence[Candidate]) -> list[list[Candidate]]:
    """The candidates that are fitted first, and those whose score is so far below the best one's that they are fitted
    only where none of the first is added."""
    least = FAR_BELOW * max((candidate.minus_log_p for candidate in passing), default=0.0)
    ahead: list[Candidate] = []
    behind: list[Candidate] = []
    for candidate in passing:
        (ahead if candidate.minus_log_p >= least else behind).append(candidate)
    return [ahead, behind] if behind else [ahead]


def refits(
    setup: FitSetup,
    base: Fitted,
    declared: Scene,
    passing: Sequence[Candidate],
    templates: Mapping[str, Sequence[Template]],
    dark: Dark,
    most: int,
) -> list[Refit]:
    """Fits of the `most` candidates that look likeliest at a glance.

    Each may be given up where it falls far behind the best other one; the next turn tries it again. Where dark pixels
    decide, effects that can explain them are fitted alone, without refinements, and all pixels say which is far behind.
    """
    if dark.asks:
        passing = [candidate for candidate in passing if dark.answered_by(candidate.effect)]

    def glance(effect: str) -> Screening:
        trials = [template.trial for template in templates[effect]][:OFFERED]
        tables = [table for trial in trials for table in surveyed(setup, base.scene, effect, trial)]
        return Screening(setup, base, declared, effect, _distinct(dark, base.scene, effect, tables))

    def again(glanced: tuple[str, Sequence[Mapping[str, Any]], Glance]) -> Screening:
        return Screening(setup, base, declared, *glanced)

    screenings = setup.share(
        [partial(glance, candidate.effect) for candidate in passing[:GLANCED]],
        leave=lambda one: (one.name, one.tables, one.glanced),
        arrive=again,
    )
    order = sorted(zip(passing, screenings, strict=False), key=lambda pair: -pair[1].glanced.log_likelihood)

    def gain_over(one: Screening) -> float:
        others = [other.glanced for other in screenings if other is not one]
        if dark.asks:  # all pixels decide then
            dark_pixels = one.glanced.whole - one.glanced.log_likelihood
            return max((other.whole for other in others), default=-np.inf) - dark_pixels
        return max((other.log_likelihood for other in others), default=-np.inf)

    finished = setup.share(
        [partial(screening.finish, gain_over(screening), dark, refine=not dark.asks) for _, screening in order[:most]],
        leave=lambda result: (result[0].content(), result[1]),
        arrive=lambda result: (Fitted.of(setup, base.scene, result[0]), result[1]),
    )
    found = []
    for (candidate, screening), (fitted, given_up) in zip(order, finished, strict=False):
        if given_up:
            candidate.remark("its fit was given up, far behind")
        found.append(Refit(candidate, fitted, screening.tables))
    return found


def _distinct(dark: Dark, scene: Scene, effect: str, tables: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The tables as the dark pixels complete them, each once; the first as it is where they leave none."""
    found: list[Mapping[str, Any]] = []
    for table in tables:
        completed = dark.completed(scene, effect, table)
        if completed and completed not in found:
            found.append(completed)
    return found or list(tables[:1])


# ---- where a fit begins whose loss has valleys that no derivative leads out of


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
