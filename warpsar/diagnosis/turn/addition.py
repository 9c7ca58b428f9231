"""Which refitted candidate a turn adds: the likeliest, or the one that the dark pixels need.

It is added on trial: whether it holds is asked at the end, beside everything else that was added (`confirmation.py`).
Asked here, an effect would have to help while others are still missing, and the order of additions would decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from warpsar.diagnosis.dark.evidence import Dark
from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import MOST_ITERATIONS, Fitted, fitted_at, onward, standing_at
from warpsar.diagnosis.turn.screening import refined
from warpsar.diagnosis.turn.shortlist import Refit
from warpsar.learning.optimise import FLAT
from warpsar.runtime import once

CONTENDERS = 3  # the likeliest candidates, whose fits are taken to their end before one is chosen
TOO_LITTLE = "it gains less than its parameters cost"
NEEDED = "no model without such an effect can hold that, so nothing else was asked"


LogLikelihood = Callable[[Fitted], float]


def of_lit_pixels(fitted: Fitted) -> float:
    """`Fitted.log_likelihood`, by which candidates are compared where no shadow speaks."""
    return fitted.log_likelihood


def add_the_best(
    setup: FitSetup,
    turn: Turn,
    here: Fitted,
    refits: Sequence[Refit],
    dark: Dark,
    price: float,
    of: LogLikelihood = of_lit_pixels,
) -> None:
    """Fill in `turn.added` and `turn.fitted`, or leave them None where no fit is worth its parameters.

    `here` is the turn's model on `setup`, without any candidate. A parameter costs `price` of 2 ln L. `of`: which
    pixels compare the candidates.
    """
    gained = _gains(here, of)
    for refit in refits:
        gained(refit.candidate, refit.fitted)
    if not dark.asks:
        ahead = sorted(refits, key=lambda refit: -_worth(refit, price))
        refits = [*_arrived(setup, ahead[:CONTENDERS], price, gained, limited=of is of_lit_pixels), *ahead[CONTENDERS:]]
    able = [refit for refit in refits if dark.asks or _worth(refit, price) > 0]
    for refit in refits:
        refit.candidate.refused = "" if refit in able else TOO_LITTLE
    if not able:
        return
    if dark.asks:
        best = max(able, key=lambda refit: refit.fitted.whole)
        best.candidate.remark(NEEDED)
        turn.fitted = once.alone(partial(refined, setup, best.fitted, best.candidate.effect, best.tables, dark))
        gained(best.candidate, turn.fitted)
    else:
        best = max(able, key=lambda refit: _worth(refit, price))
        turn.fitted = best.fitted
    turn.added = best.candidate.effect
    for refit in able:
        if refit is not best:
            refit.candidate.refused = f"the dark pixels need {turn.added}" if dark.asks else f"{turn.added} is likelier"


def _arrived(
    setup: FitSetup, ahead: Sequence[Refit], price: float, gained: Callable[[Candidate, Fitted], None], *, limited: bool
) -> list[Refit]:
    """The fits of those `ahead` to their ends: at the same number of iterations one is nearer to its own than another.

    The first one goes first. Where they are `limited`, another is given up if it cannot come up with it at its present
    pace: what a fit has reached on lit pixels says nothing of others.
    """
    found: list[Refit] = []
    for some in (ahead[:1], ahead[1:]):
        limits = [_level(found[0], refit, price) if found and limited else -np.inf for refit in some]
        problems = [setup.problem(refit.fitted.scene) for refit in some]
        tasks = [
            partial(onward, problem, standing_at(problem, problem.x0), MOST_ITERATIONS, limit, flat=FLAT)
            for problem, limit in zip(problems, limits, strict=True)
        ]
        states = setup.share(tasks)
        for refit, problem, state in zip(some, problems, states, strict=True):
            best = state.best_x, state.best_loss, state.iteration
            found.append(replace(refit, fitted=fitted_at(setup, problem, *best)))
            gained(refit.candidate, found[-1].fitted)
    return found


def _level(first: Refit, other: Refit, price: float) -> float:
    """Log-likelihood of all its pixels at which the `other` candidate is worth as much as the `first`."""
    lit = first.fitted.log_likelihood + 0.5 * price * (other.fitted.size - first.fitted.size)
    return lit + other.fitted.whole - other.fitted.log_likelihood  # dark pixels cost it what they cost it now


def _gains(here: Fitted, of: LogLikelihood) -> Callable[[Candidate, Fitted], None]:
    """What writes into a candidate how its fit compares with the turn's model."""
    before = of(here)

    def gained(candidate: Candidate, fitted: Fitted) -> None:
        candidate.refit_gain = 2.0 * (of(fitted) - before)
        candidate.refit_size = fitted.size - here.size
        candidate.table = fitted.scene.effects[candidate.effect]

    return gained


def _worth(refit: Refit, price: float) -> float:
    """Gain in 2 ln L beyond what the parameters cost."""
    candidate = refit.candidate
    assert candidate.refit_gain is not None
    assert candidate.refit_size is not None
    return candidate.refit_gain - candidate.refit_size * price
