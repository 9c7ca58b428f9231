"""Digital elevation models in GeoTIFF (extra `geo`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.world.meshes.part import DEFAULT_MATERIAL, MeshPart

if TYPE_CHECKING:
    from rasterio import DatasetReader

SUFFIXES = (".tif", ".tiff")
LARGEST_PER_BYTE = 1032
"""Heights to a byte of the file: what deflate packs at most."""
LARGEST_DEM = 2**25
"""Pixels: 67 million faces."""


def read(path: Path, warnings: list[str]) -> list[MeshPart]:
    """Two triangles for each cell between four valid pixel centres.

    X and Y are metres east and north of the raster's centre; heights are as in the file. A projected coordinate system
    is taken as it is (feet become metres). A geographic one is projected azimuthal-equidistantly about the centre.
    """
    with geotiff.opened(path) as source:
        _check(path, source)
        band = source.read(1, masked=True)
        heights = np.ma.filled(band.astype(np.float64), np.nan) * source.scales[0] + source.offsets[0]
        affine, crs = source.transform, source.crs
    with geotiff.projecting(path):
        from rasterio.warp import transform as project

        row, col = (index.ravel() + 0.5 for index in np.indices(heights.shape))
        x = affine.a * col + affine.b * row + affine.c
        y = affine.d * col + affine.e * row + affine.f
        centre_x, centre_y = float(x.mean()), float(y.mean())  # of an affine grid: its middle
        if crs is not None and crs.is_geographic:
            local = f"+proj=aeqd +lat_0={centre_y} +lon_0={centre_x} +datum=WGS84 +units=m"
            east, north = (np.asarray(values) for values in project(crs, local, x, y))
        else:
            if crs is None:
                warnings.append("the DEM has no coordinate system: its coordinates are taken as metres")
            metres = crs.linear_units_factor[1] if crs is not None else 1.0
            east, north = (x - centre_x) * metres, (y - centre_y) * metres
    rows, cols = heights.shape
    valid = np.isfinite(heights)
    whole = valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]
    corner = np.arange(rows * cols).reshape(rows, cols)[:-1, :-1][whole]
    faces = np.concatenate(
        [
            np.stack([corner, corner + cols, corner + 1], axis=1),
            np.stack([corner + 1, corner + cols, corner + cols + 1], axis=1),
        ]
    )
    used = np.zeros(rows * cols, bool)
    used[faces] = True
    index = np.cumsum(used) - 1
    vertices = np.stack([east, north, heights.ravel()], axis=1)[used]
    return [MeshPart(DEFAULT_MATERIAL, vertices, index[faces])]


def _check(path: Path, source: DatasetReader) -> None:
    """Refuse by the header, before pixels are read."""
    check_heights(path, source)
    size = path.stat().st_size
    most = min(LARGEST_DEM, LARGEST_PER_BYTE * size)
    if source.width * source.height > most:
        raise InputError(
            f"{path}: found {source.height} x {source.width} heights; must be at most {most}, by its {size} bytes"
        )


def check_heights(path: Path, source: DatasetReader) -> None:
    """Raise InputError for a raster that is no elevation model: several bands, or numbers that are not real."""
    if source.count != 1:
        raise InputError(f"{path}: found {source.count} bands; a DEM must have one, of heights [m]")
    if np.dtype(source.dtypes[0]).kind not in "fiu":
        raise InputError(f"{path}: found heights of type {source.dtypes[0]}; must be real numbers")
