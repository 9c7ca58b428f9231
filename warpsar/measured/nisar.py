"""NISAR-style HDF5 single-look complex images (also UAVSAR in that form), placed by orbit and zero Doppler."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from warpsar.errors import InputError
from warpsar.measured.data import Facts, ImageChip, direction_deg, reading
from warpsar.measured.earth import EarthFrame

MAGIC = b"\x89HDF\r\n\x1a\n"
LARGEST_AXIS = 2**24
"""Times, ranges, or numbers of the orbit."""
LARGEST_CHUNK = 2**26
"""Bytes that HDF5 unpacks to reach one number; NISAR's are 2 MiB."""
LARGEST_RATIO = 1100
"""Bytes of a data set to those that are stored of it: deflate packs 1032 to 1."""


class _Window:
    """One HDF5 data set, opened only where it is sliced."""

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


def read(path: Path, polarization: str | None, frame: EarthFrame | None) -> ImageChip:
    """Rows are zero-Doppler time, columns slant range. `frame` says where the world lies on the earth: a DEM's mesh, or
    an origin given by the user; the file alone does not fix it."""
    try:
        import h5py
    except ImportError as error:
        raise InputError(f'{path}: HDF5 needs h5py: pip install "warpsar[hdf5]"') from error
    with reading(path, "HDF5 file"), h5py.File(path) as file:
        bases = [f"science/{band}/{kind}" for kind in ("SLC", "RSLC") for band in ("LSAR", "SSAR")]
        base = next((name for name in bases if _find(path, file, name) is not None), None)
        if base is None:
            raise InputError(f"{path}: no science/LSAR/SLC (or RSLC, SSAR) in it; only such images are known")
        name, pol = _image(path, file, f"{base}/swaths", polarization)
        swath = name.rsplit("/", 1)[0]
        shape = _check_image(path, file, name)
        times = _numbers(path, file, f"{base}/swaths/zeroDopplerTime", 1)
        ranges = _numbers(path, file, f"{swath}/slantRange", 1)
        frequency = float(_numbers(path, file, f"{swath}/processedCenterFrequency", 0))
        orbit = f"{base}/metadata/orbit"
        time, position, velocity = (
            _numbers(path, file, f"{orbit}/{key}", axes)
            for key, axes in (("time", 1), ("position", 2), ("velocity", 2))
        )
        track = _Track(time, position, velocity)
    if shape != (times.size, ranges.size) or min(shape) < 2:
        raise InputError(f"{path}: {name} has shape {shape}, for {times.size} times and {ranges.size} ranges")
    time_step, range_step = (float(axis[-1] - axis[0]) / (axis.size - 1) for axis in (times, ranges))
    if time_step == 0.0 or range_step == 0.0 or not (track.velocity**2).sum(-1).min() > 0.0:
        raise InputError(f"{path}: times, ranges and positions must change along their axes, but do not")
    if frame is None:
        raise InputError(
            f"{path}: where the world lies on the earth is not said; use a mesh that is a GeoTIFF DEM, or --origin "
            "with latitude, longitude and ellipsoidal height of the world's origin"
        )
    world = frame

    def zero_doppler(points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Time [s] and slant range [m] at which each point is abeam."""
        points = world.to_ecef(points_m)
        time = np.full(points.shape[:-1], times[times.size // 2])
        for _ in range(20):
            position, velocity = track.at(time)
            offset = points - position
            change = (offset * velocity).sum(-1) / (velocity**2).sum(-1)
            time = time + change
            if np.abs(change).max(initial=0.0) < 1e-3 * abs(time_step):
                break
        return time, np.linalg.norm(points - track.at(time)[0], axis=-1)

    def locate(points_m: np.ndarray) -> np.ndarray:
        time, distance = zero_doppler(points_m)
        return np.stack([(time - times[0]) / time_step, (distance - ranges[0]) / range_step], axis=-1)

    def facts(reference_point_m: np.ndarray) -> Facts:
        time, distance = zero_doppler(reference_point_m)
        toward = track.at(time)[0] - world.to_ecef(reference_point_m)
        azimuth, incidence = direction_deg(toward, world, reference_point_m)
        return Facts(azimuth, incidence, frequency, pol, float(distance), strip_map=True)

    speed = float(np.linalg.norm(track.at(np.array(times.mean()))[1]))
    return ImageChip(
        source=str(path),
        samples=_Window(path, name, shape),
        quantity="complex",
        facts=facts,
        spacing_m=(speed * abs(time_step), abs(range_step)),
        locate=locate,
    )


def _find(path: Path, file: Any, name: str) -> Any:
    """What lies in the file under a name, None where nothing does. Links lead into other files, or in circles."""
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


def _data_set(path: Path, file: Any, name: str) -> Any:
    """A data set whose numbers are in the file itself, as many as it has bytes for, and in pieces of bounded size."""
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


def _numbers(path: Path, file: Any, name: str, axes: int) -> np.ndarray:
    """A data set of real numbers with so many axes, float64."""
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


def _check_image(path: Path, file: Any, name: str) -> tuple[int, int]:
    found = _data_set(path, file, name)
    kind = found.dtype
    pair = kind.names is not None and len(kind.names) == 2 and all(kind[each].kind in "fiu" for each in kind.names)
    if len(found.shape or ()) != 2 or not (kind.kind in "cfiu" or pair):
        raise InputError(f"{path}: {name} has shape {found.shape} and type {kind}; must be complex rows and columns")
    return found.shape[0], found.shape[1]


def _image(path: Path, file: Any, swaths: str, wanted: str | None) -> tuple[str, str]:
    """Data set and polarization: of frequency A where it is there, else of B."""
    for band in ("frequencyA", "frequencyB"):
        found = [pol for pol in ("HH", "HV", "VH", "VV") if _find(path, file, f"{swaths}/{band}/{pol}") is not None]
        fitting = [pol for pol in found if wanted in (None, pol)]
        if len(fitting) == 1:
            return f"{swaths}/{band}/{fitting[0]}", fitting[0]
        if len(fitting) > 1:
            raise InputError(f"{path}: several polarizations ({', '.join(found)}); choose one with --polarization")
    raise InputError(f"{path}: no image of polarization {wanted or 'HH, HV, VH or VV'} under {swaths}")


class _Track:
    """Antenna positions and velocities between the orbit's state vectors: cubic Hermite, exact in both at each."""

    def __init__(self, time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> None:
        self.time, self.position, self.velocity = time, position, velocity
        self._path = CubicHermiteSpline(time, position, velocity)
        self._speed = self._path.derivative()

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._path(time), self._speed(time)
