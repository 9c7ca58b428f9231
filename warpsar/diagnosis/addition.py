"""Which refitted candidate is added: the likeliest that holds on views left out, or that the dark pixels need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from warpsar.diagnosis.bench import Bench
from warpsar.diagnosis.carried import carried_over
from warpsar.diagnosis.dark import Dark
from warpsar.diagnosis.found import Candidate, DiagnoseOptions, Turn
from warpsar.diagnosis.left_out import leave_one_view_out, varies_over_columns
from warpsar.diagnosis.refit import Fitted, settle
from warpsar.diagnosis.signature import signature
from warpsar.effects.base.signature import Signature
from warpsar.effects.registry import get


def add_the_best(
    bench: Bench,
    turn: Turn,
    refits: Sequence[tuple[Candidate, Fitted]],
    dark: Dark,
    looks: float,
    options: DiagnoseOptions,
) -> None:
    """Fill in `turn.added` and `turn.fitted`, or leave them None where no refit is worth its parameters and holds.

    A parameter costs ln(`looks`) of 2 ln L, `looks` being the independent looks in the data.
    """
    base = turn.base
    gains = []
    for candidate, fitted in refits:
        candidate.refit_gain = _gain(base, fitted)
        candidate.refit_size = fitted.size - base.size
        gains.append(candidate.refit_gain - candidate.refit_size * np.log(looks))
    if dark.asks and _added_for_the_dark(bench, turn, refits, dark, options):
        return
    for gain, (candidate, fitted) in sorted(zip(gains, refits, strict=True), key=lambda item: -item[0]):
        if turn.added is not None:
            candidate.refused = f"{turn.added} is likelier"
            continue
        if gain <= 0:
            candidate.refused = "it gains less than its parameters cost"
            continue
        fitted = settle(bench, fitted, options.starts, options.seed)
        candidate.refit_gain = _gain(base, fitted)
        if _holds(bench, base, candidate, fitted):
            turn.added, turn.fitted = candidate.effect, fitted


def _gain(base: Fitted, fitted: Fitted) -> float:
    return 2.0 * (fitted.log_likelihood - base.log_likelihood)


def _added_for_the_dark(
    bench: Bench, turn: Turn, refits: Sequence[tuple[Candidate, Fitted]], dark: Dark, options: DiagnoseOptions
) -> bool:
    """Add the likeliest effect that makes the dark pixels possible, whatever it gains in the light. Without one they
    are impossible."""
    able = [(candidate, fitted) for candidate, fitted in refits if dark.answered_by(candidate.effect)]
    if not able:
        return False
    candidate, fitted = max(able, key=lambda pair: pair[1].whole)
    fitted = settle(bench, fitted, options.starts, options.seed)
    candidate.refit_gain = _gain(turn.base, fitted)
    if not _earned(bench, turn.base, candidate, fitted):
        return False
    turn.added, turn.fitted = candidate.effect, fitted
    for other, _ in refits:
        if other is not candidate:
            other.refused = f"the dark pixels need {turn.added}"
    return True


def _holds(bench: Bench, base: Fitted, candidate: Candidate, fitted: Fitted) -> bool:
    """Whether the effect helps on views left out, is one value for a view, and is no power that the surface may send.
    Fills in what the candidate's record says of it."""
    left = candidate.left_out = leave_one_view_out(bench, base, fitted, candidate.effect)
    if not left.passed:
        candidate.refused = "it does not help on views left out by more than two standard errors"
        return False
    if varies_over_columns(bench, base, fitted, candidate.effect):
        candidate.refused = candidate.note = "not one value for a view: it varies over the view's columns"
        return False
    if not _earned(bench, base, candidate, fitted):
        return False
    if get(candidate.effect).in_image:
        candidate.carried = carried_over(bench, fitted, candidate.effect)
    if candidate.shared:
        shared = _shared_note(candidate)
        candidate.remark(shared)
        if get(candidate.effect).additive:
            candidate.refused = shared
            return False
    return True


def _earned(bench: Bench, base: Fitted, candidate: Candidate, fitted: Fitted) -> bool:
    """Whether nothing in the effect's own test speaks against its name. Fills in the candidate's record."""
    own = signature(bench, base, fitted, candidate.effect)
    candidate.signature = own = Signature(**bench.ranks.gather(asdict(own))[0])
    if own.outcome == "against":
        candidate.refused = f"its own test speaks against it: {own.text}"
    return own.outcome != "against"


def _shared_note(candidate: Candidate) -> str:
    """Why the surface may be the cause. Power added in an image may come from something that stands there. Every radar
    blurs, so of a blur the amount alone is in doubt."""
    share = f"the surface takes {100.0 * (candidate.carried or 0.0):.0f} % of its gain over from view to view"
    if candidate.left_out is not None and candidate.left_out.views == 1:
        share = "one view alone"
    if get(candidate.effect).additive:
        return f"{share}: it cannot be told from something that stands there"
    return f"{share}: its size cannot be told from errors of the mesh, and is that of both"
