"""Pictures: GeoTIFF, TIFF, EXR and NPY. Unless they are complex, only their maker knows what their numbers are."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.io.images import read_channel, read_npy
from warpsar.measured import jpeg
from warpsar.measured.data import Facts, ImageChip, Quantity, RadarAt
from warpsar.measured.earth import EarthFrame, Origin, ecef_to_geodetic, geodetic_to_ecef, needed

if TYPE_CHECKING:
    from rasterio.crs import CRS

SUFFIXES = (".tif", ".tiff", ".exr", ".npy")
_WGS84 = "EPSG:4326"
LARGEST_PIECE = 2**24
"""Pixels of a strip or tile, which is unpacked as a whole: 64 MiB of float32."""


class ProjectedFrame:
    """World metres are those of a map projection about a point of the map; Z is the height above the ellipsoid."""

    def __init__(self, crs: CRS, centre: tuple[float, float]) -> None:
        self.crs, self.centre, self.metres = crs, centre, crs.linear_units_factor[1]

    def to_ecef(self, world_m: np.ndarray) -> np.ndarray:
        from rasterio.warp import transform

        world = np.asarray(world_m, np.float64)
        x, y = (world[..., i].ravel() / self.metres + self.centre[i] for i in (0, 1))
        lon, lat = transform(self.crs, _WGS84, x, y)
        return geodetic_to_ecef(np.stack([lat, lon, world[..., 2].ravel()], axis=-1)).reshape(world.shape)


def dem_frame(path: Path) -> EarthFrame | None:
    """Where on the earth the mesh of a GeoTIFF DEM lies; None where the file has no coordinate system."""
    with geotiff.opened(path) as source:
        centre, crs = source.xy(source.height / 2, source.width / 2, offset="ul"), source.crs
        if crs is None:
            return None
        return Origin(centre[1], centre[0]) if crs.is_geographic else ProjectedFrame(crs, centre)


def read(
    path: Path,
    quantity: Quantity | None,
    polarization: str | None,
    frame: EarthFrame | None,
    *,
    kind: str,
    radar_at: RadarAt = "top",
    spacing_m: tuple[float, float] | None = None,
) -> ImageChip:
    """A map-projected image (`kind` "geotiff", with a coordinate system), or a slant-plane one.

    A slant-plane image has range along its rows, and the reference point in its middle. Near range is first, or last
    where the radar is at the bottom. Its spacing, if not stated, is that of the view, divided by the looks. Real
    numbers need `quantity`, "amplitude" or "power".
    """
    if kind == "geotiff":
        return _read_map(path, quantity, polarization, frame)
    samples, error = jpeg.read(path) if kind == "jpeg" else (_read_slant(path, polarization), None)
    samples = samples[::-1] if radar_at == "bottom" else samples
    facts = Facts(polarization=polarization)
    return ImageChip(
        str(path),
        samples,
        _stated_quantity(path, samples.dtype, quantity),
        lambda reference_point_m: facts,
        spacing_m=spacing_m,
        top=jpeg.TOP if kind == "jpeg" else None,
        error=error,
    )


def is_map(path: Path) -> bool:
    """Whether a TIFF has a coordinate system. Without rasterio it counts as a plain TIFF."""
    try:
        with geotiff.opened(path) as source:
            return source.crs is not None
    except InputError:
        return False


def _read_slant(path: Path, polarization: str | None) -> np.ndarray:
    if path.suffix.lower() == ".npy":
        array = read_npy(path)
        if array.dtype.kind == "c":
            with np.errstate(all="ignore"):
                return np.array(array, np.complex64)
    return read_channel(path, polarization)


def _read_map(path: Path, quantity: Quantity | None, polarization: str | None, frame: EarthFrame | None) -> ImageChip:
    world = needed(frame, path)
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
            x, y = transform(_WGS84, crs, geodetic[..., 1].ravel(), geodetic[..., 0].ravel())
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
        _stated_quantity(path, dtype, quantity),
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


def _stated_quantity(path: Path, dtype: np.dtype, quantity: Quantity | None) -> Quantity:
    if dtype.kind == "c":
        if quantity is not None:
            raise InputError(f"{path}: holds complex numbers; --quantity {quantity} is for detected images")
        return "complex"
    if quantity not in ("amplitude", "power"):
        raise InputError(f"{path}: the format does not say whether these are amplitudes or powers; use --quantity")
    return quantity
