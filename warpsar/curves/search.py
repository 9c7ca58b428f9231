"""Which terms of the model the train curves pay for, and whether curves left out confirm them.

A candidate is a term of the engine. It is asked four things. Its real factor is fitted beside the noise: 2 ln L
between factor 0 and the fitted one is chi-square with one degree of freedom where the term is not there. With the
factor 1, as physics has it, it must gain more than ln(independent directions). The test curves must gain by it, by two
standard errors, with the noise as the train curves have it; and neither polarization, judged by itself, may lose by
two standard errors. And the model must be likelier than a constant level and a smooth curve, which know no physics and
are fitted to the very curves that they are judged on.

A term that fails may still tell the level: the mean power over the directions, and not the pattern.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from warpsar.curves.metrics import correlation, level_db
from warpsar.curves.noise import Noise, densities, fit
from warpsar.curves.observed import ObservedCurve, independent
from warpsar.curves.rivals import CurveRival, constant, smooth
from warpsar.curves.sectors import sectors
from warpsar.effects import registry

CANDIDATES = {name: term for name in sorted(registry.names()) if (term := registry.get(name).term)}
"""Names of effects, as `diagnose` has them, and the terms that hold them."""
DECLARED = ("single",)
SURE = 0.01
"""Chance of a false alarm of one candidate."""
ERRORS = 2.0
"""Standard errors that a gain on left-out curves must exceed."""
LEAST = 1e-6
"""Share of the modelled power under which a term is not there to be tested."""
LEVEL_DB = 3.0
"""Mean power is told where it is right to this, in the mean square over the curves.

