"""Which other effect would have done as well: names that the data cannot decide between."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from warpsar.diagnosis.found import Candidate, EffectRival, Turn
from warpsar.diagnosis.geometry.registry import is_geometry
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted, refit_as, refit_without
from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get
from warpsar.runtime import once

ASKED = 3  # rivals of one effect, the best by score
NEAR = 0.5  # of an effect's score (-ln p), from which on another one is a rival
MOST_TABLES = 4  # of a rival that had no fit in the turn


def rivals_of(
    setup: FitSetup,
    fitted: Fitted,
    names: Sequence[str],
    turns: Sequence[Turn],
    needed: Callable[[Fitted, str], bool],
) -> list[EffectRival]:
    """Every effect of `names` in the model `fitted` against the effects that scored nearly as well in its turn, each
    fitted in its place. What dark pixels need (`needed`, as in `confirm`) has no rival but what they need as well."""
    tasks = []
    for name in names:
        turn = next(turn for turn in reversed(turns) if turn.added == name)
        mine = next(c for c in turn.candidates if c.effect == name)
        without = refit_without(setup, fitted, name)
        asked = needed(without, name)
        for other in _near(mine, turn, fitted):
            if asked and not needed(without, other.effect):
                continue
            tasks.append(partial(_against, setup, fitted, name, other))
    return [found for found in (task() for task in tasks) if found is not None]


def _near(mine: Candidate, turn: Turn, fitted: Fitted) -> list[Candidate]:
    able = [c for c in turn.candidates if c.testability == "testable" and c.effect not in fitted.scene.effects]
    # what can do all that the effect does, with more numbers, fits as well in any case and is no rival
    able = [c for c in able if not is_geometry(c.effect) and mine.effect not in get(c.effect).contains]
    near = [c for c in able if c.minus_log_p > NEAR * mine.minus_log_p or c.effect in mine.resembles]
    return sorted(near, key=lambda c: -c.minus_log_p)[:ASKED]


def _against(setup: FitSetup, fitted: Fitted, name: str, other: Candidate) -> EffectRival | None:
    """None where the other effect has no start here."""
    without = replace(fitted.scene, effects={n: table for n, table in fitted.scene.effects.items() if n != name})
    modelled = fitted.problem.modelled(fitted.x)
    if other.table is None:
        level = float(np.median(np.concatenate(modelled)))
        trials = get(other.effect).trials(Context(without, level))
        tables = [trial.starts[0] for trial in trials[:MOST_TABLES]]
    else:
        tables = [other.table]
    if not tables:
        return None
    fits = [refit_as(setup, with_effect(without, other.effect, table)) for table in tables]
    theirs = max(fits, key=lambda one: one.log_likelihood)
    evidence = Evidence.of(fitted.problem, fitted.x)
    gain = 2.0 * (fitted.log_likelihood - theirs.log_likelihood)
    expected = fitted.size - theirs.size  # that further parameters gain by chance
    ours, others = (_interior(setup, one) for one in (fitted, theirs))
    apart = (looks * np.sum(np.log(a / b) ** 2) for (a, looks), (b, _) in zip(ours, others, strict=True))
    distance = float(once.decide(float(sum(apart))))
    error = 2.0 * float(np.sqrt(max(distance * evidence.area, 1e-12)))
    margin = gain - expected * evidence.price()
    return EffectRival(
        name, other.effect, theirs.scene, gain, distance, (gain - expected + distance) / error, margin, error
    )


def _interior(setup: FitSetup, fitted: Fitted) -> list[tuple[np.ndarray, float]]:
    """beta0 of every lit interior pixel of each observation, with its gain, and the looks."""
    problem = setup.problem(fitted.scene, dark=False)
    modelled = problem.modelled_as_declared()
    pairs = zip(problem.observations, modelled, problem.gains(modelled), strict=True)
    return [(gain * mu, seen.looks) for seen, mu, gain in pairs]
