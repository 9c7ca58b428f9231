"""Which candidate is the likeliest: short fits of all of them, given up where they fall far behind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpsar.diagnosis.dark.evidence import Dark
from warpsar.diagnosis.models.change import as_declared
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import (
    GLANCE,
    QUICK_ITERATIONS,
    Fitted,
    descend,
    fitted_at,
    onward,
    standing_at,
)
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.registry import get
from warpsar.learning.optimise import FitState
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.scene.scene import Scene

STARTS = 4  # of the tables that an effect's best trials offer, how many are fitted
NEARER = (0.3, 0.1)  # shares of a first table's way from neutral, at which a fit begins again
HARDLY_BETTER = 2.0  # log-likelihood over no effect at all, at which a glance has seen nothing yet
CLIMB = 10.0  # times what an effect has gained, that refinements may bring
WORTH = 2.0  # log-likelihood that another setting has to gain; five times as much if it adds something
NO_DARK = Dark(0, 0)


@dataclass(frozen=True)
class Glance:
    """How far a few iterations from an effect's first table came, with which of the surfaces; see `Fitted`."""

    surface: int
    state: FitState
    log_likelihood: float
    whole: float


class Screening:
    """`base` and one effect more, everything refitted, from each of the effect's best `STARTS` tables.

    The surface starts as `base` has it, and as the scene file does: a strong effect that is missing can pull the fitted
    surface so far that no descent leads back. A fit that is worse than none begins again nearer to neutral. At first
    only a glance, which may be another process's.
    """

    def __init__(
        self,
        setup: FitSetup,
        base: Fitted,
        declared: Scene,
        name: str,
        tables: Sequence[Mapping[str, Any]],
        glanced: Glance | None = None,
    ) -> None:
        self.setup, self.base, self.name, self.tables = setup, base, name, tables
        surfaces = [base.scene, as_declared(declared, base.scene)]
        self._problem: FitProblem | None = None
        self.glanced = glanced or self._glance(surfaces)
        self._surface = surfaces[self.glanced.surface]  # the other tables need not try both

    def _glance(self, surfaces: Sequence[Scene]) -> Glance:
        best: Glance | None = None
        opened: dict[tuple[float, int], tuple[FitProblem, FitState]] = {}
        # a start where the effect does nothing is flat and ends at once; another begins far off and takes longer
        for share, until in ((1.0, GLANCE), (1.0, QUICK_ITERATIONS), *((share, GLANCE) for share in NEARER)):
            if best is not None and best.log_likelihood > self.base.log_likelihood + HARDLY_BETTER:
                break
            for number, surface in enumerate(surfaces):
                if (share, number) not in opened:
                    table = toward_neutral(self.name, self.tables[0], share)
                    problem = self.setup.problem(with_effect(surface, self.name, table))
                    opened[share, number] = problem, standing_at(problem, problem.x0)
                problem, state = opened[share, number]
                state = onward(problem, state, until)
                opened[share, number] = problem, state
                fitted = _fitted(self.setup, problem, state)
                if best is None or fitted.whole > best.whole:
                    self._problem, best = problem, Glance(number, state, fitted.log_likelihood, fitted.whole)
        assert best is not None
        return best

    def finish(self, best_so_far: float, dark: Dark = NO_DARK, *, refine: bool = True) -> tuple[Fitted, bool]:
        """The best of all tables, refined by them (`refined`), and whether its fit was given up; `best_so_far` is the
        log-likelihood of the best other candidate. Best by likelihood, less half a ln(pixels) for each parameter: three
        that shift the world are not taken for what two explain."""
        problem = self._problem or self.setup.problem(with_effect(self._surface, self.name, self.tables[0]))
        state = self.glanced.state
        # dark pixels, if any, cost the effect what they cost it now
        limit = self.glanced.whole - self.glanced.log_likelihood + best_so_far
        numbers = [{p.name: table.get(p.name) for p in get(self.name).parameters} for table in self.tables[:STARTS]]
        found: list[Fitted] = []
        given_up: list[bool] = []
        for table, values in zip(self.tables, numbers, strict=False):
            if found:
                if values == numbers[0] and given_up[0]:
                    continue  # it differs in settings alone
                problem = self.setup.problem(with_effect(self._surface, self.name, table))
                # not where the first arrived: what fits with one window leads another astray
                state = standing_at(problem, problem.x0)
            state = onward(problem, state, QUICK_ITERATIONS, limit)
            given_up.append(not state.arrived and state.since_start < QUICK_ITERATIONS)
            found.append(_fitted(self.setup, problem, state))
        price = 0.5 * np.log(sum(int(seen.interior.sum()) for seen in problem.observations))
        best = max(range(len(found)), key=lambda k: found[k].log_likelihood - price * found[k].size)
        before = self.base.log_likelihood
        if not refine or CLIMB * (found[best].log_likelihood - before) < best_so_far - before:
            return found[best], given_up[best]
        climbed = refined(self.setup, found[best], self.name, self.tables, dark)
        return climbed, given_up[best] and climbed.log_likelihood < best_so_far


