"""Whether measured curves show another material than a part of the body is declared to have.

Each hypothesis changes the material of one part. Its model is asked like a term (`search.py`): the train curves must
pay for it beside the declared one, the test curves must gain by two standard errors, and neither polarization may lose
by two standard errors. It must also be likelier than a constant level. A part may be `open`, too: nothing is known then
of what comes back from it but a level, which its area in sight multiplies. Where an opening may take a share of a part,
its hypotheses differ by the share, and the likeliest one is asked. What is costly waits: test curves are swept for the
likeliest hypothesis of a question alone, and values get intervals where it stands.

The noise of each curve is its own (`noise.fit_each`), that of a test curve, too. Each hypothesis fits as many numbers
of noise as the declared material does. So they gain nothing by them, and no frequency has to tell the noise of another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from warpsar.curves.noise import DB_TO_AMPLITUDE, densities, fit_each
from warpsar.curves.observed import ObservedCurve, independent
from warpsar.curves.rivals import constant
from warpsar.curves.search import ERRORS, TEST, CurvesLeftOut
from warpsar.curves.shape import ProfileInterval, profiles

MODEL = "model"
"""The one term of a curve beside a hypothesis: the sum of all that it has."""
Kind = Literal["declared", "metal", "dielectric", "open", "dielectric layer", "magnetic layer"]
Outcome = Literal["named", "tied", "refused"]
ALIKE = 0.01
"""2 ln L: what differs by less is the same, as the mirror images of a body in its plane of symmetry."""
LEAST_DB = 0.4
"""Fall of the noise that a material must bring, in the mean over all directions.

The engine is right to 0.01 to 0.4 dB on bodies that have closed forms. What explains less may lean on that: with
enough curves a systematic error of any size makes two standard errors.
"""
_LEVELS_DB = (-60.0, 10.0)
"""Where the level of an open part is sought, over its area in sight."""


@dataclass(frozen=True)
class MaterialHypothesis:
    """A part of the body in another material, and the curves beside that body."""

    part: str
    kind: Kind
    train: tuple[ObservedCurve, ...]
    every: Callable[[], tuple[ObservedCurve, ...]]
    """Train and test curves."""
    eps_r: float | None = None
    thickness_m: float | None = None
    """Of a sheet in air. Curves of a thin one tell the product (eps_r - 1) x thickness alone."""
    share: float = 1.0
    """Of an open part: the rest of it sends back what is declared."""
    parameters: int = 0
    """Fitted ones, which the train curves must pay for."""
    intervals: Callable[[], Mapping[str, ProfileInterval]] = dict
    """Of a layer on metal: what the train curves tell of it."""

    @property
    def product_m(self) -> float | None:
        """(eps_r - 1) x thickness of a sheet [m]."""
        return None if self.eps_r is None or self.thickness_m is None else (self.eps_r - 1.0) * self.thickness_m


@dataclass(frozen=True)
class MaterialTest:
    """What one kind of material for one part was asked."""

    part: str
    kind: Kind
    outcome: Outcome
    eps_r: ProfileInterval | None
    gain: float
    """2 ln L over the declared material on the train curves."""
    price: float
    left_out: tuple[CurvesLeftOut, ...]
    over_constant_level: float
    whole: float
    """2 ln L over the declared material on all curves."""
    why: str = ""
    product_m: ProfileInterval | None = None
    """Of a sheet: (eps_r - 1) x thickness [m]. `eps_r` is then None."""
    values: Mapping[str, ProfileInterval] = field(default_factory=dict)
    """Of a layer on metal that stands, under their names; lengths and products with a length in metres."""

    @property
    def words(self) -> str:
        """One sentence."""
        value = ""
        known = (self.eps_r, "eps_r", ""), (self.product_m, "(eps_r - 1) x thickness", " m")
        of_layer = [
            (interval, name.removesuffix("_m"), " m" * name.endswith("_m")) for name, interval in self.values.items()
        ]
        for interval, name, unit in (*known, *of_layer):
            if interval is not None:
                ends = f"{interval.low:.3g} to {interval.high:.3g}{unit}{', the end of what was tried' * interval.open}"
                value += f", {name} {interval.value:.3g}{unit} ({ends})"
        return f"{self.part}: {self.kind}{value}: {self.outcome}" + (f", {self.why}" if self.why else "")


def opened(
    hypothesis: MaterialHypothesis, area_m2: Callable[[ObservedCurve], NDArray[np.float64]]
) -> MaterialHypothesis:
    """The hypothesis with the likeliest level of an open part; `area_m2` is what a curve's directions see of it."""

    def seen(curves: Sequence[ObservedCurve]) -> list[ObservedCurve]:
        return [replace(one, level_m2=area_m2(one)) for one in curves]

    def leveled(curves: Sequence[ObservedCurve], level_db: float) -> tuple[ObservedCurve, ...]:
        return tuple(replace(one, level_m2=10.0 ** (level_db / 10.0) * one.level_m2) for one in curves)

    train = seen(hypothesis.train)
    best = minimize_scalar(
        lambda level_db: -fit_each(leveled(train, level_db), [MODEL])[1],
        bounds=_LEVELS_DB,
        method="bounded",
        options={"maxiter": 12},
    )
    every = hypothesis.every
    return replace(hypothesis, train=leveled(train, best.x), every=lambda: leveled(seen(every()), best.x), parameters=1)


