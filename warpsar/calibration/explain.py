"""What the difference between measured and predicted RCS means: causes fitted beside each other, and what is tied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from warpsar.calibration.causes import Cause, Situation, causes
from warpsar.calibration.differences import BadDate, Differences, absent, bad_dates
from warpsar.calibration.joint import (
    ALIKE,
    JointFit,
    Trials,
    by_image,
    fits_alone,
    halves,
    intervals,
    joint,
    together_words,
    values_words,
)
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.turns import AttitudeSolution, attitude_solutions, attitude_words, over_attitudes
from warpsar.calibration.unpredicted import Unpredicted, unpredicted

F64 = NDArray[np.float64]
TIED = float(chdtri(1.0, 0.05))
"""Squared distance of two fits in standard deviations, below which the data do not tell them apart."""


@dataclass(frozen=True)
class FittedCause:
    """A cause at its best, with intervals of 90 %."""

    cause: Cause
    values: F64
    low: F64
    high: F64
    fitted_db: F64
    """(n,)."""
    scatter_db: float
    """What is left from date to date beyond clutter and noise."""
    log_likelihood: float
    bic: float
    held_log_likelihood: float | None
    """Per held-back value, of a fit to the earlier dates; None where those are too few."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "cause": self.cause.name,
            "title": self.cause.title,
            "parameters": {
                name: {"value": float(v), "low": float(a), "high": float(b)}
                for name, v, a, b in zip(self.cause.parameters, self.values, self.low, self.high, strict=True)
            },
            "scatter_db": self.scatter_db,
            "log_likelihood": self.log_likelihood,
            "bic": self.bic,
            "held_log_likelihood": self.held_log_likelihood,
        }


@dataclass(frozen=True)
class Tie:
    """Two causes that these data do not tell apart, and what would."""

    first: str
    second: str
    decided_by: str
    """In words; empty where nothing that is known of would."""
    apart_db: float
    """How far apart both then are."""

    def content(self) -> dict[str, object]:
        return {"causes": [self.first, self.second], "decided_by": self.decided_by, "apart_db": self.apart_db}


@dataclass(frozen=True)
class Explanation:
    """All causes, best first; which are tied; which dates are bad; and where the image lies."""

    fitted: tuple[FittedCause, ...]
    tied: tuple[Tie, ...]
    bad_dates: tuple[BadDate, ...]
    words: tuple[str, ...]
    used: int
    differences: Differences | None = field(default=None, repr=False)
    joint: JointFit | None = field(default=None, repr=False)
    """Causes together."""
    attitudes: tuple[AttitudeSolution, ...] = ()
    """All attitudes that fit, where an attitude is a cause or could stand for one."""
    unpredicted: Unpredicted | None = None
    """Reflectors without a prediction."""

    def content(self) -> dict[str, object]:
        return {
            "values": self.used,
            "words": list(self.words),
            "causes": [one.content() for one in self.fitted],
            "tied": [one.content() for one in self.tied],
            "bad_dates": [one.content() for one in self.bad_dates],
            "joint": None if self.joint is None else self.joint.content(),
            "attitudes": [one.content() for one in self.attitudes],
            "unpredicted": None if self.unpredicted is None else self.unpredicted.content(),
        }


def explain(observations: Sequence[ReflectorObservation]) -> Explanation:
    """Causes of the differences between measured and predicted RCS.

    Bad dates are set aside first. Every cause is then fitted alone, and all are fitted together (`joint`), by the
    likelihood of a Gaussian with clutter and noise, a scatter from value to value, and one from image to image. Causes
    alone are ranked by BIC. Reflectors without a prediction are compared with themselves (`unpredicted`).
    """
    all_of_them, missing = Differences.of(observations), absent(observations)
    bare = unpredicted(observations)
    more = [*(() if bare is None else bare.words), *_turned_away(observations)]
    missing += () if bare is None else bare.bad_dates
    if len(all_of_them) < 1:
        nothing = "No difference can be explained: no reflector is measured and predicted."
        return Explanation((), (), tuple(missing), (nothing, *more), 0, unpredicted=bare)
    bad, good = bad_dates(all_of_them)
    bad = sorted([*missing, *bad], key=lambda one: (one.site, one.date))
    data = all_of_them.part(good)
    early, late = halves(data)
    trials = Trials(data, causes(data)), None if early is None else Trials(early, causes(early))
    fitted = alone(*trials, late)
    tied = _ties(fitted, data)
    found = joint(data, causes, _situations(data), trials)
    attitudes = attitude_solutions(found, data)
    found = over_attitudes(found, attitudes)
    words = _words(fitted, tied, bad, data, found, attitudes) + more
    return Explanation(
        tuple(fitted), tuple(tied), tuple(bad), tuple(words), len(data), data, found, tuple(attitudes), bare
    )


def _turned_away(observations: Sequence[ReflectorObservation]) -> list[str]:
    """A line for each reflector that is measured while its stated attitude hides its inside from the radar."""
    texts: dict[str, str] = {}
    for one in observations:
        if one.status != "measured" or one.facing is None or one.expected is None or one.predicted_m2:
            continue
        texts.setdefault(
            one.site.name,
            f"{one.site.name} is measured and not predicted: by its table it faces azimuth {one.facing.azimuth_deg:g} "
            f"degrees, clockwise from north, while the radar stands at {one.expected.azimuth_deg:.0f} and sees no "
            "inside. From where does that azimuth count?",
        )
    return list(texts.values())


