"""Causes fitted together: which of them the earlier dates need, the later ones confirm, and what could stand for each.

Values are a sum of the causes' curves, and of three errors: clutter and noise (known), a scatter from value to value,
and a scatter from image to image that all reflectors of an image share. The two scatters are fitted, too.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear, minimize
from scipy.special import stdtrit

from warpsar.calibration.causes import Cause, Situation
from warpsar.calibration.chance import ModelledValues, TriedCause, chance_of_gain
from warpsar.calibration.differences import Differences
from warpsar.calibration.scatter import ErrorCovariance, ExtraScatter

F64 = NDArray[np.float64]
CONFIDENCE = 0.9
ALIKE = 2.0 * float(np.log(10.0))
"""BIC of the best plus this: odds of 10 to 1."""
HELD_SHARE = 1.0 / 3.0
"""Of the dates, the later ones, which confirm a cause or do not."""
FEWEST_DATES, FEWEST_EARLY = 6, 4
MOST_CAUSES, MOST_STEPS = 8, 24
REFITTED = 3
"""Of the candidates of a step, the best ones by a quick score, which are fitted with their own scatter."""
ROUGH = 10.0
"""What a quick score on a grid may miss of a fit."""
TOGETHER = 0.9
"""Two values whose errors are correlated by more are known together only."""
EARLY_CHANCE, UNTESTED_CHANCE = 0.05, 0.01
"""Of a gain as large by chance: for what later dates must confirm, and for what nothing tests."""
CONFIRMED = float(np.log(10.0))
"""Log-likelihood that a cause must add at later dates. Without the cause its likelihood ratio is 1 on average, as the
earlier dates have set its value; so it exceeds 10 in at most 1 of 10 cases (Markov's inequality)."""
WORDED = ("year of the step, from the first date",)
"""Parameters that a cause's title says already, as a date."""
UNCONFIRMED = "the earlier ones alone do not choose it, or the later ones do not confirm it"
SAME = 0.1
"""BIC by which two fits of one model may differ: their scatters are found to some hundredths."""
CausesOf = Callable[[Differences], list[Cause]]


@dataclass(frozen=True)
class CauseModel:
    """Causes whose curves are added. What two of them would say alike is said by the first one."""

    causes: tuple[Cause, ...]

    @cached_property
    def fixed(self) -> tuple[tuple[bool, ...], ...]:
        """Of each cause's parameters, which are held at their start, or at 0 where an earlier cause has that level."""
        taken: set[str] = set()
        found = []
        for cause in self.causes:
            held = [b <= a for a, b in zip(cause.low, cause.high, strict=True)]
            if cause.level is not None:
                if cause.level[0] in taken:
                    held[cause.level[1]] = True
                taken.add(cause.level[0])
            found.append(tuple(held))
        return tuple(found)

    def can_take(self, cause: Cause) -> bool:
        """Whether another cause says something that these do not."""
        return cause not in self.causes and not all(CauseModel((*self.causes, cause)).fixed[-1])

    @property
    def counted(self) -> int:
        """Parameters, those included that were found on the way (a step's date), without the scatters."""
        count = 0
        for cause, held in zip(self.causes, self.fixed, strict=True):
            count += sum(1 for k, h in enumerate(held) if not h or cause.high[k] <= cause.low[k])
        return count

    def full(self, free: F64) -> list[F64]:
        """Parameters of each cause."""
        found, at = [], 0
        for cause, held in zip(self.causes, self.fixed, strict=True):
            x = np.array(cause.start, np.float64)
            for k, h in enumerate(held):
                if not h:
                    x[k], at = free[at], at + 1
                elif cause.high[k] > cause.low[k]:
                    x[k] = 0.0
            found.append(x)
        return found

    def free(self, values: Sequence[F64]) -> F64:
        pairs = zip(values, self.fixed, strict=True)
        return np.array([x[k] for x, held in pairs for k, h in enumerate(held) if not h], np.float64)

    def bounds(self) -> tuple[F64, F64]:
        low, high = (self.free([np.array(getattr(c, side)) for c in self.causes]) for side in ("low", "high"))
        return low, high

    def curve(self, free: F64, data: Differences) -> F64:
        total = np.zeros(len(data))
        for cause, x in zip(self.causes, self.full(free), strict=True):
            total = total + cause.curve(x, data)
        return total


@dataclass(frozen=True)
class CauseFit:
    """A model at its best."""

    model: CauseModel
    free: F64
    covariance: F64
    scatter: ExtraScatter
    fitted: F64
    log_likelihood: float
    bic: float

    @property
    def values(self) -> list[F64]:
        return self.model.full(self.free)

    def error(self, data: Differences) -> F64:
        """Standard error of the curve at other values, (n,), by the error of the parameters to first order."""
        slopes = _slopes(self.model, data, self.free)
        return np.asarray(np.sqrt(np.maximum(((slopes @ self.covariance) * slopes).sum(axis=1), 0.0)), np.float64)


def fit_model(
    model: CauseModel, data: Differences, scatter: ExtraScatter | None = None, start: F64 | None = None
) -> CauseFit:
    """A model at its best, from a start that lies on the right hill (`Trials.best` finds one).

    Parameters by generalized least squares, scatters by restricted likelihood, in turns until both stand still."""
    low, high = model.bounds()
    free = model.free([np.array(c.start) for c in model.causes]) if start is None else start
    scatter = scatter or ExtraScatter(max(float(np.std(data.value)), data.least_scatter), 0.0)
    for _ in range(4):
        errors = ErrorCovariance(data, scatter)
        if free.size:
            free = _solved(model, data, errors, free, low, high)
        before = scatter
        scatter = _scatters(data, data.value - model.curve(free, data), _slopes(model, data, free), scatter)
        if max(abs(scatter.value - before.value), abs(scatter.image - before.image)) < 0.02 * data.least_scatter:
            break
    errors = ErrorCovariance(data, scatter)
    slopes = errors.whitened(_slopes(model, data, free)) if free.size else np.zeros((len(data), 0))
    covariance = _covariance(slopes)
    fitted = model.curve(free, data)
    likelihood = _log_likelihood(data.value - fitted, errors)
    counted = model.counted + 1 + (scatter.image > 0.0)
    return CauseFit(
        model, free, covariance, scatter, fitted, likelihood, counted * np.log(max(len(data), 2)) - 2.0 * likelihood
    )


def intervals(
    model: CauseModel, free: F64, covariance: F64, data: Differences, scatter: ExtraScatter
) -> list[tuple[Cause, F64, F64, F64]]:
    """Of each cause: its values, and both ends of their 90 % intervals; of what is held, the value itself.

    By Student's t, as the scatters come from the same values: from as many images where images scatter. Clutter's part
    is known (Satterthwaite)."""
    groups = np.unique(data.image).size if scatter.image else len(data)
    known = float(np.median(data.sd**2)) / (scatter.value**2 + scatter.image**2)
    freedom = max(groups - free.size, 1) * (1.0 + known) ** 2
    t, made = float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE)), []
    errors = model.full(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    for cause, x, held, error in zip(model.causes, model.full(free), model.fixed, errors, strict=True):
        reach = np.where(held, 0.0, t * error)
        made.append((cause, x, np.maximum(x - reach, cause.low), np.minimum(x + reach, cause.high)))
    return made


def _covariance(white_slopes: F64) -> F64:
    return np.asarray(np.linalg.pinv(white_slopes.T @ white_slopes, rcond=1e-8), np.float64)


def _log_likelihood(residual: F64, errors: ErrorCovariance) -> float:
    white = errors.whitened(residual)
    return -0.5 * float(white @ white + errors.log_determinant + residual.size * np.log(2.0 * np.pi))


def _solved(model: CauseModel, data: Differences, errors: ErrorCovariance, free: F64, low: F64, high: F64) -> F64:
    if all(cause.linear for cause in model.causes):
        at_zero = model.curve(np.zeros(free.size), data)
        columns = np.stack([model.curve(one, data) - at_zero for one in np.eye(free.size)], axis=-1)
        design, target = errors.whitened(columns), errors.whitened(data.value - at_zero)
        solution = np.linalg.lstsq(design, target, rcond=None)[0]
        if not ((solution < low) | (solution > high)).any():
            return np.asarray(solution, np.float64)
        return np.asarray(lsq_linear(design, target, (low, high)).x, np.float64)

    def misfit(x: F64) -> F64:
        return errors.whitened(data.value - model.curve(x, data))

    inside = np.clip(free, low + 1e-9, high - 1e-9)
    found = least_squares(misfit, inside, bounds=(low, high), x_scale="jac", max_nfev=40)
    return np.asarray(found.x, np.float64)


def _slopes(model: CauseModel, data: Differences, free: F64) -> F64:
    low, high = model.bounds()
    found = np.zeros((len(data), free.size))
    for k in range(free.size):
        step = 1e-4 * max(abs(free[k]), 1.0)
        up, down = free.copy(), free.copy()
        up[k], down[k] = min(free[k] + step, high[k]), max(free[k] - step, low[k])
        found[:, k] = (model.curve(up, data) - model.curve(down, data)) / (up[k] - down[k])
    return found


def _scatters(data: Differences, residual: F64, slopes: F64, start: ExtraScatter) -> ExtraScatter:
    """Restricted maximum likelihood of both scatters; that of images needs images with several reflectors."""
    shared = np.bincount(data.image).max(initial=0) > 1 and np.unique(data.image).size > 2
    least = data.least_scatter

    def cost(x: F64) -> float:
        errors = ErrorCovariance(data, ExtraScatter(float(np.hypot(x[0], least)), abs(float(x[1])) if shared else 0.0))
        white = errors.whitened(residual)
        total = float(white @ white) + errors.log_determinant
        if slopes.shape[1]:
            design = errors.whitened(slopes)
            total += float(np.log(np.maximum(np.linalg.eigvalsh(design.T @ design), 1e-12)).sum())
        return total

    at = np.array([np.sqrt(max(start.value**2 - least**2, 0.0)) + 0.1 * least, start.image + 0.1 * least])
    found = minimize(
        cost, at if shared else at[:1], method="Nelder-Mead", options={"xatol": 0.01 * least, "fatol": 0.01}
    )
    image = abs(float(found.x[1])) if shared else 0.0
    return ExtraScatter(float(np.hypot(found.x[0], least)), image if image > 0.05 * least else 0.0)


# ---- which causes ----


class Trials:
    """Causes that may be added to a model, with quick scores: what each would make of the misfit at its best.

    A cause that is linear in its parameters is projected; of one that is not, curves over a grid of parameters are
    tried. What the model has already is free to move, to first order.
    """

    def __init__(self, data: Differences, causes: Sequence[Cause]) -> None:
        self.data = data
        self.causes = [cause for cause in causes if cause.physical]
        self.rivals = [cause for cause in causes if not cause.physical]
        self._slopes: dict[tuple[str, tuple[float, ...]], F64] = {}
        self._searched: dict[str, list[F64]] = {}
        self._curves: dict[str, F64] = {}

    def without(self, name: str) -> None:
        """Try a cause no more."""
        self.causes = [cause for cause in self.causes if cause.name != name]

    def best(
        self, model: CauseModel, free: F64, scatter: ExtraScatter, causes: Sequence[Cause] | None = None
    ) -> list[tuple[float, CauseModel, F64]]:
        """Squared misfit plus parameters times ln n, the model with the cause, and a start for its fit; best first."""
        data, errors = self.data, ErrorCovariance(self.data, scatter)
        residual = errors.whitened(data.value - model.curve(free, data))
        own = errors.whitened(_slopes(model, data, free)) if free.size else np.zeros((len(data), 0))
        basis = np.linalg.qr(own)[0]
        left = residual - basis @ (basis.T @ residual)
        found = []
        for cause in self.causes if causes is None else causes:
            if not model.can_take(cause):
                continue
            more = CauseModel((*model.causes, cause))
            held = np.array(more.fixed[-1])
            if cause.grid:
                curves = errors.whitened(self._curves_of(cause))
                rest = left[:, None] - (curves - basis @ (basis.T @ curves))
                misfits = (rest**2).sum(axis=0)
                k = int(misfits.argmin())
                misfit, x, taken = float(misfits[k]), np.array(cause.grid[k]), curves[:, k]
            else:
                columns = errors.whitened(self._slopes_of(cause))[:, ~held]
                kept = columns - basis @ (basis.T @ columns)
                step = np.linalg.lstsq(kept, left, rcond=None)[0]
                x, low, high = (np.array(getattr(cause, each), np.float64) for each in ("start", "low", "high"))
                if cause.linear:
                    x[~held] = 0.0
                step = np.clip(x[~held] + step, low[~held], high[~held]) - x[~held]
                misfit, taken = float(((left - kept @ step) ** 2).sum()), columns @ step
                x[~held] += step
            moved = np.linalg.lstsq(own, residual - taken, rcond=None)[0] if free.size else free
            start = np.concatenate([free + moved, x[~held]])
            found.append((misfit + more.counted * np.log(len(data)), more, start))
        return sorted(found, key=lambda one: round(one[0], 6))  # of equal ones the first that is listed

    def directions(self, model: CauseModel) -> list[TriedCause]:
        """What its last cause frees, to first order: of a step once for each date at which it may be."""
        cause, held = model.causes[-1], np.array(model.fixed[-1])
        counted = model.counted - CauseModel(model.causes[:-1]).counted
        return [TriedCause(slopes[:, ~held], counted) for slopes in self._searched_of(cause)]

    def _searched_of(self, cause: Cause) -> list[F64]:
        if cause.name not in self._searched:
            found = [self._slopes_of(replace(cause, start=(*cause.start[:-1], place))) for place in cause.places]
            self._searched[cause.name] = found or [self._slopes_of(cause)]
        return self._searched[cause.name]

    def _curves_of(self, cause: Cause) -> F64:
        if cause.name not in self._curves:
            self._curves[cause.name] = np.stack([cause.curve(np.array(x), self.data) for x in cause.grid], axis=-1)
        return self._curves[cause.name]

    def _slopes_of(self, cause: Cause) -> F64:
        key = cause.name, cause.start
        if key not in self._slopes:
            x, found = np.array(cause.start, np.float64), []
            for k in range(x.size):
                step = np.where(np.arange(x.size) == k, 1e-4 * max(abs(x[k]), 1.0), 0.0)
                found.append((cause.curve(x + step, self.data) - cause.curve(x - step, self.data)) / (2.0 * step[k]))
            self._slopes[key] = np.stack(found, axis=-1)
        return self._slopes[key]


def fits_alone(trials: Trials) -> dict[str, CauseFit]:
    """Of each cause by itself, and of each rival, by name."""
    data, bare = trials.data, fit_model(CauseModel(()), trials.data)
    found = {}
    for cause in trials.rivals + trials.causes:
        started = trials.best(bare.model, bare.free, bare.scatter, [cause])
        model, start = started[0][1:] if started else (CauseModel((cause,)), None)
        found[cause.name] = fit_model(model, data, bare.scatter, start)
    return found


@dataclass(frozen=True)
class JointCause:
    """A cause among others, with 90 % intervals in which the others are free, too, and may be what stands for them."""

    cause: Cause
    values: F64
    low: F64
    high: F64
    given_low: F64
    given_high: F64
    """The interval if the other causes are those that are named: it does not hold where one of them is another one."""
    gain: float
    """Log-likelihood of all dates that it adds to the other causes."""
    held_gain: float | None
    """Log-likelihood that it adds to the other confirmed causes at the later dates, which did not choose it; None where
    none were held back, or the earlier dates did not choose it, or the later ones did not confirm it."""
    held_error: float | None
    """Standard error of that, by the scatter over images."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        ends = self.low, self.high, self.given_low, self.given_high
        keys = "value", "low", "high", "given_low", "given_high"
        rows = zip(self.values, *ends, strict=True)
        numbers = [dict(zip(keys, map(float, values), strict=True)) for values in rows]
        return {
            "cause": self.cause.name,
            "title": self.cause.title,
            "parameters": dict(zip(self.cause.parameters, numbers, strict=True)),
            "gain": self.gain,
            "held_gain": self.held_gain,
            "held_error": self.held_error,
        }


@dataclass(frozen=True)
class Stand:
    """A cause that could stand for another one in the model: these data do not tell them apart."""

    cause: str
    other: str
    bic: float
    """More than with the cause itself."""
    decided_by: str
    apart: float
    """How far apart both models then are, in the unit of the values."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "causes": [self.cause, self.other], "bic": self.bic, "decided_by": self.decided_by, "apart": self.apart,
        }  # fmt: skip


