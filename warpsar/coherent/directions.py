"""Directions to the radar: axes, and the text in which a user asks for many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.coherent.records import records
from warpsar.kernels.coherent.tubes import TubeRadar


@dataclass(frozen=True)
class Directions:
    """Unit vectors of shape (n, 3), float64: `s` to the radar, `u` of H (-phi-hat), `v` of V (theta-hat)."""

    s: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]

    @classmethod
    def of(cls, azimuth_deg: ArrayLike, incidence_deg: ArrayLike) -> Directions:
        """Azimuth clockwise from north, incidence from the zenith [deg], (n,) each; u is level at the zenith, too."""
        az, inc = np.broadcast_arrays(np.deg2rad(azimuth_deg), np.deg2rad(incidence_deg))
        sin_a, cos_a, sin_i, cos_i = np.sin(az), np.cos(az), np.sin(inc), np.cos(inc)
        # A direction along an axis is exactly so: grazing incidence is then told from a ten-thousandth of a degree.
        sin_a, cos_a, sin_i, cos_i = (np.where(np.abs(x) < 1e-15, 0.0, x) for x in (sin_a, cos_a, sin_i, cos_i))
        s = np.stack([sin_a * sin_i, cos_a * sin_i, cos_i], axis=-1)
        u = np.stack([cos_a, -sin_a, np.zeros_like(az)], axis=-1)
        return cls(s, u, np.cross(-u, s))

    def places(self, origin: NDArray[np.float64], distance_m: float) -> NDArray[np.float64]:
        """Where radars at a distance from the reference point stand, about a body's middle `origin`, (n, 3) [m]."""
        return distance_m * self.s - origin

    def __len__(self) -> int:
        return len(self.s)

    def __getitem__(self, some: slice | NDArray[np.integer]) -> Directions:
        return Directions(self.s[some], self.u[some], self.v[some])


def radar_records(directions: Directions, origin: NDArray[np.float64], distance_m: float | None) -> Any:
    """The kernels' radars, about the body's middle; of a plane wave without a distance."""
    made = records(TubeRadar, len(directions))
    for axis in ("s", "u", "v"):
        made[axis] = getattr(directions, axis)
    if distance_m is not None:
        made["near"], made["distance"] = 1, distance_m
        made["place"] = directions.places(origin, distance_m)
    return made
