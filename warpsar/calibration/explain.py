"""What the difference between measured and predicted RCS means: causes fitted beside each other, and what is tied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2, norm

from warpsar.calibration.causes import Cause, Situation, causes
from warpsar.calibration.differences import LEAST_SCATTER_DB, BadDate, Differences, absent, bad_dates
from warpsar.calibration.measure import ReflectorObservation

F64 = NDArray[np.float64]
CONFIDENCE = 0.9
TIED = float(chi2.ppf(0.95, 1))
"""Squared distance of two fits in standard deviations, below which the data do not tell them apart."""
ALIKE = 2.0 * float(np.log(10.0))
"""BIC of the best cause plus this: odds of 10 to 1."""
HELD_SHARE = 1.0 / 3.0
"""Of the dates, the later ones, by which each cause is judged after it was fitted to the others."""


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

    def content(self) -> dict[str, object]:
        return {
            "values": self.used,
            "words": list(self.words),
            "causes": [one.content() for one in self.fitted],
            "tied": [one.content() for one in self.tied],
            "bad_dates": [one.content() for one in self.bad_dates],
        }


def explain(observations: Sequence[ReflectorObservation]) -> Explanation:
    """Causes of the differences between measured and predicted RCS.

    Bad dates are set aside first. Every cause is then fitted alone, by the likelihood of a Gaussian whose variance is
    that of clutter and noise and of a scatter from date to date, which is fitted, too. They are ranked by BIC.
    """
    all_of_them, missing = Differences.of(observations), absent(observations)
    if len(all_of_them) < 1:
        words = ("Nothing can be explained: no reflector is measured and predicted.",)
        return Explanation((), (), tuple(missing), words, 0)
    bad, good = bad_dates(all_of_them)
    bad = sorted([*missing, *bad], key=lambda one: (one.site, one.date))
    data = all_of_them.part(good)
    fitted = sorted((fit(cause, data) for cause in causes(data)), key=lambda one: one.bic)
    tied = _ties(fitted, data)
    return Explanation(tuple(fitted), tuple(tied), tuple(bad), tuple(_words(fitted, tied, bad, data)), len(data), data)


def fit(cause: Cause, data: Differences, *, held: bool = True) -> FittedCause:
    """A cause at its most likely, with the scatter from date to date that makes it so."""
    free = [k for k, (a, b) in enumerate(zip(cause.low, cause.high, strict=True)) if b > a]
    x = np.array(cause.start, np.float64)
    scatter = LEAST_SCATTER_DB
    covariance = np.zeros((len(free), len(free)))
    for _ in range(20):
        sd = np.sqrt(data.sd**2 + scatter**2)
        if free:
            x, covariance = _solved(cause, data, sd, x, free)
        residual = data.value - cause.curve(x, data)
        before, scatter = scatter, _scatter(residual, data.sd, len(free))
        if abs(scatter - before) < 1e-4:
            break
    sd = np.sqrt(data.sd**2 + scatter**2)
    curve = cause.curve(x, data)
    likelihood = float(np.sum(norm.logpdf(data.value, curve, sd)))
    z = float(norm.ppf(0.5 + 0.5 * CONFIDENCE))
    error = np.zeros(x.size)
    error[free] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    low, high = np.maximum(x - z * error, cause.low), np.minimum(x + z * error, cause.high)
    counted = x.size + 1  # the scatter, too
    return FittedCause(
        cause,
        x,
        low,
        high,
        curve,
        scatter,
        likelihood,
        counted * np.log(max(len(data), 2)) - 2.0 * likelihood,
        _held(cause, data) if held else None,
    )


def _solved(cause: Cause, data: Differences, sd: F64, x: F64, free: Sequence[int]) -> tuple[F64, NDArray[np.float64]]:
    def full(part: F64) -> F64:
        whole = x.copy()
        whole[list(free)] = part
        return whole

    def residual(part: F64) -> F64:
        return (data.value - cause.curve(full(part), data)) / sd

    low, high = (np.array([bound[k] for k in free]) for bound in (cause.low, cause.high))
    starts = [np.clip(x[list(free)], low + 1e-9, high - 1e-9)]
    starts += [np.array(one) for one in cause.other_starts]
    best = min(
        (least_squares(residual, start, bounds=(low, high), x_scale="jac") for start in starts), key=lambda r: r.cost
    )
    jacobian = np.asarray(best.jac, np.float64)
    information = jacobian.T @ jacobian
    return full(best.x), np.asarray(np.linalg.pinv(information, rcond=1e-8), np.float64)


def _scatter(residual: F64, sd: F64, parameters: int) -> float:
    """The scatter beyond `sd` that makes the mean squared residual one: a moment estimate, by bisection."""
    freedom = max(residual.size - parameters, 1)

    def excess(scatter: float) -> float:
        return float((residual**2 / (sd**2 + scatter**2)).sum()) - freedom

    low, high = LEAST_SCATTER_DB, 200.0
    if excess(low) <= 0.0:
        return low
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) > 0.0 else (low, middle)
    return low


def _held(cause: Cause, data: Differences) -> float | None:
    """Mean log-likelihood of the later dates, under the fit to the earlier ones."""
    order = np.unique(data.years)
    if order.size < 6:
        return None
    border = order[int(np.ceil(order.size * (1.0 - HELD_SHARE)))]
    early = data.part(data.years < border)
    late = data.part(data.years >= border)
    missing = set(np.unique(late.site).tolist()) - set(np.unique(early.site).tolist())
    if missing or len(early) < 4:
        return None
    made = next((one for one in causes(early) if one.name == cause.name), None)
    if made is None:
        return None
    found = fit(made, early, held=False)
    sd = np.sqrt(late.sd**2 + found.scatter_db**2)
    return float(np.mean(norm.logpdf(late.value, made.curve(found.values, late), sd)))


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


def _words(fitted: Sequence[FittedCause], tied: Sequence[Tie], bad: Sequence[BadDate], data: Differences) -> list[str]:
    """What is found, in sentences."""
    best = next(one for one in fitted if one.cause.physical)
    rivals = {one.cause.name: one for one in fitted if not one.cause.physical}
    mean = float(np.average(data.value, weights=1.0 / (data.sd**2 + best.scatter_db**2)))
    words = [
        f"{len(data)} values of {len(np.unique(data.site))} reflector(s) lie {mean:+.2f} dB off the prediction on "
        "average."
    ]
    values = ", ".join(
        f"{name.split(' [')[0]} {v:.3g} ({a:.3g} to {b:.3g}) {name.partition('[')[2].rstrip(']')}".strip()
        for name, v, a, b in zip(best.cause.parameters, best.values, best.low, best.high, strict=True)
    )
    words.append(
        f"Best alone: {best.cause.title}" + (f": {values}" if values else "") + f"; {best.scatter_db:.2f} dB are left "
        "from date to date."
    )
    if rivals["none"].bic <= best.bic:
        words.append("No cause is needed: none explains more than its parameters cost.")
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
            f"{len(bad)} values were set aside: the reflector was not seen, or lies far off its own level at that date."
        )
    return words
