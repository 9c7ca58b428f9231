"""The two-way pattern of an antenna from a table: gain and phase over two angles off its axis."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from warpsar.errors import InputError
from warpsar.formats.base.data import reading
from warpsar.io import input_file

F64 = NDArray[np.float64]
FINER = 8
"""Steps of the kernels' table in one of the file's: between them amplitudes are linear."""
_LARGEST = 2**26
"""Bytes of a file."""
_EVEN = 1e-3
"""Share of a step by which one may differ from the others."""


@dataclass(frozen=True)
class AntennaPatternTable:
    """Complex two-way amplitude at equidistant angles."""

    start_deg: tuple[float, float]
    """Least azimuth and elevation off the axis."""
    step_deg: tuple[float, float]
    """0 along an axis on which the pattern is even."""
    amplitude: NDArray[np.complex64]
    """(azimuths, elevations); nothing beyond."""

    def at(self, azimuth_deg: F64, elevation_deg: F64) -> NDArray[np.complex128]:
        """Linear between the table's, as the kernels have it, (...)."""
        total = np.zeros(np.shape(azimuth_deg), np.complex128)
        places = []
        for angle, start, step, count in zip(
            (azimuth_deg, elevation_deg), self.start_deg, self.step_deg, self.amplitude.shape, strict=True
        ):
            place = (np.asarray(angle) - start) / step if step else np.zeros(np.shape(angle))
            low = np.floor(place).clip(0, max(count - 2, 0)).astype(int)
            places.append((low, place - low, (place >= 0.0) & (place <= count - 1), min(1, count - 1)))
        (i, u, within, one), (j, v, above, other) = places
        for di, share in ((0, 1.0 - u), (one, u)):
            for dj, more in ((0, 1.0 - v), (other, v)):
                total += share * more * self.amplitude[i + di, j + dj]
        return np.where(within & above, total, 0.0)


def read(path: Path) -> AntennaPatternTable:
    """A CSV of azimuth_deg, gain_db and where there are elevation_deg and phase_deg. Raises InputError for others."""
    text = input_file.read_text(path, "a CSV pattern", _LARGEST)
    with reading(path, "CSV pattern", csv.Error):
        lines = io.StringIO(text, newline="")
        rows = csv.DictReader(line for line in lines if line.strip() and not line.startswith("#"))
        names = rows.fieldnames or []
        if not {"azimuth_deg", "gain_db"} <= set(names):
            found = ", ".join(names) or "none"
            raise InputError(f"{path}: found the columns {found}; must have azimuth_deg, gain_db")
        wanted = ("azimuth_deg", "elevation_deg", "gain_db", "phase_deg")
        table = np.array([[float(row[name]) if name in names else 0.0 for name in wanted] for row in rows], float)
    table = table.reshape(-1, 4)
    if not np.isfinite(table).all() or len(table) < 2:
        raise InputError(f"{path}: found {len(table)} rows, or numbers that are not finite; must be two or more")
    axes = [np.unique(table[:, axis]) for axis in (0, 1)]
    steps = [np.diff(axis) for axis in axes]
    even = all(len(one) == 0 or np.ptp(one) <= _EVEN * one.mean() for one in steps)
    order = np.lexsort((table[:, 1], table[:, 0]))
    whole = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    if len(axes[0]) < 2 or not even or len(whole) != len(table) or not np.array_equal(table[order, :2], whole):
        raise InputError(
            f"{path}: found {len(table)} rows of {len(axes[0])} azimuths and {len(axes[1])} elevations; must be a "
            "regular grid, one row for each pair, two azimuths or more"
        )
    if np.abs(table[:, :2]).max() > 90.0:
        raise InputError(f"{path}: found angles beyond 90 degrees; must be off the beam's axis")
    if any(axes[k][0] > 0.0 or axes[k][-1] < 0.0 for k in (0, 1)):
        raise InputError(
            f"{path}: found azimuths of {axes[0][0]:g} to {axes[0][-1]:g} and elevations of {axes[1][0]:g} to "
            f"{axes[1][-1]:g} degrees; must hold the beam's axis, 0 and 0, about which images are calibrated"
        )
    value = 10.0 ** (table[order, 2] / 20.0) * np.exp(1j * np.deg2rad(table[order, 3]))
    return _finer(axes, value.reshape(len(axes[0]), len(axes[1])))


def _finer(axes: list[F64], value: NDArray[np.complex128]) -> AntennaPatternTable:
    """Cubic between the file's angles."""
    both = len(axes[1]) > 1
    given = axes if both else [axes[0], np.array([0.0, 1.0])]
    wide = value if both else np.repeat(value, 2, axis=1)
    cubic = [min(3, len(axis) - 1) for axis in given]
    fine = [np.linspace(axis[0], axis[-1], FINER * (len(axis) - 1) + 1) for axis in given]
    if not both:
        fine[1] = np.array([0.0])
    parts = [
        RectBivariateSpline(given[0], given[1], part, kx=cubic[0], ky=cubic[1])(fine[0], fine[1])
        for part in (wide.real, wide.imag)
    ]
    steps = [float(axis[1] - axis[0]) if len(axis) > 1 else 0.0 for axis in fine]
    starts = [float(axis[0]) for axis in fine]
    return AntennaPatternTable(
        (starts[0], starts[1]), (steps[0], steps[1]), (parts[0] + 1j * parts[1]).astype(np.complex64)
    )