def _fitted(setup: FitSetup, problem: FitProblem, state: FitState) -> Fitted:
    return fitted_at(setup, problem, state.best_x, state.best_loss, state.iteration)


def toward_neutral(name: str, table: Mapping[str, Any], share: float) -> dict[str, Any]:
    """The effect's table with a `share` of what each parameter with a neutral value is away from it."""

    def nearer(parameter: EffectParameter, value: float) -> float:
        neutral = parameter.neutral
        if np.isnan(neutral):
            return value
        return neutral + share * (value - neutral) if np.isfinite(neutral) else value / share

    found = dict(table)
    for parameter in get(name).parameters:
        value = table.get(parameter.name)
        if isinstance(value, Mapping):
            found[parameter.name] = {view: nearer(parameter, one) for view, one in value.items()}
        elif value is not None:
            found[parameter.name] = nearer(parameter, value)
    return found


def refined(
    setup: FitSetup, fitted: Fitted, name: str, others: Sequence[Mapping[str, Any]], dark: Dark = NO_DARK
) -> Fitted:
    """Uphill through the effect's refinements, its own parameters fitted at each, and everything at the end. `others`
    are tables of its best trials. None that dark pixels contradict is taken."""
    scene = fitted.scene
    climbing = True
    while climbing:
        climbing = False
        known: dict[tuple[str, ...], float] = {}  # log-likelihood of the scene as it is, by views
        for offered, chosen in get(name).refinements(scene, scene.effects[name], others):
            table = dark.completed(scene, name, offered)
            if not table or (table is not offered and _same_settings(name, table, scene.effects[name])):
                continue
            views = _views(scene, name, table)
            if views not in known:
                known[views] = _log_likelihood(setup, scene, views)
            problem = setup.problem(with_effect(scene, name, table), views)
            own = np.array([c.effect == name for c in problem.effect_coordinates], bool)
            moving = np.concatenate([np.zeros(problem.learned.size, bool), own])
            x, _, _ = descend(problem, [problem.x0], moving, quick=True)
            trial = learned_scene(problem, x)
            if _log_likelihood(setup, trial, views) > known[views] + WORTH * (1 + 4 * chosen):
                scene, climbing = trial, True
                break
    if scene is fitted.scene:
        return fitted
    problem = setup.problem(scene)
    return fitted_at(setup, problem, *descend(problem, [problem.x0], quick=True))


def _same_settings(name: str, one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    return all(one.get(setting.name) == other.get(setting.name) for setting in get(name).settings)


def _views(scene: Scene, name: str, table: Mapping[str, Any]) -> tuple[str, ...]:
    """Train views that look otherwise with another table of the effect."""
    effect, now = get(name), scene.effects[name]
    train = [view.name for view in scene.views if view.role == "train" and view.images]
    per_view = {p.name for p in effect.parameters if p.per_view} | {s.name for s in effect.settings if s.per_view}
    differing = [key for key in {*now, *table} if now.get(key) != table.get(key)]
    if not per_view.issuperset(differing):
        return tuple(train)
    return tuple(v for v in train if any(now.get(k, {}).get(v) != table.get(k, {}).get(v) for k in differing))


def _log_likelihood(setup: FitSetup, scene: Scene, views: Sequence[str]) -> float:
    problem = setup.problem(scene, views, dark=False)
    return -problem.value(problem.modelled_as_declared())