@dataclass(frozen=True)
class JointFit:
    """What was found together."""

    causes: tuple[JointCause, ...]
    stands: tuple[Stand, ...]
    together: tuple[tuple[str, str, float], ...]
    """Pairs of parameters whose errors are correlated, and by how much."""
    scatter: ExtraScatter
    fit: CauseFit = field(repr=False)
    without: float
    """BIC without any cause, less that of the model."""
    held_dates: int
    """How many of the later dates were held back; 0 where there are too few."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "causes": [one.content() for one in self.causes],
            "tied": [one.content() for one in self.stands],
            "known_together": [{"parameters": [a, b], "correlation": c} for a, b, c in self.together],
            "scatter": self.scatter.value,
            "image_scatter": self.scatter.image,
            "bic_over_none": self.without,
            "held_dates": self.held_dates,
            "intervals": "low to high: over all that could stand for the other causes; given_low to given_high: if "
            "the others are those that are named",
        }


def joint(
    data: Differences,
    causes_of: CausesOf,
    situations: Sequence[Situation] = (),
    trials: tuple[Trials, Trials | None] | None = None,
) -> JointFit:
    """Causes that act together, chosen one after the other.

    A step takes the cause that lowers the earlier dates' BIC the most, if made-up values without it gain as much by any
    cause in at most `EARLY_CHANCE` of the cases (`chance_of_gain`). It stays only if the later dates, which had no say
    in that, become more likely by `CONFIRMED`. Then each cause that was chosen before is asked again, beside all others
    (`asked_again`). What only all dates together need is added afterwards, at `UNTESTED_CHANCE`, and has no
    `held_gain`. All is then fitted to all dates, where each cause is asked once more. `trials`: of all dates and of the
    earlier ones, where they are there.
    """
    early, late = halves(data)
    chosen: dict[str, F64] = {}
    tested: dict[str, tuple[float, float]] = {}
    if early is not None and late is not None:
        first = trials[1] if trials is not None and trials[1] is not None else Trials(early, causes_of(early))
        chosen, tested = _confirmed(first, late)
    every = trials[0] if trials is not None else Trials(data, causes_of(data))
    model = CauseModel(tuple(cause for name in chosen for cause in every.causes if cause.name == name))
    start = model.free([chosen[cause.name] for cause in model.causes])
    fit = fit_model(model, data, start=start)
    bare = fit if not model.causes else fit_model(CauseModel(()), data)

    def needed(step: Addition) -> bool:
        return step.chance <= (EARLY_CHANCE if step.cause.name in tested else UNTESTED_CHANCE)

    fit = asked_again(fit, fit.model.causes, every, needed, tested)
    for _ in range(MOST_STEPS):
        step = best_addition(fit, every)
        if step is None or not needed(step) or len(fit.model.causes) >= MOST_CAUSES:
            break
        fit = asked_again(step.after, fit.model.causes, every, needed, tested)
    stands, others = _stands(fit, every, situations)
    found = []
    for cause, x, low, high in intervals(fit.model, fit.free, fit.covariance, data, fit.scatter):
        held_gain, held_error = tested.get(cause.name, (None, None))
        gain = fit.log_likelihood - _without(fit, cause, data).log_likelihood
        ends = [(a, b) for each in others for c, _, a, b in each if c is cause]
        lowest = np.min([low, *(np.where(b > a, a, low) for a, b in ends)], axis=0)
        highest = np.max([high, *(np.where(b > a, b, high) for a, b in ends)], axis=0)
        found.append(JointCause(cause, x, lowest, highest, low, high, gain, held_gain, held_error))
    return JointFit(
        tuple(found), tuple(stands), tuple(_together(fit)),
        fit.scatter, fit, bare.bic - fit.bic, 0 if late is None else int(np.unique(late.days).size),
    )  # fmt: skip


def halves(data: Differences) -> tuple[Differences | None, Differences | None]:
    """Earlier and later dates; None where those are too few, or do not have the same reflectors."""
    days = data.days
    order = np.unique(days)
    if order.size < FEWEST_DATES:
        return None, None
    border = order[int(np.ceil(order.size * (1.0 - HELD_SHARE)))]
    early, late = data.part(days < border), data.part(days >= border)
    if len(early) < FEWEST_EARLY or set(late.site.tolist()) - set(early.site.tolist()):
        return None, None
    return early, late


def _confirmed(trials: Trials, late: Differences) -> tuple[dict[str, F64], dict[str, tuple[float, float]]]:
    """Causes that the earlier dates choose and the later ones confirm, with their values, and what each adds there."""
    fit = fit_model(CauseModel(()), trials.data)

    def needed(step: Addition) -> bool:
        return float(_held_gains(step.before, step.after, late).sum()) > CONFIRMED and step.chance <= EARLY_CHANCE

    for _ in range(MOST_STEPS):
        step = best_addition(fit, trials)
        if step is None or step.chance > EARLY_CHANCE or len(fit.model.causes) >= MOST_CAUSES:
            break
        if needed(step):
            fit = asked_again(step.after, fit.model.causes, trials, needed)
        else:  # it is tried no more on these dates: others like it would be confirmed by chance
            trials.without(step.cause.name)
    found = {}
    for cause in fit.model.causes:
        gained = _held_gains(_without(fit, cause, trials.data), fit, late)
        error = float(np.sqrt(gained.size) * gained.std(ddof=1)) if gained.size > 1 else float("nan")
        found[cause.name] = float(gained.sum()), error
    return {cause.name: x for cause, x in zip(fit.model.causes, fit.values, strict=True)}, found


def _held_gains(before: CauseFit, after: CauseFit, late: Differences) -> F64:
    """Log-likelihood that a cause adds at each image of other dates.

    Under one scatter, which holds what neither has: else a cause is denied for another one that is missing."""
    return by_image(after, late, before.scatter) - by_image(before, late, before.scatter)


def by_image(fit: CauseFit, late: Differences, scatter: ExtraScatter | None = None) -> F64:
    """Log-likelihood of each image of other dates, less what 2 pi adds; under the fit's own scatter, or that."""
    residual = late.value - fit.model.curve(fit.free, late)
    errors = ErrorCovariance(late, scatter or fit.scatter)
    white = errors.whitened(residual) ** 2 + np.log(errors.diagonal)
    shared = np.log1p(errors.shared * errors.inverse_sum)
    images = np.unique(late.image)
    return -0.5 * (np.bincount(late.image, white, errors.count) + shared)[images]


