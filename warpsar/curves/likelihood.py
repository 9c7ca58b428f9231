"""The density of a measured power about a complex amplitude.

A receiver sees a + n: the model's amplitude a, and complex Gaussian noise n of mean power s. The power P = |a + n|^2
then has the density of Rice (1945) for M = |a|^2,

    p(P) = exp(-(P + M) / s) I0(2 sqrt(P M) / s) / s.

2 P / s is a noncentral chi-square variable with two degrees of freedom and the noncentrality 2 M / s.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chndtr, chndtrix, i0e, i1e


def log_density(measured: ArrayLike, model: ArrayLike, noise: ArrayLike) -> NDArray[np.float64]:
    """ln p [1/m2] of measured power, for the model's power and the noise's mean power, all [m2]; arrays broadcast."""
    p, m, s = np.broadcast_arrays(*(np.asarray(each, np.float64) for each in (measured, model, noise)))
    z = 2.0 * np.sqrt(p * m) / s
    found: NDArray[np.float64] = -((np.sqrt(p) - np.sqrt(m)) ** 2) / s + np.log(i0e(z)) - np.log(s)
    return found


def slopes(measured: ArrayLike, model: ArrayLike, noise: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Derivatives of `log_density` to the model's power and to the noise's, [1/m2]."""
    p, m, s = np.broadcast_arrays(*(np.asarray(each, np.float64) for each in (measured, model, noise)))
    z = 2.0 * np.sqrt(p * m) / s
    ratio = i1e(z) / i0e(z)
    with np.errstate(divide="ignore", invalid="ignore"):
        # I1(z) / I0(z) = z / 2 near 0
        to_model = np.where(m > 0.0, ratio * np.sqrt(p / np.where(m > 0.0, m, 1.0)), p / s) / s - 1.0 / s
    return to_model, (-1.0 + (p + m) / s - ratio * z) / s


def distribution(measured: ArrayLike, model: ArrayLike, noise: ArrayLike) -> NDArray[np.float64]:
    """Probability of a power up to the measured one."""
    p, m, s = (np.asarray(each, np.float64) for each in (measured, model, noise))
    return np.asarray(chndtr(2.0 * p / s, 2.0, 2.0 * m / s), np.float64)


def median(model: ArrayLike, noise: ArrayLike) -> NDArray[np.float64]:
    """The power that a measurement exceeds as often as not [m2]."""
    m, s = np.broadcast_arrays(np.asarray(model, np.float64), np.asarray(noise, np.float64))
    quiet = m > 1e3 * s  # there the median is M + s / 2 up to s^2 / M, and the inverse is slow
    ratio = np.where(quiet, 0.0, 2.0 * m / np.where(s > 0.0, s, 1.0))
    return np.where(quiet, m + 0.5 * s, chndtrix(0.5, 2.0, ratio) * s / 2.0)
