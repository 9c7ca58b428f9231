"""An interval for the whole value: what physical optics, edges and rays leave out.

Waves from tips, around the back and along the surface send amplitudes of the order of a wavelength, whatever the size
of the body. What an edge sends is diffracted again at other edges, and comes back as strong as the first wave at most.
Rays in a duct are right to a share that falls as one over the Fresnel number. So the mean square error of sqrt(4 pi) A
is taken as

    s = (c lambda)^2 + q |sqrt(4 pi) A_edges|^2 + d(F) |sqrt(4 pi) A_multibounce|^2,    d(F) = min(1, d / F),

and the power has Rice's distribution about A. Specular returns have no share of their own: the current on a large face
is that of physical optics but for what its border sends.

s is a bound more than a level: for one polarization of an ogive it holds, and for the other what is left out is 20 dB
below. So the low end takes the error to be no larger than the value itself, as long as that is above s / 10.

The three numbers were found on measured bodies, bodies of revolution and Mie's series (docs/coherent-checks.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chndtrix

CONFIDENCE = 0.95
OF_WAVELENGTH = 0.5
"""c: root mean square of what tips and surface waves send, over the wavelength."""
OF_EDGES = 0.8
"""q: power that comes back from edges after the first diffraction, over that of the first."""
OF_DUCTS = 0.9
"""d: Fresnel number at which what rays bring back from a duct is no better than chance."""
_LEAST = 0.1
_QUIET = 1e3
"""Power over the error from which Rice's distribution is that of Gauss: to 1 %."""


def error_m2(
    wavelength_m: ArrayLike,
    edges_m2: ArrayLike,
    bounced_m2: ArrayLike,
    fresnel_number: ArrayLike,
    of: tuple[float, float, float] = (OF_WAVELENGTH, OF_EDGES, OF_DUCTS),
) -> NDArray[np.float64]:
    """Mean square error s [m2] of sqrt(4 pi) A; arrays broadcast.

    `edges_m2` and `bounced_m2` are 4 pi |A|^2 of these terms. `fresnel_number` is NaN where nothing bounces. `of` are
    c, q and d.
    """
    c, q, d = of
    number = np.nan_to_num(np.asarray(fresnel_number, np.float64), nan=np.inf)
    chance = np.minimum(1.0, d / np.maximum(number, 1e-9))
    left = (c * np.asarray(wavelength_m)) ** 2 + q * np.asarray(edges_m2) + chance * np.asarray(bounced_m2)
    return np.asarray(left, np.float64)


def ends_m2(
    power_m2: NDArray[np.float64], error: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper end [m2] of the 95 % interval of the power, for a modelled power and its error `s`, both [m2]."""
    power, s = np.broadcast_arrays(power_m2, error)
    tail = 0.5 * (1.0 - CONFIDENCE)
    return _quantile(power, np.clip(power, _LEAST * s, s), tail), _quantile(power, s, 1.0 - tail)


def _quantile(power: NDArray[np.float64], s: NDArray[np.float64], chance: float) -> NDArray[np.float64]:
    """Of Rice's distribution [m2]: 2 P / s is a noncentral chi-square variable with two degrees of freedom."""
    quiet = power > _QUIET * s  # there the inverse is slow, and the amplitude is a normal number of variance s / 2
    ratio = np.where(quiet, 0.0, 2.0 * power / s)
    sign = 1.0 if chance > 0.5 else -1.0
    normal = (np.sqrt(power) + sign * 1.96 * np.sqrt(0.5 * s)) ** 2
    return np.where(quiet, normal, chndtrix(chance, 2.0, ratio) * s / 2.0)
