"""How a trihedral stands, and what it sends back by geometric optics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Shape = Literal["triangular", "square"]
SHAPES: tuple[Shape, ...] = ("triangular", "square")
F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Facing:
    """One attitude of a trihedral.

    `azimuth_deg`: of its boresight, clockwise from north. `tilt_deg`: how far its front is raised about the horizontal
    axis across; the boresight of an upright one is then 35.26 degrees + tilt over the horizon. `flipped`: it stands
    on its back, with one leg level and to the front; the boresight is then 54.74 degrees + tilt over the horizon.
    """

    azimuth_deg: float
    tilt_deg: float = 0.0
    flipped: bool = False

    def legs(self) -> F64:
        """Unit vectors of the three legs from the corner, rows (3, 3), in east, north, up."""
        azimuth, tilt = np.deg2rad([self.azimuth_deg, self.tilt_deg])
        level, right, up = (
            np.array([np.sin(azimuth), np.cos(azimuth), 0.0]),
            np.array([np.cos(azimuth), -np.sin(azimuth), 0.0]),
            np.array([0.0, 0.0, 1.0]),
        )
        front = np.cos(tilt) * level + np.sin(tilt) * up
        top = np.cos(tilt) * up - np.sin(tilt) * level
        single, pair = (front, top) if self.flipped else (top, front)
        return np.stack([(pair + right) / np.sqrt(2.0), (pair - right) / np.sqrt(2.0), single])

    def boresight(self) -> F64:
        """Unit vector, (3,), in east, north, up."""
        return np.asarray(self.legs().sum(axis=0) / np.sqrt(3.0))

    def cosines(self, toward_radar: ArrayLike) -> F64:
        """Of the angles between the legs and directions to the radar (..., 3): (..., 3). Negative: from behind."""
        return np.asarray(np.asarray(toward_radar, np.float64) @ self.legs().T)

    def off_boresight_deg(self, toward_radar: ArrayLike) -> float:
        """Angle between boresight and a direction to the radar (3,) [deg]."""
        cosine = float(np.clip(np.asarray(toward_radar, np.float64) @ self.boresight(), -1.0, 1.0))
        return float(np.degrees(np.arccos(cosine)))


def effective_area_m2(shape: Shape, leg_m: float, cosines: ArrayLike) -> F64:
    """Area that sends rays back after three bounces, of direction cosines (..., 3); 0 from behind.

    A ray that meets the aperture's plane at p from the corner leaves it at -p. So the area is that which the aperture,
    seen from the radar, shares with its own inversion through the corner. With l <= m <= n:

    triangular plates: (l + m + n - 2 / (l + m + n)) a^2 for l + m >= n, else 4 l m / (l + m + n) a^2
    (Bonkowski, Lubitz and Schensted, University of Michigan, 1953; Ruck, Radar Cross Section Handbook, 1970, 8.1);
    square plates: l (4 - n / m) a^2 for m >= n / 2, else 4 l m / n a^2.
    """
    low, middle, high = np.moveaxis(np.sort(np.asarray(cosines, np.float64), axis=-1), -1, 0)
    seen = low > 0.0
    low, middle, high = (np.where(seen, each, 1.0) for each in (low, middle, high))
    if shape == "triangular":
        total = low + middle + high
        near, far = total - 2.0 / total, 4.0 * low * middle / total
        area = np.where(low + middle >= high, near, far)
    else:
        area = np.where(middle >= 0.5 * high, low * (4.0 - high / middle), 4.0 * low * middle / high)
    return np.where(seen, area, 0.0) * leg_m**2


def trihedral_rcs_m2(shape: Shape, leg_m: float, facing: Facing, toward_radar: ArrayLike, wavelength_m: float) -> F64:
    """Radar cross-section 4 pi A^2 / wavelength^2 [m2] for directions to the radar (..., 3) in east, north, up.

    Geometric optics: three bounces alone. It holds within some 20 degrees of boresight, for legs of many wavelengths.
    Plates that the radar sees squarely, single and double bounces and edges are left out; `engine` has them.
    """
    area = effective_area_m2(shape, leg_m, facing.cosines(toward_radar))
    return np.asarray(4.0 * np.pi * area**2 / wavelength_m**2)


def turn_that_loses_deg(shape: Shape, loss_db: float) -> float:
    """Turn in azimuth from the boresight of an upright trihedral that takes so much of its RCS [deg]; NaN beyond 44."""
    facing, turns = Facing(0.0), np.linspace(0.0, 44.0, 441)
    up = np.arcsin(facing.boresight()[2])
    a = np.deg2rad(turns)
    looks = np.stack([np.sin(a) * np.cos(up), np.cos(a) * np.cos(up), np.full_like(a, np.sin(up))], axis=-1)
    areas = trihedral_rcs_m2(shape, 1.0, facing, looks, 1.0)
    return float(np.interp(loss_db, 10.0 * np.log10(areas[0] / areas), turns, right=np.nan))
