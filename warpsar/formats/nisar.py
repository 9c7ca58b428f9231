"""NISAR-style HDF5 single-look complex images (also UAVSAR in that form), placed by orbit and zero Doppler."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from warpsar.errors import InputError
from warpsar.formats.base.data import Facts, ImageChip, direction_deg, reading
from warpsar.formats.base.extra import Extra
from warpsar.formats.base.format import Format, Stated
from warpsar.world.earth import needed

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


def read(path: Path, stated: Stated) -> ImageChip:
    """The image, placed by its orbit: rows are zero-Doppler time, columns slant range.

    The frame says where the world lies on the earth (a mesh that is a DEM, or an origin given by the user): the file
    does not fix it. Raises InputError without it.
    """
    EXTRA.require(f"{path}: HDF5")
    import h5py

    with reading(path, "HDF5 file"), h5py.File(path) as file:
        swath = _Swath.read(path, file, stated.polarization)
    times, ranges, track = swath.times, swath.ranges, swath.track
    if swath.shape != (times.size, ranges.size) or min(swath.shape) < 2:
        raise InputError(
            f"{path}: {swath.name} has shape {swath.shape}, for {times.size} times and {ranges.size} ranges"
        )
    time_step, range_step = (float(axis[-1] - axis[0]) / (axis.size - 1) for axis in (times, ranges))
    if time_step == 0.0 or range_step == 0.0 or not (track.velocity**2).sum(-1).min() > 0.0:
        raise InputError(f"{path}: times, ranges and positions must change along their axes, but do not")
    world = needed(stated.frame, path)

    def locate(points_m: np.ndarray) -> np.ndarray:
        time, distance = track.abeam(world.to_ecef(points_m), times[times.size // 2], 1e-3 * abs(time_step))
        return np.stack([(time - times[0]) / time_step, (distance - ranges[0]) / range_step], axis=-1)

    def facts(reference_point_m: np.ndarray) -> Facts:
        point = world.to_ecef(reference_point_m)
        time, distance = track.abeam(point, times[times.size // 2], 1e-3 * abs(time_step))
        azimuth, incidence = direction_deg(track.at(time)[0] - point, world, reference_point_m)
        return Facts(azimuth, incidence, swath.frequency_hz, swath.polarization, float(distance), strip_map=True)

    speed = float(np.linalg.norm(track.at(np.array(times.mean()))[1]))
    return ImageChip(
        source=str(path),
        samples=_Window(path, swath.name, swath.shape),
        quantity="complex",
        facts=facts,
        spacing_m=(speed * abs(time_step), abs(range_step)),
        locate=locate,
    )


class _Track:
    """Antenna positions and velocities between the orbit's state vectors: cubic Hermite, exact in both at each."""

    def __init__(self, time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> None:
        self.time, self.position, self.velocity = time, position, velocity
        self._path = CubicHermiteSpline(time, position, velocity)
        self._speed = self._path.derivative()

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position [m] and velocity [m/s], (..., 3) each, at times [s]."""
        return self._path(time), self._speed(time)

    def abeam(self, points: np.ndarray, start_s: float, tolerance_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Time [s] and slant range [m] of zero Doppler for earth-centred points (..., 3) [m], by Newton's method."""
        time = np.full(points.shape[:-1], start_s)
        for _ in range(20):
            position, velocity = self.at(time)
            offset = points - position
            change = (offset * velocity).sum(-1) / (velocity**2).sum(-1)
            time = time + change
            if np.abs(change).max(initial=0.0) < tolerance_s:
                break
        return time, np.linalg.norm(points - self.at(time)[0], axis=-1)


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
    track: _Track

    @classmethod
    def read(cls, path: Path, file: h5py.File, polarization: str | None) -> _Swath:
        bases = [f"science/{band}/{kind}" for kind in ("SLC", "RSLC") for band in ("LSAR", "SSAR")]
        base = next((name for name in bases if _find(path, file, name) is not None), None)
        if base is None:
            raise InputError(f"{path}: no science/LSAR/SLC (or RSLC, SSAR) in it; only such images are known")
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
        return cls(name, found, shape, times, ranges, frequency, _Track(*state))


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


def _image(path: Path, file: h5py.File, swaths: str, wanted: str | None) -> tuple[str, str]:
    """Data set and polarization of the image: in frequency A where that has one, else in B."""
    for band in ("frequencyA", "frequencyB"):
        found = [pol for pol in ("HH", "HV", "VH", "VV") if _find(path, file, f"{swaths}/{band}/{pol}") is not None]
        fitting = [pol for pol in found if wanted in (None, pol)]
        if len(fitting) == 1:
            return f"{swaths}/{band}/{fitting[0]}", fitting[0]
        if len(fitting) > 1:
            raise InputError(f"{path}: several polarizations ({', '.join(found)}); choose one with --polarization")
    raise InputError(f"{path}: no image of polarization {wanted or 'HH, HV, VH or VV'} under {swaths}")


FORMAT = Format(
    "nisar",
    "NISAR-style HDF5",
    "HDF5 signature",
    "single-look complex image, placed by orbit and zero Doppler",
    read,
    detect=lambda path, head: head.startswith(b"\x89HDF\r\n\x1a\n"),
    extra=EXTRA,
)
