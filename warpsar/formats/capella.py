"""Capella SLC: a GeoTIFF in the slant plane, whose first tag, or the JSON beside it, holds orbit, timing and scale.

Fields as the Capella Space SAR Products Format Specification has them, and as the producer's own reader
(github.com/capellaspace, package `capella-reader` 0.2) names them.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.errors import InputError, shown
from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.located import chip_of
from warpsar.io import geotiff, input_file
from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product, Radiometry, to_beta0
from warpsar.products.zero_doppler import Side, incidence_deg, locate, toward_radar
from warpsar.runtime.extra import Extra
from warpsar.world.earth import ecef_to_geodetic

F64 = NDArray[np.float64]
METADATA = "Capella's metadata"
LARGEST_TEXT = 2**26
"""Bytes of the JSON; those of long collects have some 2 MB."""
POWERS: dict[str, Radiometry] = {
    "beta_nought": "beta0",
    "beta": "beta0",
    "sigma_nought": "sigma0",
    "gamma_nought": "gamma0",
}
SIDES: dict[str, Side] = {"left": "left", "right": "right"}
NOISE_RANGES = 33
LARGEST_DOPPLER_HZ = 1.0
"""Of lines that count as zero Doppler: 1 Hz is 2 m along the flight at X band."""


def is_one(path: Path, head: bytes) -> bool:
    """A TIFF that says Capella's description, or the JSON itself."""
    if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        try:
            return _described(path) is not None
        except InputError:
            return False
    return head.lstrip()[:1] == b"{" and b'"collect"' in _begin(path)


