"""Pixels that a product clipped: they measured at least its top level, and nobody knows how much more.

I: gamma distributed power about mu at L looks; t: the level. Only P(I >= t) = Q(L, x), x = L t / mu, is known of such a
pixel: the regularised upper incomplete gamma function (DLMF 8.2.4).
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincc, gammaln

_FAR = 200.0  # x from which the asymptotic series is right to rounding for the looks of images; Q is not yet 0 there
_TERMS = 12


def minus_log_survival(level: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """-ln P(I >= level), the loss of clipped pixels; any shape."""
    x = looks * np.asarray(level / modelled, float)
    near, far = np.minimum(x, _far(looks)), np.maximum(x, _far(looks))
    if np.array_equal(x, near):  # the series costs as much as the rest, and is rarely asked for
        return np.asarray(-np.log(gammaincc(looks, near)))
    scaled = far - (looks - 1.0) * np.log(far) + gammaln(looks) - np.log(_tail(far, looks))
    return np.where(x > near, scaled, -np.log(gammaincc(looks, near)))


def hazard(level: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """h = x^L e^-x / (Gamma(L) Q(L, x)): minus the derivative of `minus_log_survival` to ln mu; any shape."""
    x = looks * np.asarray(level / modelled, float)
    near, far = np.minimum(x, _far(looks)), np.maximum(x, _far(looks))
    density = np.exp(looks * np.log(near) - near - gammaln(looks)) / gammaincc(looks, near)
    if np.array_equal(x, near):
        return np.asarray(density)
    return np.where(x > near, far / _tail(far, looks), density)


def survival_curvature(hazards: np.ndarray, level: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """The second derivative of `minus_log_survival` to ln mu, h (L - x + h), never negative; any shape."""
    x = looks * level / modelled
    return np.maximum(hazards * (looks - x + hazards), 0.0)


def _far(looks: float) -> float:
    return max(_FAR, 20.0 * looks)


def _tail(x: np.ndarray, looks: float) -> np.ndarray:
    """Q Gamma(L) e^x x^(1 - L) for large x: 1 + (L - 1) / x + (L - 1)(L - 2) / x^2 + ... (DLMF 8.11.2)."""
    total, term = np.ones_like(x), np.ones_like(x)
    for k in range(1, _TERMS):
        term = term * (looks - k) / x
        total = total + term
    return np.asarray(total)
