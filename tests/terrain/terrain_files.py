"""Elevation models and a product over them, made for tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from product_files import SITE, Band, write_safe

STEP_M = 20.0
F64 = np.ndarray


def dem(folder: Path, heights: F64, *, crs: str = "EPSG:4326", name: str = "dem.tif") -> Path:
    """Heights over squares of `STEP_M` about the site, north up, in degrees."""
    import rasterio
    from rasterio.transform import Affine

    rows, columns = heights.shape
    per_lat = STEP_M / 111_150.0
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