@dataclass(frozen=True)
class Addition:
    """A fit, the same with a cause more, and all additions that were tried."""

    before: CauseFit
    after: CauseFit
    cause: Cause
    trials: Trials = field(repr=False)
    tried: tuple[CauseModel, ...] = field(repr=False)

    @cached_property
    def chance(self) -> float:
        """That values without the cause gain as much by the best of all that was tried."""
        data = self.trials.data
        pairs = [
            ModelledValues(data.value - one.fitted, _slopes(one.model, data, one.free))
            for one in (self.before, self.after)
        ]
        tried = [each for model in self.tried for each in self.trials.directions(model)]
        counted = self.after.model.counted - self.before.model.counted
        return chance_of_gain(data, self.before.scatter, pairs[0], pairs[1], counted, tried)


def best_addition(fit: CauseFit, trials: Trials) -> Addition | None:
    """The model with one cause more that has the lowest BIC; None where BIC rises."""
    scored = trials.best(fit.model, fit.free, fit.scatter)
    fits = [fit_model(model, trials.data, fit.scatter, start) for _, model, start in scored[:REFITTED]]
    best = min(fits, key=lambda one: round(one.bic, 6), default=fit)
    if best.bic >= fit.bic:
        return None
    return Addition(fit, best, best.model.causes[-1], trials, tuple(model for _, model, _ in scored))


