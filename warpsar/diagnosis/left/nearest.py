"""The explanations that come nearest to what is left, and what speaks against each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.search.outcome import effect_table, outcome, passed
from warpsar.effects.registry import get

MOST = 3


@dataclass(frozen=True)
class Near:
    """An effect of the library: its score (-ln p, to be compared with `threshold`), what its fit gained in 2 ln L and
    for how many parameters (None without a fit), the `test` that it failed, and what speaks `against` it in words."""

    effect: str
    score: float
    threshold: float
    refit_gain: float | None
    refit_size: int | None
    test: str
    against: str


def nearest(turn: Turn, power: Mapping[str, np.ndarray]) -> list[Near]:
    """At most three effects that the last turn did not add, nearest first: those that were fitted by what they gained,
    then the others by their scores, and last those that cannot be tested here. Before them come effects of the model
    that would explain the `power` in dark pixels (see `impossible`) at more places."""
    tried = [c for c in turn.candidates if c.effect != turn.added and c.testability != "absent"]
    tried.sort(key=lambda c: (c.testability != "testable", -max(c.refit_gain or 0.0, 0.0), -c.minus_log_p))
    found = _declared(turn, power)
    found += [
        Near(
            c.effect,
            max(c.minus_log_p, 0.0),
            turn.threshold,
            c.refit_gain,
            c.refit_size,
            _failed(c, turn),
            outcome(c, turn),
        )
        for c in tried[:MOST]
    ]
    return found[:MOST]


def _declared(turn: Turn, power: Mapping[str, np.ndarray]) -> list[Near]:
    """Effects of the model that would explain dark pixels at more places than they have."""
    scene, found = turn.base.scene, []
    for name, table in scene.effects.items():
        effect = get(name)
        more = effect.placed_in_the_dark(scene, table, power)
        if more is not None and any(more.get(s.name) != table.get(s.name) for s in effect.settings):
            places = effect_table({s.name: more[s.name] for s in effect.settings if s.name in more})
            against = f"the model has it, but not at all places where dark pixels show it: {places}"
            found.append(Near(name, 0.0, turn.threshold, None, None, "places", against))
    return found


def _failed(candidate: Candidate, turn: Turn) -> str:
    """The test that a candidate did not pass."""
    if candidate.testability == "not_testable":
        return "not testable"
    if not passed(candidate, turn):
        return "score"
    if candidate.refit_gain is None and candidate.refused:
        return "dark pixels"
    if candidate.signature is not None and candidate.signature.outcome == "against":
        return "signature"
    if candidate.shared:
        return "surface"
    if candidate.left_out is not None and not candidate.left_out.passed:
        return "views left out"
    if candidate.left_out is not None:
        return "one value for a view"
    return "likelihood"
