"""Range and Doppler on the earth: where a zero-Doppler image shows a place, and which place a pixel shows."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.errors import InputError
from warpsar.products.orbit import Orbit
from warpsar.world.earth import LocalEarth, ecef_to_geodetic, geodetic_to_ecef

Side = Literal["right", "left"]
TOLERANCE_S = 1e-10
"""Of the azimuth time: under a micrometre of flight."""
TOLERANCE_M = 1e-5
_TURNS = 30
F64 = NDArray[np.float64]


def abeam(orbit: Orbit, point_m: ArrayLike, start_s: float, tolerance_s: float = TOLERANCE_S) -> tuple[F64, F64]:
    """Azimuth time [s] and slant range [m], (...), at which earth-centred points (..., 3) [m] are at zero Doppler.

    Newton's method on (point - satellite) . velocity = 0, from `start_s`. The slope takes the satellite's acceleration
    of that time: it turns by a thousandth in a second, and is a twentieth of the slope, so each turn leaves 5e-5 of the
    error for each second from there.
    """
    point = np.ascontiguousarray(np.moveaxis(np.asarray(point_m, np.float64), -1, 0))  # a coordinate a row
    time = np.full(point.shape[1:], float(start_s))
    acceleration = np.diff(orbit.at([start_s - 0.5, start_s + 0.5])[1], axis=0)[0]  # [m/s2]: over a second
    for _ in range(_TURNS):
        position, velocity = (np.moveaxis(each, -1, 0) for each in orbit.at(time))
        offset = point - position
        slope = np.einsum("i...,i...", velocity, velocity) - np.einsum("i,i...", acceleration, offset)
        change = np.einsum("i...,i...", offset, velocity) / slope
        time = time + change
        if np.abs(change).max(initial=0.0) < tolerance_s:
            break
    offset = point - np.moveaxis(orbit.at(time)[0], -1, 0)
    distance: F64 = np.sqrt(np.einsum("i...,i...", offset, offset))
    return time, distance


def locate(orbit: Orbit, time_s: ArrayLike, range_m: ArrayLike, height_m: ArrayLike, side: Side) -> F64:
    """Latitude, longitude [deg] and height [m], (..., 3), of what is seen at azimuth times and slant ranges (...).

    The place at that height above the WGS 84 ellipsoid, at that distance, in the plane of zero Doppler, on the side
    that the radar looks to: Newton's method on these three equations. Raises InputError where there is none.
    """
    time, distance, height = np.broadcast_arrays(
        *(np.asarray(each, np.float64) for each in (time_s, range_m, height_m))
    )
    position, velocity = orbit.at(time)
    ahead = velocity / np.linalg.norm(velocity, axis=-1, keepdims=True)
    down = -position / np.linalg.norm(position, axis=-1, keepdims=True)
    down = down - (down * ahead).sum(-1, keepdims=True) * ahead
    down /= np.linalg.norm(down, axis=-1, keepdims=True)
    across = np.cross(ahead, down) if side == "left" else np.cross(down, ahead)
    # From a sphere under the satellite, by the law of cosines.
    from_centre = np.linalg.norm(position, axis=-1)
    radius = from_centre - ecef_to_geodetic(position)[..., 2] + height
    cosine = (distance**2 + from_centre**2 - radius**2) / (2.0 * distance * from_centre)
    if not (np.abs(cosine) < 1.0).all():
        raise InputError(
            f"slant range: found {np.min(distance):.9g} to {np.max(distance):.9g} m; no place at that height is so far "
            "from the satellite"
        )
    sine = np.sqrt(1.0 - cosine**2)
    point = position + distance[..., None] * (cosine[..., None] * down + sine[..., None] * across)
    for _ in range(_TURNS):
        geodetic = ecef_to_geodetic(point)
        offset = point - position
        far = np.linalg.norm(offset, axis=-1)
        wrong = np.stack([far - distance, (offset * ahead).sum(-1), geodetic[..., 2] - height], axis=-1)
        slopes = np.stack([offset / far[..., None], ahead, axes_up(geodetic)], axis=-2)
        step = np.linalg.solve(slopes, wrong[..., None])[..., 0]
        point = point - step
        if np.abs(step).max(initial=0.0) < TOLERANCE_M:
            break
    found: F64 = ecef_to_geodetic(point)
    return found


def axes_up(geodetic: ArrayLike) -> F64:
    """The ellipsoid's normal, (..., 3), earth-centred, at places (..., 3) of latitude and longitude [deg]."""
    lat, lon = (np.deg2rad(np.asarray(geodetic, np.float64)[..., i]) for i in (0, 1))
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)


def toward_radar(orbit: Orbit, geodetic: ArrayLike, time_s: float) -> F64:
    """Unit vector east, north and up, (3,), from a place (latitude, longitude [deg], height [m]) to the satellite."""
    place = np.asarray(geodetic, np.float64)
    offset = orbit.at(time_s)[0] - geodetic_to_ecef(place)
    local: F64 = LocalEarth(*place).axes @ offset
    unit: F64 = local / np.linalg.norm(local)
    return unit


def azimuth_deg(unit: ArrayLike) -> float:
    """Of a vector (east, north, up): clockwise from north [deg], 0 to 360."""
    east, north, _ = np.asarray(unit, np.float64)
    return float(np.degrees(np.arctan2(east, north)) % 360.0)


def incidence_deg(unit: ArrayLike) -> float:
    """Of a unit vector (east, north, up): from the ellipsoid's normal [deg]."""
    return float(np.degrees(np.arccos(np.clip(np.asarray(unit, np.float64)[2], -1.0, 1.0))))