def likelier(first: MaterialHypothesis, second: MaterialHypothesis) -> MaterialHypothesis:
    """Of two, the one that the train curves prefer."""
    return max((first, second), key=of_train)


def ask_materials(declared: MaterialHypothesis, others: Sequence[MaterialHypothesis]) -> list[MaterialTest]:
    """The answers for each part and kind, likeliest first; those that differ by eps_r or share are one question."""
    groups: dict[tuple[str, str], list[MaterialHypothesis]] = {}
    for one in others:
        groups.setdefault((one.part, one.kind), []).append(one)
    curves = declared.every()
    before, likelihood = _rows(curves), of_train(declared)
    asked = [_ask(curves, before, likelihood, group) for group in groups.values()]
    asked.sort(key=lambda one: -one.test.whole)
    found = _with_ties(asked, curves)
    return [
        test if test.outcome == "refused" else replace(test, values=dict(one.chosen.intervals()))
        for test, one in zip(found, asked, strict=True)
    ]


def of_train(one: MaterialHypothesis) -> float:
    """2 ln L of the train curves."""
    return 2.0 * fit_each(one.train, [MODEL])[1]


def _rows(curves: Sequence[ObservedCurve]) -> list[NDArray[np.float64]]:
    """2 ln L of each row of each curve."""
    noises, _ = fit_each(curves, [MODEL])
    return [2.0 * densities(c, c.amplitude([MODEL]), noise) for c, noise in zip(curves, noises, strict=True)]


def _by_blocks(curves: Sequence[ObservedCurve], rows: Sequence[NDArray[np.float64]]) -> tuple[float, float]:
    """A sum over rows, and its standard error by independent stretches of angle."""
    each = np.concatenate([np.bincount(c.block, r).astype(np.float64) for c, r in zip(curves, rows, strict=True)])
    error = float(np.sqrt(len(each)) * each.std(ddof=1)) if len(each) > 1 else float("inf")
    return float(each.sum()), error


@dataclass(frozen=True)
class _Asked:
    """An answer, the hypothesis that it is about, and the rows of 2 ln L over the declared material."""

    test: MaterialTest
    chosen: MaterialHypothesis
    rows: list[NDArray[np.float64]]
    in_doubt: bool
    """It is refused for the curves left out alone: they do not confirm it."""


