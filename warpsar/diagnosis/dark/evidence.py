"""What dark pixels say: power far from everything lit needs an effect that adds power, exact zeros rule out a floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warpsar.diagnosis.dark.pixels import dark_pixels, impossible
from warpsar.diagnosis.found import Candidate
from warpsar.diagnosis.models.fit_setup import DARK_PIXELS
from warpsar.diagnosis.models.refit import Fitted
from warpsar.effects.registry import get, names
from warpsar.scene.scene import Scene

_FITTED = ("testable", "not_testable")  # where something that lit pixels do not see asks for it
SILENT_SHARE = 0.01  # of the dark pixels that may measure exactly 0 under a floor


@dataclass(frozen=True)
class Dark:
    """Pixels far from everything lit in which the model puts next to nothing: how many there are, how many of them
    measure power, and how much, by view name (see `impossible`). `placed`: effects that put power exactly there.
    `unexplained`: how many measure far more than the model's sidelobes."""

    pixels: int
    positive: int
    power: Mapping[str, np.ndarray] = field(default_factory=dict)
    placed: Sequence[str] = ()
    unexplained: int = 0

    @classmethod
    def of(cls, base: Fitted) -> Dark:
        """Over all observations of the model; none where a floor of the model lies under all of them."""
        if any(get(name).is_floor for name in base.scene.effects):
            return cls(0, 0)
        found = dark_pixels(base.problem, base.x)
        positive = sum(int(one.measures_power.sum()) for one in found)
        power = impossible(found)
        free = [name for name in names() if name not in base.scene.effects]
        placed = [name for name in free if get(name).placed_in_the_dark(base.scene, {}, power) is not None]
        unexplained = sum(int(one.unexplained.sum()) for one in found)
        return cls(sum(int(one.empty.sum()) for one in found), positive, power, placed, unexplained)

    @property
    def everywhere(self) -> bool:
        """Most of them measure power that the model has not, and no multiple of a model's darkness explains it."""
        return self.pixels >= DARK_PIXELS and self.unexplained > 0.5 * self.pixels

    @property
    def asks(self) -> bool:
        """They measure power that the model cannot have, and the library can."""
        return self.everywhere or bool(self.placed)

    def answered_by(self, effect: str) -> bool:
        """Whether the effect makes them possible."""
        return get(effect).additive if self.everywhere else effect in self.placed

    @property
    def refuses_a_floor(self) -> bool:
        """Too many of them measure exactly 0."""
        return self.pixels >= DARK_PIXELS and self.positive < (1.0 - SILENT_SHARE) * self.pixels

    def completed(self, scene: Scene, effect: str, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """The effect's table with the places that dark pixels know: where it acts there, and where it does not. Empty
        where they leave it no place."""
        if self.everywhere:
            return table
        placed = get(effect).placed_in_the_dark(scene, table, self.power)
        return table if placed is None else placed


def worth_a_refit(
    candidates: Sequence[Candidate], threshold: float, dark: Dark, shadows: bool = False
) -> list[Candidate]:
    """Candidates worth a refit, best first.

    Power in the dark needs an effect that puts it there, whatever the lit pixels say, and though the surface can
    imitate it there: dark pixels test it by themselves. A floor is ruled out where many of them measure exactly 0.
    Where `shadows` measure power, a change of the geometry may explain it as well: such an effect is fitted beside.
    """
    order = sorted(candidates, key=lambda c: -c.minus_log_p)
    found = [c for c in order if c.testability == "testable" and c.minus_log_p > threshold]
    if dark.refuses_a_floor:
        for candidate in found:
            if get(candidate.effect).is_floor:
                candidate.refused = f"{dark.pixels - dark.positive} of {dark.pixels} dark pixels measure nothing"
                candidate.note = candidate.refused
        order, found = ([c for c in some if not get(c.effect).is_floor] for some in (order, found))
    if dark.asks:
        tested = _FITTED if dark.everywhere else ("testable",)
        able = [c for c in order if c.testability in tested and dark.answered_by(c.effect)]
        for candidate in able:
            _tested(candidate, f"{dark.unexplained} of {dark.pixels} dark pixels measure power that the model has not")
        found = able + [c for c in found if c not in able]
    elif shadows:
        for candidate in order:
            if candidate not in found and candidate.testability in _FITTED and get(candidate.effect).additive:
                _tested(candidate, "shadows measure power that the model has not")
                found.append(candidate)
    return found


def _tested(candidate: Candidate, why: str) -> None:
    """Let a candidate be fitted, though lit pixels may not tell it from the surface."""
    if candidate.testability == "not_testable":
        candidate.testability, candidate.statistic = "testable", 0.0
    candidate.note = why
