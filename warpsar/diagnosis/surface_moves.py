"""How far the surface's parameters went while effects were added, and what the data say of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.field_content import identify_beside
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.models.refit import Fitted
from warpsar.learning.identify import Identified, identify
from warpsar.learning.profiles import with_profiles
from warpsar.surface.surface import Kind

SAME_SD = 2.0  # a parameter that moved by more of its standard deviations than this is said to have moved


@dataclass(frozen=True)
class ParameterMove:
    """A surface parameter before and after the effects were added: values (SI), and standard deviations of their
    learned coordinates (ln, or logit for specular_fraction); `after_95`: the interval of the last value (SI), None
    where it is open; `after_from`: where it comes from (`Identified.interval_from`); `sds`: the move over the root of
    both variances' sum."""

    material: str
    key: str
    before: float
    after: float
    before_sd: float
    after_sd: float
    after_95: tuple[float | None, float | None]
    after_from: str
    move: float

    @property
    def sds(self) -> float:
        return self.move / float(np.hypot(self.before_sd, self.after_sd))


def moved_parameters(diagnosis: Diagnosis) -> tuple[list[ParameterMove], Identified]:
    """How far every uniform learned surface parameter went, and what the final model's data can say of them."""
    first, last = diagnosis.declared, diagnosis.final
    before, after = (identified(fitted) for fitted in (first, last))
    if last.problem.uniform:
        after = with_profiles(last.problem, last.x, after)
    moves, ends = [], _uniform(last)
    for of, (kind, x_first, place_first) in _uniform(first).items():
        if of in ends:  # else what an absent object was made of is gone
            _, x_last, place_last = ends[of]
            a, b = float(first.x[x_first]), float(last.x[x_last])
            one, two = (float(kind.from_coordinate(x)) for x in (a, b))
            sds = float(before.sd[place_first]), float(after.sd[place_last])
            stated, source = kind.interval(after.interval_95(place_last, b)), after.interval_from(place_last)
            moves.append(ParameterMove(*of, one, two, *sds, stated, source, b - a))
    return moves, after


def identified(fitted: Fitted) -> Identified:
    """What the data can say of a model's parameters; with learned fields, of all others beside them."""
    problem, x = fitted.problem, fitted.x
    return identify(problem, x) if problem.uniform else identify_beside(problem, x)


def _uniform(fitted: Fitted) -> dict[tuple[str, str], tuple[Kind, int, int]]:
    """Of every uniform learned parameter, by material and key: its kind, its place in x, and among what is
    identified."""
    found, at, place = {}, 0, 0
    for block in fitted.problem.surface.blocks:
        if block.learn and block.size > 1:
            at += block.size
        elif block.learn:
            found[block.material, block.kind.key] = block.kind, at, place
            at, place = at + 1, place + 1
    return found
