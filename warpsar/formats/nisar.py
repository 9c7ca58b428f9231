"""NISAR-style HDF5 single-look complex images (also UAVSAR in that form), placed by orbit and zero Doppler."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from warpsar.errors import InputError
from warpsar.formats.base.data import ImageChip, reading
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.located import chip_of
from warpsar.products.grid import LineGrid
from warpsar.products.lookup import LineTable
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.products.zero_doppler import Side
from warpsar.runtime.extra import Extra

if TYPE_CHECKING:
    import h5py

EXTRA = Extra("hdf5", ("h5py",))
LARGEST_AXIS = 2**24
"""Bound of times, of ranges, and of the orbit's numbers."""
LARGEST_CHUNK = 2**26
"""Bytes that HDF5 unpacks to reach one number; NISAR's are 2 MiB."""
LARGEST_RATIO = 1100
"""Bytes of a data set to those that the file stores: deflate packs at most 1032 to 1."""


class _Window:
    """One HDF5 data set, read from the file only where it is sliced."""

    def __init__(self, path: Path, name: str, shape: tuple[int, int]) -> None:
        self.path, self.name, self.shape, self.dtype = path, name, shape, np.dtype(np.complex64)

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        import h5py

        with reading(self.path, "HDF5 image"), h5py.File(self.path) as file:
            raw = file[self.name][window]
            if raw.dtype.names:  # complex of two float16, as NISAR stores it
                real, imag = (raw[name].astype(np.float32) for name in raw.dtype.names)
                raw = real + 1j * imag
            return np.asarray(raw, np.complex64)


def products(path: Path, polarization: str | None) -> tuple[Product, ...]:
    """The images of a file, one for each polarization: rows are zero-Doppler time, columns slant range."""
    EXTRA.require(f"{path}: HDF5")
    import h5py

    with reading(path, "HDF5 file"), h5py.File(path) as file:
        return tuple(_product(path, file, pol) for pol in _polarizations(path, file, polarization))


def read(path: Path, stated: Stated) -> ImageChip:
    """The image, placed by its orbit.

    The frame says where the world lies on the earth (a mesh that is a DEM, or an origin given by the user): the file
    does not fix it. Raises InputError without it, and where several polarizations are there and none is chosen.
    """
    found = products(path, stated.polarization)
    if len(found) > 1:
        names = ", ".join(str(one.polarization) for one in found)
        raise InputError(f"{path}: several polarizations ({names}); choose one with --polarization")
    return replace(chip_of(found[0], path, stated), calibrated=False, gain=None)


def _product(path: Path, file: h5py.File, polarization: str) -> Product:
    swath = _Swath.read(path, file, polarization)
    times, ranges = swath.times, swath.ranges
    if swath.shape != (times.size, ranges.size) or min(swath.shape) < 2:
        raise InputError(
            f"{path}: {swath.name} has shape {swath.shape}, for {times.size} times and {ranges.size} ranges"
        )
    time_step, range_step = (float(axis[-1] - axis[0]) / (axis.size - 1) for axis in (times, ranges))
    if time_step == 0.0 or range_step == 0.0:
        raise InputError(f"{path}: times and ranges must change along their axes, but do not")
    grid = LineGrid(times.size, ranges.size, float(times[0]), time_step, float(ranges[0]), range_step)
    return Product(
        source=str(path),
        platform=swath.platform,
        epoch=swath.epoch,
        polarization=swath.polarization,
        frequency_hz=swath.frequency_hz,
        side=swath.side,
        grid=grid,
        orbit=swath.orbit,
        samples=_Window(path, swath.name, swath.shape),
        quantity="complex",
        radiometry=None if swath.beta0 is None else "beta0",
        gain=None if swath.beta0 is None else _beta0_gain(swath.beta0),
        bandwidth_hz=swath.bandwidth_hz,
    )


def _beta0_gain(table: LineTable) -> Callable[[ArrayLike, ArrayLike], np.ndarray]:
    return lambda line, pixel: table.at(line, pixel) ** -2.0


