"""Where a scene lies on the earth, and on a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.world.earth import WGS84, EarthFrame, LocalEarth, geodetic_to_ecef
from warpsar.world.world import World

if TYPE_CHECKING:
    from rasterio.crs import CRS

_POLAR_DEG = (84.0, -80.0)  # beyond them UTM ends


class ProjectedFrame:
    """World metres are those of a map projection about a point of the map; Z is the height above the ellipsoid."""

    def __init__(self, crs: CRS, centre: tuple[float, float]) -> None:
        self.crs, self.centre, self.metres = crs, centre, crs.linear_units_factor[1]

    def to_ecef(self, world_m: np.ndarray) -> np.ndarray:
        from rasterio.warp import transform

        world = np.asarray(world_m, np.float64)
        x, y = (world[..., i].ravel() / self.metres + self.centre[i] for i in (0, 1))
        lon, lat = transform(self.crs, WGS84, x, y)
        return geodetic_to_ecef(np.stack([lat, lon, world[..., 2].ravel()], axis=-1)).reshape(world.shape)


def dem_frame(path: Path) -> EarthFrame | None:
    """Where on the earth the mesh of a GeoTIFF DEM lies; None where the file has no coordinate system."""
    with geotiff.opened(path) as source:
        centre, crs = source.xy(source.height / 2, source.width / 2, offset="ul"), source.crs
        if crs is None:
            return None
        return LocalEarth(centre[1], centre[0]) if crs.is_geographic else ProjectedFrame(crs, centre)


def frame_of(scene: World) -> EarthFrame | None:
    """From the mesh, where it is a GeoTIFF DEM with a coordinate system, else from `[scene] origin`; None without both.

    Raises InputError where both are there.
    """
    mesh = scene.mesh_path
    frame = dem_frame(mesh) if mesh is not None and mesh.suffix.lower() in (".tif", ".tiff") else None
    if frame is not None and scene.origin is not None:
        raise InputError(
            f"{scene.path}: scene.origin: the mesh {mesh} is a DEM that says itself where it lies; leave it out"
        )
    if scene.origin is None:
        return frame
    return LocalEarth(scene.origin.latitude_deg, scene.origin.longitude_deg, scene.origin.height_m)


class WorldMap(Protocol):
    """A map of the world's ground: `crs` is rasterio's, `metres` the length of its unit [m]."""

    crs: Any
    metres: float

    def to_map(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World east and north [m] to map coordinates."""

    def to_world(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The way back."""


class _Own:
    """The map projection that a DEM has, about a point of it."""

    def __init__(self, frame: ProjectedFrame) -> None:
        self.crs, self.metres, self._centre = frame.crs, frame.metres, frame.centre

    def to_map(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x / self.metres + self._centre[0], y / self.metres + self._centre[1]

    def to_world(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (x - self._centre[0]) * self.metres, (y - self._centre[1]) * self.metres


class _Utm:
    """UTM on WGS 84, of the zone that the origin lies in; UPS towards the poles."""

    metres = 1.0

    def __init__(self, origin: LocalEarth) -> None:
        from rasterio.crs import CRS

        latitude, longitude = origin.latitude_deg, (origin.longitude_deg + 180.0) % 360.0 - 180.0
        self._local = f"+proj=aeqd +lat_0={latitude} +lon_0={longitude} +datum=WGS84 +units=m"
        code = (32600 if latitude >= 0 else 32700) + int((longitude + 180.0) // 6.0) % 60 + 1
        if latitude >= _POLAR_DEG[0]:
            code = 5041
        elif latitude < _POLAR_DEG[1]:
            code = 5042
        with geotiff.projecting(Path("[scene] origin")):
            self.crs = CRS.from_epsg(code)

    def to_map(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._between(self._local, self.crs, x, y)

    def to_world(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._between(self.crs, self._local, x, y)

    def _between(self, source: Any, target: Any, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from rasterio.warp import transform

        with geotiff.projecting(Path("[scene] origin")):
            found = transform(source, target, x.ravel(), y.ravel())
        return np.asarray(found[0]).reshape(x.shape), np.asarray(found[1]).reshape(x.shape)


def map_of(frame: EarthFrame) -> WorldMap:
    """The map on which the scene's ground is shown: the DEM's own, else UTM on WGS 84."""
    if isinstance(frame, ProjectedFrame):
        return _Own(frame)
    assert isinstance(frame, LocalEarth)
    return _Utm(frame)