It must also be right twice as well as without the term.
"""
TEST = "test"
FEWEST = 3.0
"""Independent directions that a sector must hold."""

Outcome = Literal["added", "level only", "refused", "not testable"]


@dataclass(frozen=True)
class CurvesLeftOut:
    """What a term gains on curves that the noise was not fitted to: 2 ln L, and its standard error."""

    name: str
    gain: float
    error: float

    @property
    def holds(self) -> bool:
        """The test curves must confirm; a polarization must not speak against."""
        return self.gain > ERRORS * self.error if self.name == TEST else self.gain >= -ERRORS * self.error


@dataclass(frozen=True)
class CandidateTest:
    """What a candidate was asked, beside the terms `beside`."""

    effect: str
    term: str
    beside: tuple[str, ...]
    outcome: Outcome
    statistic: float = 0.0
    """2 ln L for a factor of its own."""
    p_value: float = 1.0
    factor: float = 0.0
    gain: float = 0.0
    """2 ln L for the factor 1."""
    price: float = 0.0
    left_out: tuple[CurvesLeftOut, ...] = ()
    over_rivals: Mapping[str, float] = field(default_factory=dict)
    """2 ln L over each rival, whose parameters are paid for."""
    level_db: tuple[float, float] = (float("nan"), float("nan"))
    """Modelled over measured mean power without and with the term, in the mean square over the curves [dB]."""
    correlation: float = float("nan")
    """Of decibels, the mean of the curves."""
    why: str = ""


@dataclass(frozen=True)
class TermSearch:
    """The terms of the model, and every question on the way."""

    terms: tuple[str, ...]
    verdict: tuple[str, ...]
    level_only: tuple[str, ...]
    asked: tuple[CandidateTest, ...]


def search(
    curves: Sequence[ObservedCurve], terms: Sequence[str] = DECLARED, candidates: Mapping[str, str] = CANDIDATES
) -> TermSearch:
    """Add the likeliest candidate that passes, and ask the others again, until none passes."""
    names, verdict, history, level = list(terms), [], [], []
    left = {effect: term for effect, term in candidates.items() if term not in names}
    while left:
        answers = [ask(curves, names, effect, term) for effect, term in left.items()]
        passed = [one for one in answers if one.outcome == "added"]
        if not passed:
            history += answers
            level = [one.effect for one in answers if one.outcome == "level only"]
            break
        best = max(passed, key=lambda one: one.gain)
        names.append(best.term)
        verdict.append(best.effect)
        history.append(best)
        del left[best.effect]
    return TermSearch(tuple(names), tuple(verdict), tuple(level), tuple(history))


def by_sector(
    curves: Sequence[ObservedCurve],
    normals: NDArray[np.float64],
    terms: Sequence[str] = DECLARED,
    candidates: Mapping[str, str] = CANDIDATES,
) -> dict[str, TermSearch]:
    """What each sector names, of a body whose apertures have the outward `normals` (n, 3).

    What is found where no aperture is seen is of the body, and holds in front of the aperture, too. Without apertures
    there is one sector, `all`.
    """
    if not len(normals):
        return {"all": search(curves, terms, candidates)}

    def part(name: str) -> list[ObservedCurve]:
        inside = [sectors(normals, one.azimuth_deg, one.incidence_deg)[name] for one in curves]
        return [one.where(keep) for one, keep in zip(curves, inside, strict=True) if keep.any()]

    away = search(part("away"), terms, candidates) if part("away") else TermSearch(tuple(terms), (), (), ())
    aperture = search(part("aperture"), away.terms, candidates) if part("aperture") else away
    return {"away": away, "aperture": aperture}


def ask(curves: Sequence[ObservedCurve], names: Sequence[str], effect: str, term: str) -> CandidateTest:
    """Ask one candidate everything (see the top of this file)."""
    train = [one for one in curves if one.role == "train"]
    head = (effect, term, tuple(names))
    share = _share(curves, names, term)
    if share < LEAST or independent(train) < FEWEST:
        why = "the term is nothing here" if share < LEAST else "too few independent directions"
        return CandidateTest(*head, "not testable", why=why)
    with_it = [*names, term]
    without, free, one = fit(train, names), fit(train, names, term), fit(train, with_it)
    statistic = max(2.0 * (free.log_likelihood - without.log_likelihood), 0.0)
    gain, price = 2.0 * (one.log_likelihood - without.log_likelihood), float(np.log(independent(train)))
    p_value = float(chdtrc(1, statistic))
    left_out = tuple(_left_out(curves, names, term))
    over = {rival.name: _over(curves, with_it, rival) for rival in (constant(curves), smooth(curves))}
    levels = (_level(curves, names), _level(curves, with_it))
    why = ""
    if not (gain > price and p_value < SURE):
        why = "the train curves do not pay for it"
    elif bad := [each.name for each in left_out if not each.holds]:
        why = f"curves left out do not confirm it: {', '.join(bad)}"
    elif beaten := [name for name, value in over.items() if value <= 0.0]:
        why = f"no likelier than a {' and a '.join(beaten)}"
    leveled = levels[1] < min(LEVEL_DB, 0.5 * levels[0])
    outcome: Outcome = "added" if not why else "level only" if leveled else "refused"
    alike = [correlation(each.measured_m2, np.abs(each.amplitude(with_it)) ** 2) for each in curves]
    return CandidateTest(
        *head,
        outcome,
        statistic,
        p_value,
        free.factor,
        gain,
        price,
        left_out,
        over,
        levels,
        float(np.nanmean(alike)),
        why,
    )


def _level(curves: Sequence[ObservedCurve], names: Sequence[str]) -> float:
    """Modelled over measured mean power [dB], in the mean square over the curves."""
    found = [level_db(one.measured_m2, np.abs(one.amplitude(names)) ** 2) for one in curves]
    return float(np.sqrt(np.mean(np.square(found))))


def _share(curves: Sequence[ObservedCurve], names: Sequence[str], term: str) -> float:
    """Power of a term over that of the whole, at most, over the curves."""
    shares = []
    for one in curves:
        whole = float((np.abs(one.amplitude(names)) ** 2).sum())
        shares.append(float((np.abs(one.amplitude([term])) ** 2).sum()) / max(whole, 1e-300))
    return max(shares)


def _over(curves: Sequence[ObservedCurve], names: Sequence[str], rival: CurveRival) -> float:
    """2 ln L of the model over a rival; each of the rival's parameters costs ln(independent directions)."""
    own = fit(curves, names).log_likelihood - rival.fitted.log_likelihood
    return 2.0 * own + rival.parameters * float(np.log(independent(curves)))


def _left_out(curves: Sequence[ObservedCurve], names: Sequence[str], term: str) -> list[CurvesLeftOut]:
    """Gains on the test curves, with the noise as the train curves of the same polarization have it; then on each
    polarization by itself, about which nothing was fitted to the other but its own noise."""
    train = [one for one in curves if one.role == "train"]
    kinds = sorted({one.polarization for one in train})
    parts = [(TEST, train, [one for one in curves if one.role == "test" and one.polarization in kinds])]
    if len(kinds) > 1:
        for kind in kinds:
            mine = [one for one in curves if one.polarization == kind]
            parts.append((kind, mine, mine))
    found = []
    for name, fitted, judged in parts:
        if judged:
            before, after = fit(fitted, names).noise, fit(fitted, [*names, term]).noise
            gains = [_gains(one, names, term, before[one.polarization], after[one.polarization]) for one in judged]
            each = np.concatenate(gains)
            error = float(np.sqrt(len(each)) * each.std(ddof=1)) if len(each) > 1 else float("inf")
            found.append(CurvesLeftOut(name, float(each.sum()), error))
    return found


def _gains(one: ObservedCurve, names: Sequence[str], term: str, before: Noise, after: Noise) -> NDArray[np.float64]:
    """2 ln L that a term gains on one curve, by independent stretches of angle."""
    rows = densities(one, one.amplitude([*names, term]), after) - densities(one, one.amplitude(names), before)
    return np.bincount(one.block, 2.0 * rows).astype(np.float64)