def _ask(
    curves: Sequence[ObservedCurve],
    before: Sequence[NDArray[np.float64]],
    likelihood: float,
    group: Sequence[MaterialHypothesis],
) -> _Asked:
    """`curves`, `before` and `likelihood` are those of the declared material: all curves, their rows of 2 ln L, and
    that of the train curves."""
    group = sorted(group, key=lambda one: one.product_m or one.eps_r or 0.0)
    train = [c for c in curves if c.role == "train"]
    likelihoods = [of_train(one) for one in group]
    best = int(np.argmax(likelihoods))
    chosen = group[best]
    interval, product = None, None
    parameters = chosen.parameters
    if len(group) > 1:
        parameters += 1
    if len(group) > 1 and chosen.product_m is not None:
        products = np.array([one.product_m for one in group], np.float64)
        product = profiles({"product": products}, np.array(likelihoods))["product"]
    elif len(group) > 1 and chosen.eps_r is not None:
        axis = np.array([float(one.eps_r or 1.0) for one in group])
        interval = profiles({"eps_r": axis}, np.array(likelihoods))["eps_r"]
    price = (1 + parameters) * float(np.log(max(independent(train), 2.0)))
    gain = likelihoods[best] - likelihood
    rows = [new - old for new, old in zip(_rows(chosen.every()), before, strict=True)]
    left_out = []
    kinds = sorted({c.polarization for c in train})
    tests = [i for i, c in enumerate(curves) if c.role == "test" and c.polarization in kinds]
    if tests:
        total, error = _by_blocks([curves[i] for i in tests], [rows[i] for i in tests])
        left_out.append(CurvesLeftOut(TEST, total, error))
    for kind in kinds if len(kinds) > 1 else []:
        mine = [i for i, c in enumerate(curves) if c.polarization == kind]
        total, error = _by_blocks([curves[i] for i in mine], [rows[i] for i in mine])
        left_out.append(CurvesLeftOut(kind, total, error))
    rivals = [constant([c]) for c in train]
    paid = sum(each.parameters for each in rivals) * float(np.log(independent(train)))
    over = likelihoods[best] - 2.0 * sum(each.fitted.log_likelihood for each in rivals) + paid
    whole, _ = _by_blocks(curves, rows)
    least = 2.0 * LEAST_DB / DB_TO_AMPLITUDE * independent(curves)
    unconfirmed = [each.name for each in left_out if not each.holds]
    why = ""
    if gain <= price:
        why = "the train curves do not pay for it"
    elif unconfirmed:
        why = f"curves left out do not confirm it: {', '.join(unconfirmed)}"
    elif over <= 0.0:
        why = "no likelier than a constant level"
    elif whole <= least:
        why = f"it takes less than {LEAST_DB:g} dB off the noise, which the engine's own error may hold"
    in_doubt = bool(unconfirmed) and gain > price and over > 0.0 and whole > least
    outcome: Outcome = "refused" if why else "named"
    head = chosen.part, chosen.kind, outcome, interval
    return _Asked(MaterialTest(*head, gain, price, tuple(left_out), over, whole, why, product), chosen, rows, in_doubt)


def _with_ties(asked: Sequence[_Asked], curves: Sequence[ObservedCurve]) -> list[MaterialTest]:
    """Those that stand are tied where the likeliest of them is not two standard errors before another.

    So is one that the curves left out leave in doubt: of two that the same curves cannot tell apart, the one whose gain
    passes two standard errors by a little has no better right to a name.
    """
    found = [one.test for one in asked]
    standing = [i for i, one in enumerate(found) if one.outcome == "named"]
    if not standing:
        return found
    first = standing[0]
    tied = []
    for i, one in enumerate(asked):
        if i == first or not (i in standing or one.in_doubt):
            continue
        rows = [a - b for a, b in zip(asked[first].rows, one.rows, strict=True)]
        ahead, error = _by_blocks(curves, rows)
        if ahead <= max(ERRORS * error, ALIKE):
            tied.append(i)
        elif i in standing:
            found[i] = replace(found[i], outcome="refused", why=f"{found[first].part}, {found[first].kind} is likelier")
    for i in [first, *tied] if tied else []:
        others = [f"{found[j].part}, {found[j].kind}" for j in [first, *tied] if j != i]
        found[i] = replace(found[i], outcome="tied", why=f"not told from {'; '.join(others)}")
    return found
