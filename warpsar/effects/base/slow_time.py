"""A phase over slow time: a polynomial and a cubic spline over the place of the antenna along its aperture.

The place x goes from -1 to 1 along azimuth. A phase phi(x) of the samples recorded there moves what they hold by
phi'(x) cell / pi in azimuth, with cell the azimuth cell of the whole aperture [m] (stationary phase).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

F64 = NDArray[np.float64]
POWERS = (2, 3, 4)
"""Of the polynomial. A constant changes nothing that is measured, and a linear phase moves the image."""
FEWEST_KNOTS = 4


def spline(shape: Sequence[float]) -> CubicSpline:
    """A natural cubic spline through phases at equidistant places from -1 to 1."""
    return CubicSpline(np.linspace(-1.0, 1.0, len(shape)), np.asarray(shape, float), bc_type="natural")


def phase_at(place: F64, polynomial: ArrayLike, scale: float, shape: Sequence[float] | None) -> F64:
    """The phase [rad] at places (n,): `polynomial` has the phase that each of `POWERS` gives at x = 1."""
    found: F64 = np.sum([a * place**k for a, k in zip(np.asarray(polynomial), POWERS, strict=True)], axis=0)
    return found if shape is None or scale == 0.0 else found + scale * spline(shape)(place)