def _without(fit: CauseFit, cause: Cause, data: Differences) -> CauseFit:
    """At its best without a cause."""
    model, start = _less(fit, cause)
    return fit_model(model, data, fit.scatter, start)


def _less(fit: CauseFit, cause: Cause) -> tuple[CauseModel, F64]:
    """The model without a cause, and a start."""
    kept = [(c, x) for c, x in zip(fit.model.causes, fit.values, strict=True) if c is not cause]
    model = CauseModel(tuple(c for c, _ in kept))
    return model, model.free([x for _, x in kept])


def asked_again(
    fit: CauseFit,
    causes: Sequence[Cause],
    trials: Trials,
    needed: Callable[[Addition], bool],
    tested: Collection[str] = (),
) -> CauseFit:
    """Each of these causes of the fit as if it were the last one to be added, with the others free.

    What the others have made needless goes. Where another cause in its place has a lower BIC, that one takes it, but
    not the place of one that later dates have `tested`.
    """
    for cause in causes:
        kept = _without(fit, cause, trials.data)
        best = best_addition(kept, trials)
        if best is None:
            fit = kept
            continue
        better = best.cause is not cause and best.after.bic < fit.bic - SAME
        if better and cause.name not in tested and needed(best):
            fit = best.after
        elif not needed(replace(best, after=fit, cause=cause)):
            fit = kept
    return fit


