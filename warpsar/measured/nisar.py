"""NISAR-style HDF5 single-look complex images (also UAVSAR in that form), placed by orbit and zero Doppler."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import Facts, ImageChip, direction_deg, reading
from warpsar.measured.earth import EarthFrame

MAGIC = b"\x89HDF\r\n\x1a\n"


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
        base = next((f"science/{band}" for band in ("LSAR", "SSAR") if f"science/{band}/SLC" in file), None)
        base = (
            f"{base}/SLC"
            if base
            else next((f"science/{b}/RSLC" for b in ("LSAR", "SSAR") if f"science/{b}/RSLC" in file), None)
        )
        if base is None:
            raise InputError(f"{path}: no science/LSAR/SLC (or RSLC, SSAR) in it; only such images are known")
        name, pol = _image(path, file, f"{base}/swaths", polarization)
        swath = file[name].parent
        shape = file[name].shape
        times, ranges = file[f"{base}/swaths/zeroDopplerTime"][()], swath["slantRange"][()]
        frequency = float(swath["processedCenterFrequency"][()])
        orbit = file[f"{base}/metadata/orbit"]
        track = _Track(*(np.asarray(orbit[key][()], np.float64) for key in ("time", "position", "velocity")))
    if shape != (times.size, ranges.size) or min(shape) < 2:
        raise InputError(f"{path}: {name} has shape {shape}, for {times.size} times and {ranges.size} ranges")
    numbers = (times, ranges, track.time, track.position, track.velocity)
    if not all(np.isfinite(values).all() for values in numbers):
        raise InputError(f"{path}: NaN in the times, ranges or orbit")
    time_step, range_step = (float(axis[-1] - axis[0]) / (axis.size - 1) for axis in (times, ranges))
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


def _image(path: Path, file: Any, swaths: str, wanted: str | None) -> tuple[str, str]:
    """Data set and polarization: of frequency A where it is there, else of B."""
    for band in ("frequencyA", "frequencyB"):
        group = file.get(f"{swaths}/{band}")
        found = [pol for pol in ("HH", "HV", "VH", "VV") if group is not None and pol in group]
        fitting = [pol for pol in found if wanted in (None, pol)]
        if len(fitting) == 1:
            return f"{swaths}/{band}/{fitting[0]}", fitting[0]
        if len(fitting) > 1:
            raise InputError(f"{path}: several polarizations ({', '.join(found)}); choose one with --polarization")
    raise InputError(f"{path}: no image of polarization {wanted or 'HH, HV, VH or VV'} under {swaths}")


class _Track:
    """Antenna positions and velocities between the orbit's state vectors: cubic Hermite, exact in both at each."""

    def __init__(self, time: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> None:
        from scipy.interpolate import CubicHermiteSpline

        self.time, self.position, self.velocity = time, position, velocity
        self._path = CubicHermiteSpline(time, position, velocity)
        self._speed = self._path.derivative()

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._path(time), self._speed(time)
