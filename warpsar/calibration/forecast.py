"""Later RCS foretold from earlier dates, with intervals; and how many of the later values lie inside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from warpsar.calibration.causes import causes, changes
from warpsar.calibration.differences import SAME_PASS, Differences, bad_dates, over_1_m2
from warpsar.calibration.explain import Explanation
from warpsar.calibration.joint import CONFIDENCE, CauseFit, Trials, fits_alone
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.table import decibel

F64 = NDArray[np.float64]
FEWEST_VALUES = 3
"""Earlier values of a reflector in a pass, without which its later ones are not foretold."""
RIVAL = "levels"
HALVINGS = 60
"""Of the bracket about an end of an interval."""


@dataclass(frozen=True)
class ForetoldValue:
    """A later value of a reflector, and what the earlier dates made of it."""

    observation: ReflectorObservation
    foretold_dbsm: float
    low_dbsm: float
    high_dbsm: float
    """Of 90 %."""
    inside: bool
    level_low_dbsm: float
    level_high_dbsm: float
    """By the rival that knows no physics: the mean of the earlier values of this reflector and pass."""
    level_inside: bool

    def content(self) -> dict[str, object]:
        """For JSON."""
        one = self.observation
        measured = None if one.point is None or one.status != "measured" else decibel(one.point.rcs_m2)
        return {
            "id": one.site.name, "date": str(one.date)[:19], "polarization": one.polarization, "status": one.status,
            "rcs_dbsm": measured, "foretold_dbsm": self.foretold_dbsm, "low_dbsm": self.low_dbsm,
            "high_dbsm": self.high_dbsm, "inside": self.inside, "level_low_dbsm": self.level_low_dbsm,
            "level_high_dbsm": self.level_high_dbsm, "level_inside": self.level_inside,
        }  # fmt: skip


@dataclass(frozen=True)
class Forecast:
    """All later values that could be foretold."""

    since: str
    """The first date that is held back."""
    values: tuple[ForetoldValue, ...]
    not_foretold: int
    """Later values without enough earlier ones of the same reflector and pass."""
    words: tuple[str, ...]

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "since": self.since, "confidence": CONFIDENCE, "foretold": len(self.values),
            "inside": sum(one.inside for one in self.values),
            "level_inside": sum(one.level_inside for one in self.values),
            "not_foretold": self.not_foretold, "words": list(self.words),
            "values": [one.content() for one in self.values],
        }  # fmt: skip


def forecast(
    observations: Sequence[ReflectorObservation], since: np.datetime64, explanation: Explanation | None = None
) -> Forecast:
    """Foretell the RCS at dates from `since` on by what earlier dates show. `explanation`: of the earlier dates.

    Each model of the earlier dates foretells a value with Student's t: the error of its parameters, its scatter from
    value to value and from image to image, and clutter at the level that it foretells. Models are the causes together,
    each cause alone, and the rivals; they are averaged with weights exp(-BIC / 2) (Raftery, Sociological Methodology
    25, 1995), so that causes that could stand for each other widen the interval. A reflector without a prediction is
    foretold from its own earlier values. One that is not seen counts as inside where its upper bound reaches the
    interval.
    """
    used = [one for one in observations if one.stands and one.site.for_power and one.calibrated]
    values: list[ForetoldValue] = []
    for predicted in (True, False):
        some = [over_1_m2(one) for one in used if bool(one.predicted_m2) == predicted]
        early = [one for one in some if one.date < since]
        late = [one for one in some if one.date >= since]
        values += _foretold(early, late, explanation if predicted else None)
    values.sort(key=lambda one: (one.observation.site.name, one.observation.date))
    count, date = len(values), str(since)[:10]
    left = sum(bool(one.date >= since) for one in used) - count
    words = []
    if count:
        inside, level = (sum(getattr(one, name) for one in values) for name in ("inside", "level_inside"))
        width = float(np.median([one.high_dbsm - one.low_dbsm for one in values]))
        plain = float(np.median([one.level_high_dbsm - one.level_low_dbsm for one in values]))
        words.append(
            f"Held back from {date} on: {inside} of {count} values lie in the {100 * CONFIDENCE:.0f} % interval that "
            f"the earlier dates foretell, {width:.1f} dB wide. Of a level of each reflector and pass alone it is "
            f"{level} of {count}, {plain:.1f} dB wide."
        )
    if left or not count:
        words.append(
            f"Held back from {date} on: not foretold, as their reflector and pass have fewer than {FEWEST_VALUES} "
            f"earlier values: {left}."
        )
    return Forecast(date, tuple(values), left, tuple(words))


def _bounded(one: ReflectorObservation) -> ReflectorObservation:
    """What is not seen has its upper bound as value."""
    if one.status == "measured" or one.point is None:
        return one
    bound = one.point.high_m2
    return replace(one, status="measured", point=replace(one.point, rcs_m2=bound, low_m2=0.99 * bound))


def _foretold(
    early: Sequence[ReflectorObservation], late: Sequence[ReflectorObservation], explanation: Explanation | None
) -> list[ForetoldValue]:
    data = Differences.of(early)
    if not len(data) or not late:
        return []
    known = data.part(bad_dates(data)[1])
    trials = Trials(known, changes(known) if explanation is None else causes(known))
    alone = fits_alone(trials)
    together = [] if explanation is None or explanation.joint is None else [explanation.joint.fit]
    # Later dates come after all earlier ones, so numbers of reflectors and images, and years, are the same in both.
    sources = {(one.site.name, one.date, one.source, one.polarization): one for one in late}
    every = Differences.of([*early, *map(_bounded, late)])
    chosen = []
    for one, site, look in zip(every.observations, every.site.tolist(), every.look, strict=True):
        before = (known.site == site) & (known.look @ look > SAME_PASS)
        is_late = (one.site.name, one.date, one.source, one.polarization) in sources
        chosen.append(is_late and int(before.sum()) >= FEWEST_VALUES)
    asked = every.part(np.array(chosen, bool))
    if not len(asked):
        return []
    seen = [sources[one.site.name, one.date, one.source, one.polarization] for one in asked.observations]
    lower = np.array([one.status != "measured" for one in seen])
    usual = np.array([np.median(known.sd[known.site == site]) for site in asked.site.tolist()])
    asked = replace(asked, sd=np.where(lower, usual, asked.sd))
    middle, low, high = _mixed([*together, *alone.values()], known, asked, lower)
    _, plain_low, plain_high = _mixed([alone[RIVAL]], known, asked, lower)
    base = np.array([10.0 * np.log10(one.predicted_m2 or 1.0) for one in asked.observations])

    def holds(k: int, ends: tuple[F64, F64]) -> bool:
        return bool(asked.value[k] >= ends[0][k] and (lower[k] or asked.value[k] <= ends[1][k]))

    return [
        ForetoldValue(
            seen[k], float(base[k] + middle[k]), float(base[k] + low[k]), float(base[k] + high[k]),
            holds(k, (low, high)), float(base[k] + plain_low[k]), float(base[k] + plain_high[k]),
            holds(k, (plain_low, plain_high)),
        )
        for k in range(len(asked))
    ]  # fmt: skip


def _mixed(
    fits: Sequence[CauseFit], known: Differences, asked: Differences, lower: NDArray[np.bool_]
) -> tuple[F64, F64, F64]:
    """Median and both ends of the mixture of what each model foretells, (n,) each."""
    weights = np.exp(-0.5 * (np.array([fit.bic for fit in fits]) - min(fit.bic for fit in fits)))
    weights /= weights.sum()
    kept = [(fit, weight) for fit, weight in zip(fits, weights.tolist(), strict=True) if weight > 1e-4]
    places, scales, freedoms = [], [], []
    for fit, _ in kept:
        place = fit.model.curve(fit.free, asked)
        # The target beats with clutter: at the foretold level, not at the one that was measured.
        clutter = np.where(lower, asked.sd, asked.sd * 10.0 ** (np.clip(asked.value - place, -40.0, 40.0) / 20.0))
        own = fit.scatter.value**2 + fit.scatter.image**2 + fit.error(asked) ** 2
        free = max(len(known) - fit.free.size, 1)
        places.append(place)
        scales.append(np.sqrt(own + clutter**2))
        freedoms.append(free * (1.0 + clutter**2 / own) ** 2)  # Satterthwaite: clutter's part is known
    share = np.array([weight for _, weight in kept])
    share = (share / share.sum())[:, None]
    place, scale, freedom = (np.array(each) for each in (places, scales, freedoms))

    def quantile(chance: float) -> F64:
        ends = stdtrit(freedom, chance) * scale + place
        low, high = ends.min(axis=0), ends.max(axis=0)
        for _ in range(HALVINGS):
            at = 0.5 * (low + high)
            below = (share * stdtr(freedom, (at - place) / scale)).sum(axis=0) < chance
            low, high = np.where(below, at, low), np.where(below, high, at)
        return np.asarray(0.5 * (low + high), np.float64)

    tail = 0.5 * (1.0 - CONFIDENCE)
    return quantile(0.5), quantile(tail), quantile(1.0 - tail)
