"""Few strong scatterers in a pixel instead of many equal ones: power that varies more than speckle.

Speckle of L looks about a mean that is itself random, inverse gamma distributed of order a and mean mu (the G0 law of
Frery, Mueller, Yanasse and Sant'Anna, IEEE Trans. Geosci. Remote Sens. 35, 1997). A small order is a few glints; an
infinite one is plain speckle, the gamma law.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import gammaln

LEAST, MOST = 1.05, 300.0  # of an order: at 1 the mean is infinite, and beyond 300 the law is gamma to 1 %


def minus_log_density(measured: np.ndarray, modelled: np.ndarray, looks: float, order: float) -> np.ndarray:
    """-ln p(I) of every pixel, any shape; E[I] is `modelled`. Raises ValueError for an order of 1 or less."""
    if order <= 1.0:
        raise ValueError(f"order {order}: must be above 1, or the power has no mean")
    scale = (order - 1.0) * modelled / looks
    ratio = measured / scale
    constant = gammaln(looks) + gammaln(order) - gammaln(looks + order)
    return np.asarray(constant + np.log(measured) - looks * np.log(ratio) + (looks + order) * np.log1p(ratio))


def likeliest_order(measured: np.ndarray, modelled: np.ndarray, looks: float) -> tuple[float, float]:
    """The order of pixels of one region and the factor on `modelled` that goes with it: both at their likeliest.

    A model misses some of the mean, so its level is free here too. A misfit of its shape makes the order smaller.
    """

    def best_factor(order: float) -> tuple[float, float]:
        found = minimize_scalar(
            lambda t: float(minus_log_density(measured, np.exp(t) * modelled, looks, order).sum()),
            bounds=(-4.0, 4.0),
            method="bounded",
        )
        return float(np.exp(found.x)), float(found.fun)

    found = minimize_scalar(
        lambda t: best_factor(1.0 + np.exp(t))[1], bounds=(np.log(LEAST - 1.0), np.log(MOST - 1.0)), method="bounded"
    )
    order = 1.0 + float(np.exp(found.x))
    return order, best_factor(order)[0]
