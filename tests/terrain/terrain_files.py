"""Elevation models and a product over them, made for tests."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
from product_files import SITE, Band, write_safe

STEP_M = 20.0
COVER_M = 8.0
E2 = 0.00669437999014
"""First eccentricity of WGS 84, squared."""
_W = math.sqrt(1.0 - E2 * math.sin(math.radians(SITE[0])) ** 2)
EAST_M = math.radians(1.0) * (6378137.0 / _W + SITE[2]) * math.cos(math.radians(SITE[0]))
NORTH_M = math.radians(1.0) * (6378137.0 * (1.0 - E2) / _W**3 + SITE[2])
"""Metres of a degree at the site's height, from the ellipsoid's radii of curvature."""
F64 = np.ndarray


def dem(folder: Path, heights: F64, *, crs: str = "EPSG:4326", name: str = "dem.tif", step_m: float = STEP_M) -> Path:
    """Heights over squares of `step_m` about the site, north up, in degrees."""
    import rasterio
    from rasterio.transform import Affine

    rows, columns = heights.shape
    per_lat = step_m / 111_150.0
    per_lon = per_lat / np.cos(np.deg2rad(SITE[0]))
    affine = Affine(per_lon, 0.0, SITE[1] - 0.5 * columns * per_lon, 0.0, -per_lat, SITE[0] + 0.5 * rows * per_lat)
    path = folder / name
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="float32", crs=crs, transform=affine
    ) as file:
        file.write(heights.astype(np.float32), 1)
    return path


def flat(size: int = 61, height: float = SITE[2]) -> F64:
    return np.full((size, size), height)


def product(folder: Path, **more: float) -> Path:
    """A strip-map SLC of zeros, 2.5 m in slant range by 13.7 m along the flight, about the site."""
    band = Band(lines=64, pixels=256, centre=(31.5, 127.5))
    return write_safe(folder, np.zeros((64, 256), np.complex64), band, **more)


def landcover(folder: Path, classes: F64, *, name: str = "cover.tif", nodata: int | None = None) -> Path:
    """Classes over squares of 8 m about the site, north up, in degrees."""
    import rasterio
    from rasterio.transform import Affine

    rows, columns = classes.shape
    per_lat = COVER_M / 111_150.0
    per_lon = per_lat / np.cos(np.deg2rad(SITE[0]))
    affine = Affine(per_lon, 0.0, SITE[1] - 0.5 * columns * per_lon, 0.0, -per_lat, SITE[0] + 0.5 * rows * per_lat)
    path = folder / name
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype=classes.dtype, crs="EPSG:4326",
        transform=affine, nodata=nodata,
    ) as file:  # fmt: skip
        file.write(classes, 1)
    return path


def town(folder: Path, *boxes: tuple[float, float, float, float, float], name: str = "town.geojson") -> Path:
    """Upright boxes: east and north of the site, sides along east and north, height [m]."""
    features = []
    for east, north, wide, deep, height in boxes:
        ring = [
            [SITE[1] + (east + x * wide / 2) / EAST_M, SITE[0] + (north + y * deep / 2) / NORTH_M]
            for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
        ]
        geometry = {"type": "Polygon", "coordinates": [ring]}
        features.append({"type": "Feature", "properties": {"height": height}, "geometry": geometry})
    path = folder / name
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path