def alone(every: Trials, early: Trials | None, late: Differences | None) -> list[FittedCause]:
    """Each cause by itself at its best, the most likely one first; and how likely it makes the later dates."""
    later: dict[str, float] = {}
    if early is not None and late is not None:
        for name, fit in fits_alone(early).items():
            later[name] = float(by_image(fit, late).sum()) / len(late) - 0.5 * float(np.log(2.0 * np.pi))
    found = []
    for name, fit in fits_alone(every).items():
        ((cause, x, low, high),) = intervals(fit.model, fit.free, fit.covariance, every.data, fit.scatter)
        found.append(
            FittedCause(
                cause, x, low, high, fit.fitted, fit.scatter.value, fit.log_likelihood, fit.bic, later.get(name)
            )
        )
    return sorted(found, key=lambda one: one.bic)


# ---- what is tied ----


def _situations(data: Differences) -> list[Situation]:
    """What could be measured next."""
    now = float(data.years.max())
    incidence = float(data.incidence_deg.mean())
    look = data.look[-1]
    other = look * np.array([-1.0, 1.0, 1.0])
    found = [
        Situation("another reflector, of surveyed size and attitude, in the same image", None, incidence, now, look),
        Situation("another reflector, surveyed, at an incidence 8 degrees higher", None, incidence + 8.0, now, look),
        Situation("another reflector, surveyed, in an image of a year later", None, incidence, now + 1.0, look),
    ]
    for i in np.unique(data.site).tolist():
        name, k = data.names[i], int(np.flatnonzero(data.site == i)[-1])
        at, view = float(data.incidence_deg[k]), data.look[k]
        turned = _turned(view, 0.0, 10.0)
        found += [
            Situation(f"{name} after it was cleaned and dried", name, at, now, view, cleaned=True),
            Situation(f"{name} with its legs measured by tape", name, at, now, view, leg_surveyed=True),
            Situation(f"{name} with its attitude surveyed", name, at, now, view, attitude_surveyed=True),
            Situation(f"{name} seen 10 degrees higher, from another pass", name, at - 10.0, now, turned),
            Situation(f"{name} a year later", name, at, now + 1.0, view),
        ]
    found.append(Situation("a reflector seen from the other side", None, incidence, now, other))
    return found


def _turned(look: F64, azimuth_deg: float, higher_deg: float) -> F64:
    azimuth = np.arctan2(look[0], look[1]) + np.deg2rad(azimuth_deg)
    incidence = np.arccos(look[2]) - np.deg2rad(higher_deg)
    return np.array([np.sin(azimuth) * np.sin(incidence), np.cos(azimuth) * np.sin(incidence), np.cos(incidence)])


def _ties(fitted: Sequence[FittedCause], data: Differences) -> list[Tie]:
    """Among causes whose odds against the best are better than 1 to 10: those whose fits the data do not tell apart."""
    near = [one for one in fitted if one.bic <= fitted[0].bic + ALIKE and one.cause.physical]
    found = []
    for k, first in enumerate(near):
        for second in near[k + 1 :]:
            sd = np.sqrt(data.sd**2 + max(first.scatter_db, second.scatter_db) ** 2)
            if float((((first.fitted_db - second.fitted_db) / sd) ** 2).sum()) > TIED:
                continue
            apart, best = 0.0, ""
            for situation in _situations(data):
                off = abs(first.cause.at(first.values, situation) - second.cause.at(second.values, situation))
                if off > apart + 1e-6:
                    apart, best = off, situation.words
            found.append(Tie(first.cause.name, second.cause.name, best, apart))
    return found


def _words(
    fitted: Sequence[FittedCause],
    tied: Sequence[Tie],
    bad: Sequence[BadDate],
    data: Differences,
    found: JointFit,
    attitudes: Sequence[AttitudeSolution],
) -> list[str]:
    """What is found, in sentences."""
    best = next(one for one in fitted if one.cause.physical)
    rivals = {one.cause.name: one for one in fitted if not one.cause.physical}
    mean = float(np.average(data.value, weights=1.0 / (data.sd**2 + best.scatter_db**2)))
    words = [
        f"Values: {len(data)}, of reflectors: {len(np.unique(data.site))}. They lie {mean:+.2f} dB off the prediction "
        "on average."
    ]
    words += together_words(found)
    words += attitude_words(attitudes)
    values = values_words(best.cause, best.values, best.low, best.high)
    words.append(
        f"Best alone: {best.cause.title}" + (f": {values}" if values else "") + f"; {best.scatter_db:.2f} dB are left "
        "from date to date."
    )
    if rivals["none"].bic <= best.bic:
        words.append("No cause alone explains more than its parameters cost.")
    elif rivals["levels"].bic < best.bic - ALIKE:
        words.append("No single cause explains what a level of its own for each reflector and pass does.")
    mates = [
        one.second if one.first == best.cause.name else one.first
        for one in tied
        if best.cause.name in (one.first, one.second)
    ]
    if mates:
        words.append(f"It cannot be told here from: {'; '.join(mates)}.")
    if bad:
        words.append(
            f"Set aside: {len(bad)} value(s), at which the reflector was not seen, or lies far off its own level."
        )
    return words
