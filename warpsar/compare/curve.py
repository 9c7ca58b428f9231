"""A measured curve of radar cross-section beside its model, and what is left of the curves of one role."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc, ndtri

from warpsar.compare.contract import ROLES
from warpsar.curves import metrics, rivals
from warpsar.curves.likelihood import distribution
from warpsar.curves.noise import Noise, Noises, densities, fit
from warpsar.curves.observe import observe
from warpsar.curves.observed import ObservedCurve, independent
from warpsar.errors import InputError
from warpsar.scene.scene import Scene

PEAK_DB = 80.0  # how far under a curve's peak values still count: the Austin suite's measure
ERROR_RATE = 0.005  # chance that curves of a right model are said to scatter otherwise than their noise
LEVEL_MATTERS = 0.25  # of the mean deviance: noise is a fit to few directions
FEWEST = 20.0  # independent directions; with fewer the mean deviance is not told to a third
TAIL = 1e-12  # chances beyond which a residual is cut off: 7 standard deviations

NOISY = 0.2  # share of the power that a fitted noise may hold; a multiplicative error of 3 dB holds so much

CurveFinding = Literal["no physics needed", "noise", "level"]


@dataclass(frozen=True, eq=False)
class CurveComparison:
    """One measured curve beside the sum of some `terms` of its model; arrays of shape (n,), a row for each direction.

    `noise` is that of the train curves of its polarization, or what the curve states. Rows count for their share of an
    independent direction (`seen.weight`).
    """

    seen: ObservedCurve
    terms: tuple[str, ...]
    noise: Noise

    @property
    def name(self) -> str:
        return self.seen.name

    @property
    def role(self) -> str:
        return self.seen.role

    @property
    def polarization(self) -> str:
        return self.seen.polarization

    @property
    def measured(self) -> NDArray[np.float64]:
        """RCS [m2]."""
        return self.seen.measured_m2

    @cached_property
    def simulated(self) -> NDArray[np.float64]:
        """RCS of the model [m2]."""
        return np.asarray(np.abs(self.seen.amplitude(self.terms)) ** 2)

    @cached_property
    def residual(self) -> NDArray[np.float64]:
        """Normal scores: the standard normal number that is exceeded as often as the measured power is.

        Powers have the density of Rice, so this is the residual that a right model makes standard normal.
        """
        chance = distribution(self.measured, self.simulated, self.noise.power(self.seen, self.simulated))
        return np.asarray(ndtri(np.clip(chance, TAIL, 1.0 - TAIL)))

    @property
    def scaled_deviance(self) -> NDArray[np.float64]:
        return self.residual**2

    @cached_property
    def log_likelihood(self) -> float:
        """ln L, rows counted by independent directions."""
        return float(densities(self.seen, self.seen.amplitude(self.terms), self.noise).sum())

    @cached_property
    def without_physics(self) -> dict[str, NDArray[np.float64]]:
        """RCS [m2] of a constant level and of a smooth curve, fitted to this very curve."""
        found = {"null": rivals.constant([self.seen]), "smooth": rivals.smooth([self.seen])}
        return {name: rival.model_m2[0] for name, rival in found.items()}

    @property
    def _low_db(self) -> float:
        """What counts of the curve lies above this [dBsm]."""
        return float(metrics.decibels(self.measured).max()) - PEAK_DB

    def _error_db(self, power: NDArray[np.float64]) -> float:
        return metrics.error_db(self.measured, power, self._low_db)

    @property
    def error_db(self) -> float:
        """Mean abs(dB) of the model."""
        return self._error_db(self.simulated)

    def content(self) -> dict[str, Any]:
        """Its entry in the JSON files."""
        beside = {"model": self.simulated, **self.without_physics}
        weight = self.seen.weight
        return {
            "name": self.name,
            "role": self.role,
            "frequency_hz": self.seen.frequency_hz,
            "polarization": self.polarization,
            "directions": len(self.measured),
            "independent_directions": float(weight.sum()),
            "error_db": {name: self._error_db(power) for name, power in beside.items()},
            "correlation": metrics.correlation(self.measured, self.simulated, self._low_db),
            "level_db": metrics.level_db(self.measured, self.simulated),
            "deviance": float(weight @ self.scaled_deviance / weight.sum()),
            **({} if self.seen.fitted_level_db is None else {"fitted_level_db": self.seen.fitted_level_db}),
        }


def compare_curves(
    scene: Scene, *, cache: Path | None = None, device: str | None = None, terms: Sequence[str] | None = None
) -> list[CurveComparison]:
    """Every curve of a scene beside its model with `terms`, else those of `[radar] terms`; none for a scene without.

    `cache` is the folder that keeps the engine's amplitudes.
    """
    return curves_beside(observe(scene, cache=cache, device=device), scene.radar.terms if terms is None else terms)


def curves_beside(curves: Sequence[ObservedCurve], terms: Sequence[str]) -> list[CurveComparison]:
    """Measured curves beside the sum of some terms, with the noise of the train curves; of all where none is for
    training."""
    if not curves:
        return []
    noise = noise_of(curves, terms)
    # a polarization that no train curve has is judged by the noise of the first one that has
    first = next(iter(noise.values()))
    return [CurveComparison(one, tuple(terms), noise.get(one.polarization, first)) for one in curves]


def noise_of(curves: Sequence[ObservedCurve], terms: Sequence[str]) -> Noises:
    """The noise about the train curves; about all where none is for training."""
    return fit([one for one in curves if one.role == "train"] or list(curves), terms).noise


def content_of(compared: Sequence[CurveComparison]) -> dict[str, Any]:
    """What the JSON files say of curves beside one model: each curve, and the noise of each polarization."""
    noise = {
        one.polarization: {
            "background_dbsm": float(metrics.decibels(np.array(one.noise.background_m2))),
            "error_db": one.noise.error_db,
        }
        for one in compared
    }
    return {"curves": [one.content() for one in compared], "noise": noise}


@dataclass(frozen=True)
class CurveJudgement:
    """What is left of the curves of one role.

    `deviance`: mean squared residual by independent directions; 1 where model and noise are right, with the standard
    error `deviance_error`. `p_level`: chance of one so far from 1. `noise_share`: of the mean power, what fitted noise
    makes of it; 0 where the curves state theirs. `over`: 2 ln L of the model over each rival that knows no physics and
    is fitted to these very curves; a rival's parameter costs ln(independent directions).
    """

    findings: list[CurveFinding]
    deviance: float
    deviance_error: float
    p_level: float
    directions: float
    noise_share: float
    over: dict[str, float]

    @property
    def wrong(self) -> bool:
        return bool(self.findings)

    @property
    def words(self) -> str:
        level = f"deviance {self.deviance:.2f} +- {self.deviance_error:.2f} over {self.directions:.0f} directions"
        if not self.findings:
            few = self.directions < FEWEST
            return f"{'too few directions to tell more' if few else 'nothing but noise is found'}; {level}"
        sentences = []
        if "no physics needed" in self.findings:
            rival = min(self.over, key=lambda name: self.over[name])
            sentences.append(f"a {rival} explains them as well, without physics (2 ln L {self.over[rival]:.0f})")
        if "noise" in self.findings:
            sentences.append(f"{100.0 * self.noise_share:.0f} % of their power are left to the noise")
        if "level" in self.findings:
            sentences.append("the noise of the train curves does not explain the residual")
        return "; ".join([*sentences, level])

    def content(self) -> dict[str, Any]:
        return {**asdict(self), "words": self.words}


def judge_curves(compared: Sequence[CurveComparison]) -> CurveJudgement:
    """The judgement of the curves of one role. Raises InputError without any."""
    if not compared:
        raise InputError("curves: found none to judge; must have one")
    seen = [one.seen for one in compared]
    count = independent(seen)
    deviance = float(sum(one.seen.weight @ one.scaled_deviance for one in compared)) / count
    error = float(np.sqrt(2.0 / count))  # the square of a standard normal number has the variance 2
    off = max(abs(deviance - 1.0) - LEVEL_MATTERS, 0.0) / error
    p_level = float(erfc(off / np.sqrt(2.0))) if count >= FEWEST else 1.0
    own = sum(one.log_likelihood for one in compared)
    over = {
        rival.name: 2.0 * (own - rival.fitted.log_likelihood) + rival.parameters * float(np.log(count))
        for rival in (rivals.constant(seen), rivals.smooth(seen))
    }
    usable = [one for one in compared if one.seen.share is None or one.seen.background_m2 is None]
    noise, power = (
        sum(float(one.seen.weight @ each(one)) for one in usable)
        for each in (lambda one: one.noise.power(one.seen, one.simulated), lambda one: one.measured)
    )
    noise_share = noise / power if usable else 0.0
    findings: list[CurveFinding] = []
    if min(over.values()) <= 0.0:
        findings.append("no physics needed")
    if noise_share > NOISY:
        findings.append("noise")
    if p_level < ERROR_RATE:
        findings.append("level")
    return CurveJudgement(findings, deviance, error, p_level, count, noise_share, over)


def curve_verdicts(compared: Sequence[CurveComparison]) -> dict[str, CurveJudgement]:
    """The judgement of the curves of each role; none for a role without curves."""
    by_role = {role: [one for one in compared if one.role == role] for role in ROLES}
    return {role: judge_curves(part) for role, part in by_role.items() if part}


def errors_in_short(compared: Sequence[CurveComparison]) -> str:
    """One line: mean abs(dB) of the train and the test curves."""
    words = []
    for role in ROLES:
        errors = [one.error_db for one in compared if one.role == role]
        words += [f"{role} curves {np.mean(errors):.2f} dB"] if errors else []
    return ", ".join(words)
