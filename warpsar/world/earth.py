"""The world on the WGS 84 ellipsoid: from metres about an origin to earth-centred coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from warpsar.errors import InputError

WGS84 = "EPSG:4326"
"""Longitude and latitude, as rasterio knows them."""
_A = 6378137.0  # [m], WGS 84 semi-major axis
_E2 = 6.69437999014e-3  # first eccentricity squared


class EarthFrame(Protocol):
    """How the world lies on the earth."""

    def to_ecef(self, world_m: np.ndarray) -> np.ndarray:
        """World points (..., 3) [m] to earth-centred, earth-fixed ones (..., 3) [m]."""


def needed(frame: EarthFrame | None, path: Path) -> EarthFrame:
    """`frame`; raises InputError where there is none, for a file that does not fix where the world lies."""
    if frame is None:
        raise InputError(
            f"{path}: where the world lies on the earth is not said; use a mesh that is a GeoTIFF DEM, or --origin "
            "with latitude, longitude and ellipsoidal height of the world's origin"
        )
    return frame


@dataclass(frozen=True)
class LocalEarth:
    """World metres east and north along the ellipsoid (azimuthal equidistant), Z above the origin's height.

    The origin is geodetic: degrees, and metres above the WGS 84 ellipsoid. The mesh of a DEM in longitude and latitude
    lies so about its middle, at height 0.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def to_ecef(self, world_m: np.ndarray) -> np.ndarray:
        """World points (..., 3) [m] to earth-centred ones; right to millimetres within 20 km.

        The arc has Euler's radius of the normal section, in place of the geodesic.
        """
        world = np.asarray(world_m, np.float64)
        lat = np.deg2rad(self.latitude_deg)
        prime = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
        meridian = prime**3 * (1.0 - _E2) / _A**2
        distance = np.hypot(world[..., 0], world[..., 1])
        heading = np.arctan2(world[..., 0], world[..., 1])
        east, north = np.sin(heading), np.cos(heading)
        radius = 1.0 / (north**2 / meridian + east**2 / prime)
        flat = radius * np.sin(distance / radius)
        drop = 2.0 * radius * np.sin(distance / radius / 2.0) ** 2
        ground = np.stack([east * flat, north * flat, -drop], axis=-1) @ self.axes + geodetic_to_ecef(
            np.array([self.latitude_deg, self.longitude_deg, 0.0])
        )
        geodetic = ecef_to_geodetic(ground)
        geodetic[..., 2] = world[..., 2] + self.height_m
        return geodetic_to_ecef(geodetic)

    @property
    def axes(self) -> np.ndarray:
        """East, north and up at the origin as rows, (3, 3), earth-centred."""
        lat, lon = np.deg2rad([self.latitude_deg, self.longitude_deg])
        return np.array(
            [
                [-np.sin(lon), np.cos(lon), 0.0],
                [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
                [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
            ]
        )


def axes_at(frame: EarthFrame, point_m: np.ndarray) -> np.ndarray:
    """Directions of the world's X, Y and Z at a world point (3,) [m]: unit rows, (3, 3), earth-centred."""
    step = 1.0  # [m]: the earth's curvature turns the axes by 1e-7 over it
    ahead = frame.to_ecef(point_m + step * np.eye(3))
    behind = frame.to_ecef(point_m - step * np.eye(3))
    axes = ahead - behind
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def geodetic_to_ecef(geodetic: np.ndarray) -> np.ndarray:
    """(latitude [deg], longitude [deg], height [m]) to earth-centred metres, shape (..., 3)."""
    lat, lon, h = np.deg2rad(geodetic[..., 0]), np.deg2rad(geodetic[..., 1]), geodetic[..., 2]
    n = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (n + h) * np.cos(lat) * np.cos(lon),
            (n + h) * np.cos(lat) * np.sin(lon),
            (n * (1.0 - _E2) + h) * np.sin(lat),
        ],
        axis=-1,
    )


def same_turn(longitude_deg: np.ndarray, about_deg: float) -> np.ndarray:
    """The same longitudes (...) [deg], from 180 west to 180 east of another: the date line makes no step there."""
    return about_deg + np.mod(np.asarray(longitude_deg, np.float64) - about_deg + 180.0, 360.0) - 180.0


def ecef_to_geodetic(ecef_m: np.ndarray) -> np.ndarray:
    """Earth-centred metres to (latitude [deg], longitude [deg], height [m]), shape (..., 3).

    Bowring's fixed point on the reduced latitude: three turns leave less than 1e-9 degrees near the surface.
    """
    x, y, z = np.moveaxis(np.asarray(ecef_m, np.float64), -1, 0)
    b = _A * np.sqrt(1.0 - _E2)
    p = np.hypot(x, y)
    reduced = np.arctan2(z * _A, p * b)
    for _ in range(3):
        lat = np.arctan2(z + _E2 / (1.0 - _E2) * b * np.sin(reduced) ** 3, p - _E2 * _A * np.cos(reduced) ** 3)
        reduced = np.arctan2(b * np.sin(lat), _A * np.cos(lat))
    # Distance from the ellipse along its normal, without dividing by a cosine or a sine that may vanish.
    height = p * np.cos(lat) + z * np.sin(lat) - _A * np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), height], axis=-1)
