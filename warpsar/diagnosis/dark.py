"""What dark pixels say: power far from everything lit needs an effect that adds power, exact zeros rule out a floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.found import Candidate
from warpsar.diagnosis.refit import Fitted
from warpsar.effects.registry import get

DARK_PIXELS = 50  # fewer dark pixels than this say nothing
SILENT_SHARE = 0.01  # of the dark pixels that may measure exactly 0 under a floor


@dataclass(frozen=True)
class Dark:
    """Pixels far from everything lit: how many there are, and how many of them measure power."""

    pixels: int
    positive: int

    @classmethod
    def of(cls, base: Fitted) -> Dark:
        """Over all observations of the model; none where the model already has an effect that adds power."""
        if any(get(name).additive for name in base.scene.effects):
            return cls(0, 0)
        seen = base.problem.observations
        positive = sum(int((one.dark & (np.nan_to_num(one.measured) > 0)).sum()) for one in seen)
        return cls(sum(int(one.dark.sum()) for one in seen), positive)

    @property
    def asks(self) -> bool:
        """They measure power, and no multiple of a model's darkness explains it."""
        return self.pixels >= DARK_PIXELS and self.positive > 0.5 * self.pixels

    @property
    def refuses_a_floor(self) -> bool:
        """Too many of them measure exactly 0."""
        return self.pixels >= DARK_PIXELS and self.positive < (1.0 - SILENT_SHARE) * self.pixels


def worth_a_refit(candidates: Sequence[Candidate], threshold: float, dark: Dark) -> list[Candidate]:
    """Candidates worth a refit, best first.

    Power in the dark needs an additive effect, whatever the lit pixels say. A floor is ruled out where many dark pixels
    measure exactly 0.
    """
    order = sorted(candidates, key=lambda c: -c.minus_log_p)
    found = [c for c in order if c.testability == "testable" and c.minus_log_p > threshold]
    if dark.refuses_a_floor:
        for candidate in found:
            if get(candidate.effect).is_floor:
                candidate.refused = f"{dark.pixels - dark.positive} of {dark.pixels} dark pixels measure exactly 0"
                candidate.note = candidate.refused
        found = [c for c in found if not get(c.effect).is_floor]
    if dark.asks:
        additive = [c for c in order if c.testability == "testable" and get(c.effect).additive]
        for candidate in additive:
            candidate.note = f"{dark.positive} of {dark.pixels} dark pixels measure power"
        found = additive + [c for c in found if c not in additive]
    return found
