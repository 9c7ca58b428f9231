"""The phase over slow time that gives rows the most contrast: a polynomial, or a spline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter
from scipy.optimize import minimize

from warpsar.diagnosis.phase.spectrum import AzimuthSpectrum, contrast, corrected, mean_contrast_and_slope
from warpsar.effects.base.slow_time import POWERS, spline

F64 = NDArray[np.float64]
KNOTS = 9
MOST_RAD, MOST_ASIDE_RAD, STEP_RAD = 30.0, 20.0, 1.0
"""Quadratic phases at the aperture's ends at which fits may begin: those that all ranges share, those that go with
`AzimuthSpectrum.aside`, and how far they lie apart. Contrast has its peak within about a radian."""
_STARTS = 2
_CURVATURE_RAD = 0.2
"""Over which slopes are compared, rms over the aperture."""


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
        basis, stretch = self.basis(lines.place), self._stretch(lines)
        if not self.aside and stretch is None:
            return np.asarray(basis @ coefficients)
        same, other = np.split(np.asarray(coefficients), 2) if self.aside else (coefficients, np.zeros(self.columns))
        of_rows = same + lines.aside[:, None] * other
        return np.asarray((of_rows if stretch is None else of_rows * stretch) @ basis.T)

    def back(self, lines: AzimuthSpectrum, slope: F64) -> F64:
        """The derivative with the coefficients of one with the phase: the adjoint of `phase`."""
        if slope.ndim == 1:
            return np.asarray(self.basis(lines.place).T @ slope)
        return np.asarray(self.back_of_rows(lines, slope).sum(axis=0))

    def back_of_rows(self, lines: AzimuthSpectrum, slope: F64) -> F64:
        """What each row adds to it, (rows, coefficients), of a `slope` (rows, frequencies)."""
        each, stretch = slope @ self.basis(lines.place), self._stretch(lines)
        each = each if stretch is None else each * stretch
        return np.concatenate([each, lines.aside[:, None] * each], axis=1) if self.aside else each

    def _stretch(self, lines: AzimuthSpectrum) -> F64 | None:
        """What `AzimuthSpectrum.stretch` makes of each column, (rows, columns): of x^k its k-th power, beside a part
        that is linear. A spline is taken to be the same at all ranges."""
        if self.name == "spline" or not lines.stretched:
            return None
        return np.asarray(lines.stretch[:, None] ** np.array(POWERS[: self.columns]))

    def scale(self, lines: AzimuthSpectrum) -> F64:
        """What one radian of phase, rms, is of each coefficient."""
        one = np.sqrt((self.basis(lines.place) ** 2).mean(axis=0))
        if not self.aside:
            return np.asarray(one)
        return np.concatenate([one, one * max(float(np.sqrt((lines.aside**2).mean())), 1e-12)])


QUADRATIC = PhaseFamily("quadratic", 1)
POLYNOMIAL = PhaseFamily("polynomial", len(POWERS))
SPLINE = PhaseFamily("spline", KNOTS - 2)
QUADRATIC_MOTION = PhaseFamily("quadratic motion", 1, aside=True)
MOTION = PhaseFamily("motion", len(POWERS), aside=True)
_TRIED = np.arange(-MOST_RAD, MOST_RAD + 0.5 * STEP_RAD, STEP_RAD)
_TRIED_ASIDE = np.arange(-MOST_ASIDE_RAD, MOST_ASIDE_RAD + STEP_RAD, 2.0 * STEP_RAD)


def trials(lines: AzimuthSpectrum) -> F64:
    """The contrast of each row under the quadratic phases at which fits may begin, (rows, tried)."""
    square = QUADRATIC.phase(lines, np.ones(1))
    return np.stack([corrected(lines, q * square) for q in _TRIED], axis=1)


def fitted(lines: AzimuthSpectrum, family: PhaseFamily, trial: F64 | None = None) -> F64:
    """The coefficients of the columns, (columns,), that give the rows the most contrast.

    Contrast has many maxima, so L-BFGS goes on from the best quadratic phases, by the adjoint. `trial`: what `trials`
    says of the same rows, which families can share.
    """
    basis = family.basis(lines.place)
    square = QUADRATIC.basis(lines.place)[:, 0]
    to_basis = np.linalg.lstsq(basis, square, rcond=None)[0]
    scale = family.scale(lines)

    def cost(x: F64) -> tuple[float, F64]:
        value, slope = mean_contrast_and_slope(lines, family.phase(lines, x / scale))
        return -value, -family.back(lines, slope) / scale

    best = []
    for same, aside in _starts(trials(lines) if trial is None else trial, lines.aside if family.aside else None):
        parts = (same, aside) if family.aside else (same,)
        best.append(np.concatenate([q * to_basis for q in parts]) * scale)
    found = [minimize(cost, x, jac=True, method="L-BFGS-B", options={"maxiter": 30}) for x in best]
    return np.asarray(min(found, key=lambda one: float(one.fun)).x / scale)


def deviations(lines: AzimuthSpectrum, family: PhaseFamily, coefficients: F64) -> F64:
    """The standard deviations of coefficients that were fitted, (coefficients,).

    The samples of a window depend on each other, so the contrast is no exact likelihood, and its curvature alone says
    no interval. How the slopes of blocks of rows scatter says how far the optimum moves (a sandwich, Huber 1967).
    """
    scale = family.scale(lines)

    def slopes(x: F64) -> F64:
        phase = np.broadcast_to(family.phase(lines, x / scale), lines.spectrum.shape)
        return family.back_of_rows(lines, mean_contrast_and_slope(lines, phase)[1]) / scale

    at, step = coefficients * scale, _CURVATURE_RAD
    curvature = np.stack([(slopes(at + e) - slopes(at - e)).sum(axis=0) / (2.0 * step) for e in step * np.eye(len(at))])
    block = lines.row_blocks()
    blocks = int(block[-1]) + 1
    each = np.zeros((blocks, len(at)))
    np.add.at(each, block, slopes(at))
    each -= each.mean(axis=0)
    moved = np.linalg.lstsq(0.5 * (curvature + curvature.T), each.T, rcond=None)[0]
    return np.asarray(np.sqrt((moved**2).sum(axis=1) * blocks / (blocks - 1)) / scale)


def _starts(trial: F64, aside: F64 | None) -> list[tuple[float, float]]:
    """The highest maxima among quadratic phases, of the part that all ranges share and of the part that goes with
    `aside` (rows,), 0 without it.

    A row sees the sum of both parts, so what each row says of one phase tells the mean of all under any two.
    """
    asides = np.zeros(1) if aside is None else _TRIED_ASIDE
    score = np.empty((len(_TRIED), len(asides)))
    for k, q in enumerate(asides):
        score[:, k] = trial.mean(axis=0) if aside is None else _shifted(trial, aside * q).mean(axis=0)
    peak = score == maximum_filter(score, size=3, mode="nearest")
    order = np.argsort(np.where(peak, score, -np.inf).ravel())[::-1][: min(_STARTS, int(peak.sum()))]
    row, column = np.unravel_index(order, score.shape)
    return list(zip(_TRIED[row].tolist(), asides[column].tolist(), strict=True))


def _shifted(trial: F64, by_rad: F64) -> F64:
    """Each row at the phases that are tried, and so much more (rows,) [rad]; linear, the ends beyond the ends."""
    at = np.clip(np.arange(trial.shape[1]) + by_rad[:, None] / STEP_RAD, 0.0, trial.shape[1] - 1.0)
    low = np.minimum(at.astype(int), trial.shape[1] - 2)
    share, rows = at - low, np.arange(len(trial))[:, None]
    return np.asarray((1.0 - share) * trial[rows, low] + share * trial[rows, low + 1])


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
