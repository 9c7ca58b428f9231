"""Ground range and slant range: polynomials over azimuth time, as annotations of detected products have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class GroundRange:
    """Polynomials of both directions, each at its azimuth time. A line has the one whose time is nearest, without any
    interpolation: so Sentinel-1's geolocation grids say (tests/products/test_geometry.py).

    Slant range = sum of `to_slant[k]` (g - `ground_origin_m`)^k, and ground range g = sum of `to_ground[k]`
    (R - `slant_origin_m`)^k. Where a file has the first alone (GAMMA), `to_ground` is None and it is inverted.
    """

    time_s: F64
    """(t,) [s], ascending."""
    ground_origin_m: F64
    """(t,)."""
    to_slant: F64
    """(t, k), rising powers."""
    slant_origin_m: F64 | None = None
    to_ground: F64 | None = None

    def slant_m(self, time_s: ArrayLike, ground_m: ArrayLike) -> F64:
        """Slant range [m] of ground ranges [m] at azimuth times [s]."""
        return self._nearest(self.to_slant, self.ground_origin_m, time_s, ground_m)

    def ground_m(self, time_s: ArrayLike, slant_m: ArrayLike) -> F64:
        """Ground range [m] of slant ranges [m] at azimuth times [s].

        The annotation's own polynomial gives the start. Newton's method then inverts `slant_m`, whose polynomial makes
        the product: both need not be each other's inverse to better than a metre.
        """
        slant = np.asarray(slant_m, np.float64)
        if self.to_ground is None or self.slant_origin_m is None:
            ground = np.full(np.broadcast(slant, time_s).shape, float(self.ground_origin_m[0]))
        else:
            ground = self._nearest(self.to_ground, self.slant_origin_m, time_s, slant)
        for _ in range(50):
            step = 1.0  # [m]; the polynomial is smooth over kilometres
            slope = (self.slant_m(time_s, ground + step) - self.slant_m(time_s, ground - step)) / (2.0 * step)
            change = (self.slant_m(time_s, ground) - slant) / slope
            ground = ground - change
            if np.abs(change).max(initial=0.0) < 1e-6:
                break
        return ground

    def _nearest(self, coefficients: F64, origin: F64, time_s: ArrayLike, at_m: ArrayLike) -> F64:
        time, at = np.asarray(time_s, np.float64), np.asarray(at_m, np.float64)
        which = np.abs(time[..., None] - self.time_s).argmin(axis=-1)  # before they are broadcast: lines are few
        shape = np.broadcast(time, at).shape
        if max(time.size, at.size) < np.prod(shape):  # lines by pixels: a polynomial once for all of its lines
            total = np.empty(shape)
            for one in np.unique(which).tolist():
                np.copyto(total, _horner(coefficients[one], at - origin[one]), where=which == one)
            return total
        return _horner(np.moveaxis(coefficients[which], -1, 0), at - origin[which])


def _horner(powers: F64, at: F64) -> F64:
    """The polynomial whose coefficients of rising powers are the rows of `powers`."""
    total = np.zeros(np.broadcast(powers[0], at).shape)
    for each in powers[::-1]:
        total = total * at + each
    return total
