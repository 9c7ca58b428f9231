"""A track from a file: CSV in the world's metres, or the antenna of a CPHD."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from warpsar.errors import InputError
from warpsar.formats import cphd
from warpsar.formats.base.data import FARTHEST_M, reading
from warpsar.io import input_file
from warpsar.world.earth import EarthFrame, axes_at, needed
from warpsar.world.track import Track

_PLACE = ("x_m", "y_m", "z_m")
_SENDER = ("tx_x_m", "tx_y_m", "tx_z_m")
_LARGEST = 2**28
"""Bytes of a CSV."""


def read(path: Path, reference_m: NDArray[np.float64], frame: EarthFrame | None) -> Track:
    """The track about the reference point (3,) [m, world]. Raises InputError for what is no track."""
    found = _cphd(path, reference_m, frame) if _is_cphd(path) else _csv(path, reference_m)
    for name, values in (("time", found.time_s), ("place", found.receiver_m), ("transmitter", found.transmitter_m)):
        if not np.isfinite(values).all() or np.abs(values).max() > FARTHEST_M:
            raise InputError(f"{path}: found a {name} that is no number, or beyond {FARTHEST_M:g}; must be finite")
    if len(found) < 2 or (np.diff(found.time_s) <= 0.0).any():
        raise InputError(f"{path}: found {len(found)} pulses; must be two or more, at times that ascend")
    return found


def read_error(path: Path, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """The recorded track less the true one at times (p,) [s], (p, 3) [m]; a cubic spline between the file's."""
    found = _csv(path, np.zeros(3))
    if not np.isfinite(found.receiver_m).all() or len(found) < 4 or not (np.diff(found.time_s) > 0.0).all():
        raise InputError(f"{path}: found {len(found)} places; must be four or more finite ones, at times that ascend")
    low, high = found.time_s[[0, -1]]
    if low > time_s[0] or high < time_s[-1]:
        raise InputError(
            f"{path}: found times of {low:g} to {high:g} s; must hold all pulses, {time_s[0]:g} to {time_s[-1]:g} s"
        )
    return np.asarray(CubicSpline(found.time_s, found.receiver_m)(time_s))


def _is_cphd(path: Path) -> bool:
    with reading(path, "track"), path.open("rb") as file:
        return file.read(len(cphd.MAGIC)) == cphd.MAGIC


def _csv(path: Path, reference_m: NDArray[np.float64]) -> Track:
    text = input_file.read_text(path, "a CSV track", _LARGEST)
    with reading(path, "CSV track", csv.Error):
        lines_of_text = io.StringIO(text, newline="")
        rows = csv.reader(line for line in lines_of_text if line.strip() and not line.startswith("#"))
        names = [name.strip() for name in next(rows, [])]
        wanted = ("time_s", *_PLACE)
        if not set(wanted) <= set(names):
            raise InputError(f"{path}: found the columns {', '.join(names) or 'none'}; must have {', '.join(wanted)}")
        lines = list(rows)
        for number, row in enumerate(lines, 1):
            if len(row) != len(names):
                raise InputError(f"{path}: pulse {number}: found {len(row)} cells; must be {len(names)}, one a column")
        table = np.array([[float(cell) for cell in row] for row in lines], np.float64).reshape(-1, len(names))

    def column(name: str) -> NDArray[np.float64]:
        return table[:, names.index(name)]

    receiver = np.stack([column(name) for name in _PLACE], axis=1) - reference_m
    both = set(_SENDER) <= set(names)
    transmitter = np.stack([column(name) for name in _SENDER], axis=1) - reference_m if both else receiver
    return Track(column("time_s"), receiver, transmitter)


def _cphd(path: Path, reference_m: NDArray[np.float64], frame: EarthFrame | None) -> Track:
    """Antennas of the first channel, in the tangent frame at the reference point."""
    world = needed(frame, path)
    time, sent, received, bistatic = cphd.antennas(path)
    axes, origin = axes_at(world, reference_m), world.to_ecef(reference_m)
    sent, received = ((place - origin) @ axes.T for place in (sent, received))
    if bistatic:
        return Track(time, received, sent)
    middle = 0.5 * (sent + received)  # one antenna in flight stands for both ways in their middle
    return Track(time, middle, middle)
