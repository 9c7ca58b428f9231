"""The phase over slow time that gives rows the most contrast: a polynomial, or a spline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum, contrast, mean_contrast_and_slope
from warpsar.effects.base.slow_time import POWERS, spline

F64 = NDArray[np.float64]
KNOTS = 9
MOST_RAD, STEP_RAD = 30.0, 2.0
"""Quadratic phases at the aperture's ends at which fits may begin, and how far they lie apart: contrast has its peak
within about a radian."""
_STARTS = 2


@dataclass(frozen=True)
class PhaseFamily:
    """Phases that are sums of a few columns."""

    name: str
    columns: int
    aside: bool = False
    """Whether as many further coefficients change it with range, in proportion to `AzimuthSpectrum.aside`."""

    def basis(self, place: F64) -> F64:
        """(frequencies, columns), less what is linear in place: that moves the image and sharpens nothing."""
        if self.name != "spline":
            found = np.stack([place**k for k in POWERS[: self.columns]], axis=1)
        else:
            found = np.stack([spline(one)(place) for one in np.eye(KNOTS)[:, 1:-1].T], axis=1)
        line = np.stack([np.ones_like(place), place], axis=1)
        return np.asarray(found - line @ np.linalg.lstsq(line, found, rcond=None)[0])

    def phase(self, lines: AzimuthSpectrum, coefficients: F64) -> F64:
        """(frequencies,), or (rows, frequencies) where it changes with range [rad]."""
        basis = self.basis(lines.place)
        if not self.aside:
            return np.asarray(basis @ coefficients)
        same, other = np.split(np.asarray(coefficients), 2)
        return np.asarray(basis @ same + lines.aside[:, None] * (basis @ other))

    def back(self, lines: AzimuthSpectrum, slope: F64) -> F64:
        """The derivative with the coefficients of one with the phase: the adjoint of `phase`."""
        basis = self.basis(lines.place)
        if not self.aside:
            return np.asarray(basis.T @ slope)
        return np.concatenate([basis.T @ slope.sum(axis=0), basis.T @ (lines.aside @ slope)])

    def scale(self, lines: AzimuthSpectrum) -> F64:
        """What one radian of phase, rms, is of each coefficient."""
        one = np.sqrt((self.basis(lines.place) ** 2).mean(axis=0))
        if not self.aside:
            return np.asarray(one)
        return np.concatenate([one, one * max(float(np.sqrt((lines.aside**2).mean())), 1e-12)])


QUADRATIC = PhaseFamily("quadratic", 1)
POLYNOMIAL = PhaseFamily("polynomial", len(POWERS))
SPLINE = PhaseFamily("spline", KNOTS - 2)
MOTION = PhaseFamily("motion", len(POWERS), aside=True)


def fitted(lines: AzimuthSpectrum, family: PhaseFamily) -> F64:
    """The coefficients of the columns, (columns,), that give the rows the most contrast.

    Quadratic phases are tried first, as contrast has many maxima. L-BFGS goes on from the best ones, by the adjoint.
    """
    basis = family.basis(lines.place)
    square = QUADRATIC.basis(lines.place)[:, 0]
    tried = np.arange(-MOST_RAD, MOST_RAD + 0.5 * STEP_RAD, STEP_RAD)
    told = [float(contrast(lines, np.exp(-1j * q * square)).mean()) for q in tried]
    to_basis = np.linalg.lstsq(basis, square, rcond=None)[0]
    scale = family.scale(lines)
    to_basis = np.concatenate([to_basis, np.zeros(len(scale) - len(to_basis))])

    def cost(x: F64) -> tuple[float, F64]:
        value, slope = mean_contrast_and_slope(lines, family.phase(lines, x / scale))
        return -value, -family.back(lines, slope) / scale

    best = [tried[i] * to_basis * scale for i in np.argsort(told)[-_STARTS:]]
    found = [minimize(cost, x, jac=True, method="L-BFGS-B", options={"maxiter": 30}) for x in best]
    return np.asarray(min(found, key=lambda one: float(one.fun)).x / scale)


def weights_fitted(lines: AzimuthSpectrum, speckle: AzimuthSpectrum) -> F64:
    """The rival without physics: real weights exp(a polynomial) on the spectrum, with as many numbers as the polynomial
    of the phase; as a factor (frequencies,).

    They are even: uneven ones would move a defocused image, and more of a dark edge into the rows. What weights do to
    speckle is no contrast of the image, and is taken off.
    """
    basis = np.stack([lines.place ** (2 * k) for k in range(1, POLYNOMIAL.columns + 1)], axis=1)

    def factor(x: F64) -> F64:
        return np.asarray(np.exp(np.clip(basis @ x, -10.0, 10.0)))

    def cost(x: F64) -> float:
        return float(contrast(speckle, factor(x)).mean() - contrast(lines, factor(x)).mean())

    found = minimize(cost, np.zeros(POLYNOMIAL.columns), method="Powell", options={"maxiter": 2, "xtol": 0.05})
    return factor(found.x)