def _stands(
    fit: CauseFit, trials: Trials, situations: Sequence[Situation]
) -> tuple[list[Stand], list[list[tuple[Cause, F64, F64, F64]]]]:
    """What could stand for each cause, the other causes being fitted anew; and those other causes' intervals then."""
    found, others = [], []
    data, errors = trials.data, ErrorCovariance(trials.data, fit.scatter)

    def cost(model: CauseModel, free: F64) -> float:
        misfit = float((errors.whitened(data.value - model.curve(free, data)) ** 2).sum())
        return misfit + model.counted * float(np.log(len(data)))

    base = cost(fit.model, fit.free)
    for cause in fit.model.causes:
        kept, start = _less(fit, cause)
        start = _solved(kept, data, errors, start, *kept.bounds()) if start.size else start
        for score, model, free in trials.best(kept, start, fit.scatter):
            other = model.causes[-1]
            if other.name == cause.name or score > base + ALIKE + ROUGH:
                continue
            free = _solved(model, data, errors, free, *model.bounds())
            more = cost(model, free) - base
            if more > ALIKE:
                continue
            apart, best = 0.0, ""
            for situation in situations:
                off = abs(_at(fit.model, fit.free, situation) - _at(model, free, situation))
                if off > apart + 1e-6:
                    apart, best = off, situation.words
            found.append(Stand(cause.name, other.name, more, best, apart))
            covariance = _covariance(errors.whitened(_slopes(model, data, free)))
            others.append(intervals(model, free, covariance, data, fit.scatter))
    return sorted(found, key=lambda one: one.bic), others


