"""GeoTIFF pictures on a map, with a coordinate system."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.data import Facts, ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import quantity_of
from warpsar.io import geotiff
from warpsar.runtime.extra import Extra
from warpsar.world.earth import WGS84, ecef_to_geodetic, needed

LARGEST_PIECE = 2**24
"""Pixels of a strip or tile, which is unpacked as a whole: 64 MiB of float32."""


def is_map(path: Path) -> bool:
    """Whether a TIFF has a coordinate system. Without rasterio it counts as a plain TIFF."""
    try:
        with geotiff.opened(path) as source:
            return source.crs is not None
    except InputError:
        return False


def read(path: Path, stated: Stated) -> ImageChip:
    """The only band, or the one that is described as the polarization, placed by its projection."""
    world, polarization = needed(stated.frame, path), stated.polarization
    from rasterio.warp import transform

    with geotiff.opened(path) as source:
        shape, crs, inverse = source.shape, source.crs, ~source.transform
        names = [name or "" for name in source.descriptions]
        dtype = np.dtype(source.dtypes[0] if not source.dtypes[0].startswith("complex") else np.complex64)
        piece = math.prod(source.block_shapes[0])
    if crs is None:
        raise InputError(f"{path}: found no coordinate system; must have one, or --format tiff be said")
    if piece > LARGEST_PIECE:
        raise InputError(f"{path}: found pieces of {piece} pixels; must be strips or tiles of up to {LARGEST_PIECE}")
    if len(names) > 1 and names.count(polarization or "") != 1:
        raise InputError(
            f"{path}: {len(names)} bands, described as {', '.join(map(repr, names))}; one must be described as the "
            f"polarization asked for ({polarization})"
        )
    band = names.index(polarization or "") + 1 if len(names) > 1 else 1

    def locate(points_m: np.ndarray) -> np.ndarray:
        geodetic = ecef_to_geodetic(world.to_ecef(points_m))
        with geotiff.projecting(path):
            x, y = transform(WGS84, crs, geodetic[..., 1].ravel(), geodetic[..., 0].ravel())
        x, y = np.asarray(x), np.asarray(y)
        col, row = (inverse.a * x + inverse.b * y + inverse.c, inverse.d * x + inverse.e * y + inverse.f)
        return np.stack([row, col], axis=-1).reshape(*points_m.shape[:-1], 2) - 0.5

    # Pixel size on the ground, measured through the projection: degrees are not metres.
    corner = locate(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    with np.errstate(all="ignore"):
        per_metre = np.linalg.norm(corner[1:] - corner[0], axis=0)
        spacing_m = (float(1.0 / per_metre[0]), float(1.0 / per_metre[1]))
    facts = Facts(polarization=polarization)
    return ImageChip(
        str(path),
        _Window(path, band, shape, dtype),
        quantity_of(path, dtype, stated.quantity),
        lambda reference_point_m: facts,
        spacing_m=spacing_m,
        locate=locate,
    )


class _Window:
    """One band of a raster, read from the file only where it is sliced; no-data becomes NaN."""

    def __init__(self, path: Path, band: int, shape: tuple[int, int], dtype: np.dtype) -> None:
        self.path, self.band, self.shape, self.dtype = path, band, shape, dtype

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        rows, cols = window
        with geotiff.opened(self.path) as source:
            raw = source.read(self.band, window=((rows.start, rows.stop), (cols.start, cols.stop)), masked=True)
            kind = np.complex64 if self.dtype.kind == "c" else np.float32
            return np.ma.filled(raw.astype(kind), np.nan)


FORMAT = Format(
    "geotiff",
    "GeoTIFF",
    "`.tif` with a coordinate system",
    "picture on a map, resampled into the slant plane",
    read,
    detect=lambda path, head: is_map(path),
    suffixes=(".tif", ".tiff"),
    extra=Extra("geo", ("rasterio",)),
    asks=("quantity",),
)
