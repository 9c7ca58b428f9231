"""What disturbs a measured curve: a background, and an error that goes with the amplitude.

The noise about a modelled amplitude a has the mean power s = background + share x |a|^2 + level. The background is
that of the range. The share holds all that multiplies: calibration that drifts, placing, and what the model itself
gets wrong in proportion. Both are fitted, unless a curve states them. They count the rows by independent directions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from warpsar.curves.likelihood import log_density, slopes
from warpsar.curves.observed import ObservedCurve

DB_TO_AMPLITUDE = 10.0 / np.log(10.0)  # dB for a relative change of power
_SHARES = (1e-6, 10.0)
_STARTS = ((1e-3, 1e-2), (1e-2, 1e-2), (1e-1, 3e-1), (1e-1, 1e-2))  # background over the mean power, share


@dataclass(frozen=True)
class Noise:
    """Levels that several curves of one polarization have in common."""

    background_m2: float
    share: float

    def power(self, one: ObservedCurve, model_m2: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mean power of the noise of each row [m2]; what the curve states goes before."""
        background = self.background_m2 if one.background_m2 is None else one.background_m2
        share = self.share if one.share is None else one.share
        found: NDArray[np.float64] = background + share * model_m2 + one.level_m2
        return found

    @property
    def error_db(self) -> float:
        """Standard deviation of the multiplicative error [dB], as far as it is small."""
        return float(DB_TO_AMPLITUDE * np.sqrt(2.0 * self.share))


def share_of(error_db: float) -> float:
    """The variance of the amplitude's relative error, for a standard deviation in dB: |1 + e|^2 varies by 2 Re e."""
    return 0.5 * (error_db / DB_TO_AMPLITUDE) ** 2


Noises = Mapping[str, Noise]
"""Noise by polarization: what a model lacks may be in one alone, as waves from edge to edge are in HH."""


@dataclass(frozen=True)
class Fit:
    """The likeliest noise, and the likeliest real factor of an offered term."""

    noise: Noises
    factor: float
    log_likelihood: float
    """Rows counted by independent directions."""


def densities(one: ObservedCurve, amplitude: NDArray[np.complex128], noise: Noise) -> NDArray[np.float64]:
    """ln p of each row, times the share of an independent direction that it stands for."""
    model = np.abs(amplitude) ** 2
    found: NDArray[np.float64] = one.weight * log_density(one.measured_m2, model, noise.power(one, model))
    return found


def fit(curves: Sequence[ObservedCurve], names: Sequence[str], offered: str | None = None) -> Fit:
    """Fit the noise about the sum of the terms `names`, and with it a real factor of one more term, `offered`."""
    loss = _Loss(curves, names, offered)
    count = len(loss.kinds)
    ends = [(np.log(1e-12), np.log(10.0)), (np.log(_SHARES[0]), np.log(_SHARES[1]))] * count
    best = None
    for factor in (0.0, 1.0) if offered else (0.0,):
        starts = [np.array([*np.log(levels * count), *([factor] if offered else [])]) for levels in _STARTS]
        bounds = [*ends, *([(-20.0, 20.0)] if offered else [])]
        start = min(starts, key=lambda x: loss(x)[0])
        found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
        if best is None or found.fun < best.fun:
            best = found
    assert best is not None
    return Fit(loss.noises(best.x), float(best.x[-1]) if offered else 0.0, -float(best.fun))


def fit_each(curves: Sequence[ObservedCurve], names: Sequence[str]) -> tuple[list[Noise], float]:
    """The likeliest noise of each curve by itself, and ln L of all.

    What a model leaves out is of the order of a wavelength in amplitude, and rays fail sooner where a body is small in
    wavelengths. So the noise about one frequency says little of that about another one.
    """
    found = [(one, fit([one], names)) for one in curves]
    return [each.noise[one.polarization] for one, each in found], float(sum(each.log_likelihood for _, each in found))


class _Loss:
    """-ln L and its slope. x: ln(background / mean power) and ln(share) of each polarization, then the factor."""

    def __init__(self, curves: Sequence[ObservedCurve], names: Sequence[str], offered: str | None) -> None:
        self.kinds = sorted({one.polarization for one in curves})
        more = [offered] if offered else []
        self.given = [(one, one.amplitude(names), one.amplitude(more)) for one in curves]
        self.mean = max(float(np.mean(np.concatenate([one.measured_m2 for one in curves]))), 1e-30)
        self.offered = offered is not None

    def noises(self, x: NDArray[np.float64]) -> dict[str, Noise]:
        return {
            kind: Noise(float(self.mean * np.exp(x[2 * k])), float(np.exp(x[2 * k + 1])))
            for k, kind in enumerate(self.kinds)
        }

    def __call__(self, x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        noises, factor = self.noises(x), x[-1] if self.offered else 0.0
        total, slope = 0.0, np.zeros(len(x))
        for one, base, more in self.given:
            noise, k = noises[one.polarization], 2 * self.kinds.index(one.polarization)
            amplitude = base + factor * more
            model = np.abs(amplitude) ** 2
            power = noise.power(one, model)
            total += float(one.weight @ log_density(one.measured_m2, model, power))
            to_model, to_noise = slopes(one.measured_m2, model, power)
            if one.background_m2 is None:
                slope[k] += one.weight @ to_noise * noise.background_m2
            if one.share is None:
                slope[k + 1] += one.weight @ (to_noise * model) * noise.share
            if self.offered:
                turn = 2.0 * (np.conj(amplitude) * more).real
                share = noise.share if one.share is None else one.share
                slope[-1] += one.weight @ ((to_model + share * to_noise) * turn)
        return -total, -slope