def _at(model: CauseModel, free: F64, situation: Situation) -> float:
    return sum(cause.at(x, situation) for cause, x in zip(model.causes, model.full(free), strict=True))


def _together(fit: CauseFit) -> list[tuple[str, str, float]]:
    """Pairs of parameters that are known together only."""
    names = [
        f"{cause.name}: {name}"
        for cause, held in zip(fit.model.causes, fit.model.fixed, strict=True)
        for name, h in zip(cause.parameters, held, strict=True)
        if not h
    ]
    sd = np.sqrt(np.maximum(np.diag(fit.covariance), 1e-30))
    correlation = fit.covariance / sd[:, None] / sd
    return [
        (names[i], names[k], float(correlation[i, k]))
        for i in range(len(names))
        for k in range(i + 1, len(names))
        if abs(correlation[i, k]) > TOGETHER
    ]


def values_words(cause: Cause, values: F64, low: F64, high: F64) -> str:
    """Parameters with intervals."""
    words = []
    for name, v, a, b in zip(cause.parameters, values, low, high, strict=True):
        if b <= a and (v == 0.0 or name in WORDED):
            continue
        title, _, unit = name.partition(" [")
        ends = f" ({a:.3g} to {b:.3g})" if b > a else ""
        words.append(f"{title} {v if abs(v) > 1e-9 else 0.0:.3g}{ends} {unit.rstrip(']')}".rstrip())
    return ", ".join(words)


def together_words(found: JointFit, unit: str = "dB") -> list[str]:
    """What acts together, and how well it is known."""
    if not found.causes:
        return ["Together: no cause is needed."]
    words = []
    for one in found.causes:
        tested = "seen in all dates together only: "
        tested += UNCONFIRMED if found.held_dates else "they are too few to hold some back"
        if one.held_gain is not None:
            tested = f"the {found.held_dates} later dates confirm it (ln L {one.held_gain:+.1f})"
        words.append(f"{one.cause.title} ({values_words(one.cause, one.values, one.low, one.high)}; {tested})")
    spread = f"{found.scatter.value:.2f} {unit} are left from value to value"
    spread += f", {found.scatter.image:.2f} {unit} from image to image" if found.scatter.image else ""
    sentences = ["Together: " + "; ".join(words) + f". {spread}."]
    for name in dict.fromkeys(stand.cause for stand in found.stands):
        by: dict[str, list[str]] = {}
        for stand in found.stands:
            if stand.cause == name:
                by.setdefault(stand.decided_by or "nothing that is known", []).append(stand.other)
        others = "; ".join(f"{', '.join(some)} (decided by {what})" for what, some in by.items())
        sentences.append(f"For {name} could stand: {others}.")
    return sentences