@dataclass(frozen=True)
class _Swath:
    """What the file says of one image."""

    name: str
    """Of the image's data set."""
    polarization: str
    shape: tuple[int, int]
    times: np.ndarray
    """Zero-Doppler time of each row [s]."""
    ranges: np.ndarray
    """Slant range of each column [m]."""
    frequency_hz: float
    orbit: Orbit
    platform: str
    epoch: np.datetime64
    side: Side
    beta0: LineTable | None
    """Over lines and pixels: samples over it have beta0 as power."""
    bandwidth_hz: tuple[float | None, float | None]

    @classmethod
    def read(cls, path: Path, file: h5py.File, polarization: str) -> _Swath:
        base = _base(path, file)
        name, found = _image(path, file, f"{base}/swaths", polarization)
        folder = name.rsplit("/", 1)[0]
        shape = _check_image(path, file, name)
        times = _numbers(path, file, f"{base}/swaths/zeroDopplerTime", 1)
        ranges = _numbers(path, file, f"{folder}/slantRange", 1)
        frequency = float(_numbers(path, file, f"{folder}/processedCenterFrequency", 0))
        orbit = f"{base}/metadata/orbit"
        state = (
            _numbers(path, file, f"{orbit}/{key}", axes)
            for key, axes in (("time", 1), ("position", 2), ("velocity", 2))
        )
        root = base.rsplit("/", 1)[0]
        side: Side = "left" if _word(path, file, f"{root}/identification/lookDirection").lower() == "left" else "right"
        bands = tuple(
            float(_numbers(path, file, f"{folder}/{key}", 0)) if _find(path, file, f"{folder}/{key}") else None
            for key in ("processedRangeBandwidth", "processedAzimuthBandwidth")
        )
        return cls(
            name,
            found,
            shape,
            times,
            ranges,
            frequency,
            Orbit.of(str(path), *state),
            _word(path, file, f"{root}/identification/missionId"),
            _epoch(path, file, f"{base}/swaths/zeroDopplerTime"),
            side,
            _beta0(path, file, base, times, ranges),
            (bands[0], bands[1]),
        )


def _base(path: Path, file: h5py.File) -> str:
    bases = [f"science/{band}/{kind}" for kind in ("SLC", "RSLC") for band in ("LSAR", "SSAR")]
    base = next((name for name in bases if _find(path, file, name) is not None), None)
    if base is None:
        raise InputError(f"{path}: no science/LSAR/SLC (or RSLC, SSAR) in it; only such images are known")
    return base


def _polarizations(path: Path, file: h5py.File, wanted: str | None) -> list[str]:
    """Those of the images in frequency A where that has one that fits, else in B."""
    swaths = f"{_base(path, file)}/swaths"
    for band in ("frequencyA", "frequencyB"):
        found = [pol for pol in ("HH", "HV", "VH", "VV") if _find(path, file, f"{swaths}/{band}/{pol}") is not None]
        if fitting := [pol for pol in found if wanted in (None, pol)]:
            return fitting
    raise InputError(f"{path}: no image of polarization {wanted or 'HH, HV, VH or VV'} under {swaths}")


def _word(path: Path, file: h5py.File, name: str) -> str:
    """A short text; empty where there is none."""
    if _find(path, file, name) is None:
        return ""
    found = _data_set(path, file, name)[()]
    return found.decode("utf-8", "replace") if isinstance(found, bytes) else ""


def _epoch(path: Path, file: h5py.File, name: str) -> np.datetime64:
    """What times are counted from, by their unit: "seconds since 2006-07-20 00:00:00"; 1970 where it does not say."""
    unit = _data_set(path, file, name).attrs.get("units", b"")
    text = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else str(unit)
    since = re.search(r"since (\d{4}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)", text)
    return np.datetime64(f"{since[1]}T{since[2]}" if since else "1970-01-01T00:00:00", "us")