def _begin(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(2**16)


def _described(path: Path) -> str | None:
    """The description of a TIFF where it is Capella's, or that of the JSON beside it."""
    with geotiff.opened(path) as source:
        text = source.tags().get("TIFFTAG_IMAGEDESCRIPTION", "")
    if text.lstrip().startswith("{") and '"collect"' in text:
        return text
    for beside in (path.with_suffix(".json"), path.with_name(f"{path.stem}_extended.json")):
        if beside.is_file() and b'"collect"' in _begin(beside):
            return input_file.read_text(beside, METADATA, LARGEST_TEXT)
    return None


class _Fields:
    """A JSON object, asked by paths such as `collect.image.rows`."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        try:
            self.content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: its description is no JSON ({str(error)[:100]})") from error

    def get(self, name: str, within: Any = None) -> Any:
        found = self.content if within is None else within
        for key in name.split("."):
            if not isinstance(found, dict) or key not in found:
                raise InputError(f"{self.path}: found no {name}; Capella's metadata must hold it")
            found = found[key]
        return found

    def number(self, name: str, within: Any = None) -> float:
        found = self.get(name, within)
        if isinstance(found, bool) or not isinstance(found, (int, float)) or not math.isfinite(found):
            raise InputError(f"{self.path}: {name}: found {shown(found)}; must be a number")
        return float(found)

    def whole(self, name: str) -> int:
        found = self.number(name)
        if found != int(found) or not 1 <= found <= 2**24:
            raise InputError(f"{self.path}: {name}: found {found:g}; must be a whole number from 1 to {2**24}")
        return int(found)

    def one_of(self, name: str, known: dict[str, Any]) -> Any:
        found = self.get(name)
        if not isinstance(found, str) or found.lower() not in known:
            raise InputError(f"{self.path}: {name}: found {shown(found)}; must be one of {', '.join(known)}")
        return known[found.lower()]

    def time(self, name: str, within: Any = None) -> np.datetime64:
        """UTC, to the nanosecond."""
        found = self.get(name, within)
        try:
            whole, _, part = str(found).removesuffix("Z").partition(".")
            datetime.fromisoformat(whole)
            return np.datetime64(whole, "ns") + np.timedelta64(int((part + "0" * 9)[:9]), "ns")
        except ValueError:
            raise InputError(f"{self.path}: {name}: found {shown(found)}; must be a time in UTC") from None

    def vector(self, name: str, within: Any) -> list[float]:
        found = self.get(name, within)
        if isinstance(found, dict):  # as older products have it
            found = list(found.values())
        if not isinstance(found, list) or len(found) != 3 or not all(isinstance(v, (int, float)) for v in found):
            raise InputError(f"{self.path}: {name}: found {shown(found)}; must be three numbers")
        return [float(v) for v in found]


class _Slc:
    """Complex samples, read from the file only where it is sliced."""

    def __init__(self, path: Path, shape: tuple[int, int]) -> None:
        self.path, self.shape, self.dtype = path, shape, np.dtype(np.complex64)

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        (top, bottom, _), (left, right, _) = (s.indices(n) for s, n in zip(window, self.shape, strict=True))
        with geotiff.opened(self.path) as source:
            return np.asarray(source.read(1, window=((top, bottom), (left, right))), np.complex64)


def products(path: Path, polarization: str | None) -> tuple[Product, ...]:
    """The product of a GeoTIFF, or of its JSON; then without pixels where no GeoTIFF of that name lies beside it.

    Raises InputError for images that are not in the slant plane at zero Doppler: PFA, GEC and GEO.
    """
    image: Path | None = path
    if _begin(path).lstrip()[:1] == b"{":
        stem = path.with_suffix("").name.removesuffix("_extended")
        image = next((one for s in (".tif", ".tiff") if (one := path.with_name(stem + s)).is_file()), None)
        text: str | None = input_file.read_text(path, METADATA, LARGEST_TEXT)
    else:
        text = _described(path)
    if text is None:
        raise InputError(f"{path}: found no description by Capella, and no JSON beside it; must have one")
    fields = _Fields(path, text)
    kind = fields.get("collect.image.image_geometry.type")
    if kind != "slant_plane":
        raise InputError(
            f"{path}: image_geometry: found {shown(kind)}; must be slant_plane: take the SLC of a stripmap or sliding "
            "spotlight collect. GEC and GEO lie on a map already, and PFA has no lines of zero Doppler"
        )
    geometry = "collect.image.image_geometry"
    doppler = _coefficients(fields, f"{geometry}.doppler_centroid_polynomial.coefficients")
    rows, columns = fields.whole("collect.image.rows"), fields.whole("collect.image.columns")
    near, step = (fields.number(f"{geometry}.{key}") for key in ("range_to_first_sample", "delta_range_sample"))
    line_s = fields.number(f"{geometry}.delta_line_time")
    far, late = near + columns * step, rows * abs(line_s)
    if _most(doppler, far, late) > LARGEST_DOPPLER_HZ:
        raise InputError(
            f"{path}: doppler_centroid_polynomial: found {shown(doppler.tolist())}; must be 0: lines must be those of "
            "zero Doppler"
        )
    sent, received = (str(fields.get(f"collect.radar.{way}_polarization")) for way in ("transmit", "receive"))
    if polarization is not None and polarization != sent + received:
        raise InputError(f"{path}: found the polarization {sent}{received}; {polarization} was asked for")
    first = fields.time(f"{geometry}.first_line_time")
    epoch = first.astype("datetime64[D]")
    orbit = _orbit(fields, epoch)
    grid = LineGrid(rows, columns, _seconds(first, epoch), line_s, near, step)
    scale = fields.number("collect.image.scale_factor")
    if scale <= 0.0:
        raise InputError(f"{path}: scale_factor: found {scale:g}; must be a number above 0")
    radiometry: Radiometry = fields.one_of("collect.image.radiometry", POWERS)
    side: Side = fields.one_of("collect.radar.pointing", SIDES)
    if image is not None:
        with geotiff.opened(image) as source:
            found, dtype = (source.height, source.width), source.dtypes[0]
        if found != (rows, columns) or not dtype.startswith("complex"):
            raise InputError(f"{image}: found {found} pixels of {dtype}; its metadata says {(rows, columns)} complex")
    return (
        Product(
            source=str(image or path),
            platform=str(fields.get("collect.platform")),
            epoch=epoch.astype("datetime64[us]"),
            polarization=sent + received,
            frequency_hz=fields.number("collect.radar.center_frequency"),
            side=side,
            grid=grid,
            orbit=orbit,
            samples=None if image is None else _Slc(image, (rows, columns)),
            quantity="complex",
            radiometry=radiometry,
            gain=lambda line, pixel: np.full(np.broadcast(line, pixel).shape, scale**2),
            noise=_noise(fields, grid, orbit, side, radiometry, scale),
            bandwidth_hz=(None, fields.number("collect.image.processed_azimuth_bandwidth")),
        ),
    )


def read(path: Path, stated: Stated) -> ImageChip:
    """The image, placed by its orbit."""
    return chip_of(products(path, stated.polarization)[0], path, stated)


def _seconds(time: np.datetime64, epoch: np.datetime64) -> float:
    return float((time - epoch.astype("datetime64[ns]")) / np.timedelta64(1, "ns")) * 1e-9


def _orbit(fields: _Fields, epoch: np.datetime64) -> Orbit:
    system = fields.get("collect.state.coordinate_system.type")
    if str(system).lower() != "ecef":
        raise InputError(f"{fields.path}: state.coordinate_system: found {shown(system)}; must be ecef")
    vectors = fields.get("collect.state.state_vectors")
    if not isinstance(vectors, list):
        raise InputError(f"{fields.path}: state.state_vectors: found {shown(vectors)}; must be a list")
    return Orbit.of(
        str(fields.path),
        [_seconds(fields.time("time", one), epoch) for one in vectors],
        [fields.vector("position", one) for one in vectors],
        [fields.vector("velocity", one) for one in vectors],
    )


def _coefficients(fields: _Fields, name: str) -> F64:
    try:
        found = np.asarray(fields.get(name), np.float64)
    except (TypeError, ValueError):
        found = np.full(1, np.nan)
    if not found.size or not np.isfinite(found).all():
        raise InputError(f"{fields.path}: {name}: must be numbers")
    return found


def _most(polynomial: F64, range_m: float, time_s: float) -> float:
    """Bound of a polynomial of range and time, (i, j), over an image."""
    table = np.atleast_2d(np.abs(polynomial))
    powers = [at ** np.arange(n) for at, n in zip((range_m, time_s), table.shape, strict=True)]
    return float(powers[0] @ table @ powers[1])


def _noise(
    fields: _Fields, grid: LineGrid, orbit: Orbit, side: Side, radiometry: Radiometry, scale: float
) -> Callable[[ArrayLike, ArrayLike], F64] | None:
    """Power of the noise in digital numbers, from the noise equivalent sigma0 [dB] by slant range [m]."""
    image = fields.get("collect.image")
    if not isinstance(image, dict) or "nesz_polynomial" not in image:
        return None
    coefficients = _coefficients(fields, "collect.image.nesz_polynomial.coefficients").ravel()
    pixels = np.linspace(0.0, grid.pixels - 1.0, NOISE_RANGES)
    middle = 0.5 * (grid.lines - 1)
    target = fields.vector("collect.image.center_pixel.target_position", None)
    height = float(ecef_to_geodetic(np.array(target))[2])
    times, slant = grid.time_s(middle, pixels), grid.slant_m(middle, pixels)
    places = locate(orbit, times, slant, height, side)
    angle = [incidence_deg(toward_radar(orbit, p, t)) for p, t in zip(places, times, strict=True)]
    sigma0 = 10.0 ** (0.1 * np.polynomial.polynomial.polyval(slant, coefficients))
    power = sigma0 * to_beta0("sigma0", angle) / to_beta0(radiometry, angle) / scale**2
    return lambda line, pixel: np.broadcast_to(
        np.interp(np.asarray(pixel, np.float64), pixels, power), np.broadcast(line, pixel).shape
    )


FORMAT = Format(
    "capella",
    "Capella SLC",
    "`.tif` that says Capella's metadata or has its `.json` beside it; that `.json`",
    "image in slant range, placed by orbit and zero Doppler",
    read,
    detect=is_one,
    products=products,
    extra=Extra("geo", ("rasterio",)),
)
