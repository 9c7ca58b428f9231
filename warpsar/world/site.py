"""Where the scene lies on the earth: one Cartesian frame for the scene and for the track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.world.earth import EarthFrame, LocalEarth, axes_at, ecef_to_geodetic

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Site:
    """East, north and up at the reference point. Without `frame` the world is flat, and lies nowhere."""

    reference_m: F64
    """(3,), world."""
    frame: EarthFrame | None

    def about(self, world_m: F64) -> F64:
        """World points (..., 3) [m] about the reference point; on the ellipsoid, as `warpsar import` places them."""
        if self.frame is None:
            return np.asarray(world_m, np.float64) - self.reference_m
        found: F64 = (self.frame.to_ecef(world_m) - self.frame.to_ecef(self.reference_m)) @ self.axes.T
        return found

    @property
    def axes(self) -> F64:
        """East, north and up as rows, earth-centred, (3, 3)."""
        left, _, right = np.linalg.svd(axes_at(self.earth, self.reference_m))
        turned: F64 = left @ right  # a rotation to the last digit keeps distances
        return turned

    @property
    def earth(self) -> EarthFrame:
        """The frame; where there is none, the world's zero lies where equator and Greenwich's meridian meet."""
        return self.frame or LocalEarth(0.0, 0.0, 0.0)

    @property
    def ecef(self) -> F64:
        """The reference point, (3,), earth-centred [m]."""
        found: F64 = self.earth.to_ecef(self.reference_m)
        return found

    @property
    def geodetic(self) -> F64:
        """Its latitude, longitude [deg] and height [m], (3,)."""
        found: F64 = ecef_to_geodetic(self.ecef)
        return found

    def to_ecef(self, about_m: F64) -> F64:
        """Places about the reference point (..., 3) [m], earth-centred."""
        found: F64 = self.ecef + about_m @ self.axes
        return found