def _beta0(path: Path, file: h5py.File, base: str, times: np.ndarray, ranges: np.ndarray) -> LineTable | None:
    """The table of beta0 over lines and pixels; None where the file has none."""
    information = f"{base}/metadata/calibrationInformation"
    names = [f"{information}/{key}" for key in ("zeroDopplerTime", "slantRange")]
    table = next(
        (f"{information}/{key}" for key in ("geometry/beta0", "beta0") if _find(path, file, f"{information}/{key}")),
        None,
    )
    if table is None or any(_find(path, file, name) is None for name in names):
        return None
    at_times, at_ranges = (_numbers(path, file, name, 1) for name in names)
    values = _numbers(path, file, table, 2)
    if values.shape != (at_times.size, at_ranges.size) or not (values > 0.0).all():
        raise InputError(
            f"{path}: {table} has shape {values.shape}; must be positive, for {at_times.size} times and "
            f"{at_ranges.size} ranges"
        )
    lines = (at_times - times[0]) / (times[-1] - times[0]) * (times.size - 1)
    pixels = (at_ranges - ranges[0]) / (ranges[-1] - ranges[0]) * (ranges.size - 1)
    return LineTable(lines, (pixels,) * lines.size, tuple(values))


def _find(path: Path, file: h5py.File, name: str) -> h5py.Group | h5py.Dataset | None:
    """What lies in the file under a name; None where nothing does.

    Raises InputError for links: they lead into other files, or in circles.
    """
    import h5py

    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            return None
        if not isinstance(link, h5py.HardLink):
            raise InputError(f"{path}: {name} is a link; must be in the file itself")
        node = node[part]
    return node


def _data_set(path: Path, file: h5py.File, name: str) -> h5py.Dataset:
    """A data set; InputError unless its numbers are in the file itself, have bytes there, and are in small pieces."""
    import h5py

    found = _find(path, file, name)
    if not isinstance(found, h5py.Dataset):
        raise InputError(f"{path}: found {'no' if found is None else 'a group'} {name}; must be a data set")
    if found.external or found.is_virtual:
        raise InputError(f"{path}: the numbers of {name} are in other files; must be in the file itself")
    size = (found.size or 0) * found.dtype.itemsize
    stored = found.id.get_storage_size()
    piece = math.prod(found.chunks or (0,)) * found.dtype.itemsize
    if size > LARGEST_RATIO * stored or piece > LARGEST_CHUNK:
        raise InputError(
            f"{path}: {name} has shape {found.shape}, of which {stored} bytes are stored, in pieces of {piece}; must "
            f"be at most {LARGEST_RATIO} times what is stored, in pieces of up to {LARGEST_CHUNK} bytes"
        )
    return found


def _numbers(path: Path, file: h5py.File, name: str, axes: int) -> np.ndarray:
    """A data set of real and finite numbers with so many axes, float64."""
    found = _data_set(path, file, name)
    if found.dtype.kind not in "fiu" or len(found.shape or ()) != axes or (found.size or 0) > LARGEST_AXIS:
        raise InputError(
            f"{path}: {name} has shape {found.shape} and type {found.dtype}; must be up to {LARGEST_AXIS} real numbers "
            f"along {axes} axes"
        )
    values = np.asarray(found[()], np.float64)
    if not np.isfinite(values).all():
        raise InputError(f"{path}: {name} holds NaN or infinite values")
    return values


def _check_image(path: Path, file: h5py.File, name: str) -> tuple[int, int]:
    """Rows and columns of a complex image."""
    found = _data_set(path, file, name)
    kind = found.dtype
    pair = kind.names is not None and len(kind.names) == 2 and all(kind[each].kind in "fiu" for each in kind.names)
    if len(found.shape or ()) != 2 or not (kind.kind in "cfiu" or pair):
        raise InputError(f"{path}: {name} has shape {found.shape} and type {kind}; must be complex rows and columns")
    return found.shape[0], found.shape[1]


def _image(path: Path, file: h5py.File, swaths: str, polarization: str) -> tuple[str, str]:
    """Data set and polarization of the image: in frequency A where that has one, else in B."""
    names = [f"{swaths}/{band}/{polarization}" for band in ("frequencyA", "frequencyB")]
    return next(name for name in names if _find(path, file, name) is not None), polarization


FORMAT = Format(
    "nisar",
    "NISAR-style HDF5",
    "HDF5 signature",
    "single-look complex image, placed by orbit and zero Doppler",
    read,
    detect=lambda path, head: head.startswith(b"\x89HDF\r\n\x1a\n"),
    products=products,
    extra=EXTRA,
)
