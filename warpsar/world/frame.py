"""The axes of a view: where range, azimuth and elevation point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

SPEED_OF_LIGHT = 299792458.0


@dataclass(frozen=True)
class ViewGeometry:
    """Axes of one view, all unit vectors of shape (3,), float64, in world coordinates (X east, Y north, Z up).

    `s` points from the scene to the radar. `d` = -`s` is the direction of slant range, `u` that of azimuth, and `v`
    that of elevation (down and back toward the radar). `wavenumber` is 2 pi f / c [rad/m]. `slant_range_m` is the
    distance R0 from the straight track to the reference point in a strip-map; None for a plane wave.
    """

    s: np.ndarray
    d: np.ndarray
    u: np.ndarray
    v: np.ndarray
    wavenumber: float
    slant_range_m: float | None = None

    def range_and_azimuth_m(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where points, (..., 3) [m] about the reference point, lie in the image, shape (...): slant range, in a
        strip-map the distance from the track less R0, and azimuth."""
        along = points @ self.d
        if self.slant_range_m is not None:
            along = np.hypot(self.slant_range_m + along, points @ self.v) - self.slant_range_m
        return along, points @ self.u


@lru_cache(maxsize=2**12)
def view_geometry(
    azimuth_deg: float, incidence_deg: float, frequency_hz: float, slant_range_m: float | None = None
) -> ViewGeometry:
    """Axes for a radar seen at `azimuth_deg` (clockwise from north) and `incidence_deg` (from the zenith)."""
    azimuth, incidence = np.deg2rad(azimuth_deg), np.deg2rad(incidence_deg)
    s = np.array([np.sin(azimuth) * np.sin(incidence), np.cos(azimuth) * np.sin(incidence), np.cos(incidence)])
    d = -s
    u = np.cross([0.0, 0.0, 1.0], d)
    u /= np.linalg.norm(u)
    v = np.cross(u, d)
    for axis in (s, d, u, v):
        axis.flags.writeable = False  # all that ask for these angles share them
    return ViewGeometry(s, d, u, v, 2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT, slant_range_m)
