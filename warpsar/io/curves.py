"""Curves of radar cross-section against angle, read from text: CSV with named columns, or the Austin suite's own."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io import input_file
from warpsar.io.images import replacing

LARGEST_FILE = 2**26
"""Bytes: about a million rows."""
LARGEST_DBSM = 200.0
FREQUENCY_STEP = 1e-3
"""Rows whose frequencies differ by less than this share belong to one curve."""
COLUMNS = ("frequency_hz", "theta_deg", "phi_deg", "rcs_dbsm")
"""Of a CSV; `polarization` may stand beside them. `incidence_deg` and `azimuth_deg` may stand for theta and phi."""
_SUITE = re.compile(r"_rcs\..*\.(?P<polarization>[HV])(\.|$)", re.IGNORECASE)


@dataclass(frozen=True)
class RcsTable:
    """The rows of a file. Arrays have the shape (rows,)."""

    path: Path
    frequency_hz: NDArray[np.float64]
    azimuth_deg: NDArray[np.float64]
    """Clockwise from north, as a scene has it: 90 - phi."""
    incidence_deg: NDArray[np.float64]
    """From the zenith: theta."""
    rcs_m2: NDArray[np.float64]
    """NaN where the file has no number."""
    polarization: tuple[str, ...]
    """Of each row; empty where the file does not say."""

    def frequencies_hz(self) -> list[float]:
        """One for each group of rows that are alike, ascending."""
        groups: list[float] = []
        for value in np.unique(self.frequency_hz).tolist():
            if not groups or value > groups[-1] * (1.0 + FREQUENCY_STEP):
                groups.append(value)
        return groups

    def select(self, frequency_hz: float | None, polarization: str | None) -> RcsTable:
        """The rows of one curve. Raises InputError where the choice is open, or fits no row."""
        frequencies, known = self.frequencies_hz(), sorted({*self.polarization} - {""})
        listed = ", ".join(f"{each:.10g}" for each in frequencies)
        if frequency_hz is None and len(frequencies) > 1:
            raise InputError(f"{self.path}: found the frequencies {listed} Hz; frequency_hz must name one")
        wanted = frequencies[0] if frequency_hz is None else frequency_hz
        keep = np.abs(self.frequency_hz - wanted) <= FREQUENCY_STEP * wanted
        if not keep.any():
            raise InputError(f"{self.path}: found no row at {wanted:.10g} Hz; it has {listed} Hz")
        if polarization is None and len(known) != 1:
            raise InputError(f"{self.path}: found {', '.join(known) or 'no polarization'}; polarization must name one")
        pol = known[0] if polarization is None else polarization
        if known:
            keep &= np.array([each in ("", pol) for each in self.polarization])
        if not keep.any():
            raise InputError(f"{self.path}: found no row of {pol}; it has {', '.join(known)}")
        rows = np.flatnonzero(keep)
        arrays = (self.frequency_hz, self.azimuth_deg, self.incidence_deg, self.rcs_m2)
        frequency, azimuth, incidence, power = (each[rows] for each in arrays)
        return RcsTable(self.path, frequency, azimuth, incidence, power, (pol,) * len(rows))

    def used(self, mask: Sequence[tuple[float, float]] | None) -> NDArray[np.bool_]:
        """Rows that hold a number and that the mask lets through, (rows,)."""
        finite = np.isfinite(self.rcs_m2)
        if mask is None:
            return finite
        inside = [(self.azimuth_deg >= low - 1e-9) & (self.azimuth_deg <= high + 1e-9) for low, high in mask]
        chosen: NDArray[np.bool_] = finite & np.any(inside, axis=0)
        return chosen


def read(path: Path) -> RcsTable:
    """Read a file of curves. Raises InputError, one message that names the file."""
    text = input_file.read_text(path, "a file of curves", LARGEST_FILE)
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    numbers = _numbers(first.replace(",", " ").split())
    table = _suite(path, text) if numbers is not None else _csv(path, text)
    return _checked(table)


def read_profiles(
    path: Path,
    bins: int,
    chosen: int,
    azimuths_deg: tuple[float, float],
    incidence_deg: float,
    every: int,
    frequency_hz: float,
) -> RcsTable:
    """One bin of complex64 range profiles, direction by direction; `rcs_m2` is its power in the file's own unit.

    Azimuths go evenly from the first to the last. Raises InputError.
    """
    data = input_file.read_bytes(path, "a file of range profiles", LARGEST_FILE)
    size = len(data)
    if not size or size % (8 * bins):
        raise InputError(f"{path}: found {size} bytes; must be a multiple of {8 * bins}, {bins} bins of complex64")
    samples = np.frombuffer(data, "<c8").reshape(-1, bins)[:, chosen]
    azimuth = np.linspace(*azimuths_deg, len(samples))[::every]
    power = np.abs(samples[::every].astype(np.complex128)) ** 2
    if not np.isfinite(power).all():
        raise InputError(f"{path}: found a sample that is no number; must be complex64")
    same = np.ones(len(azimuth))
    return RcsTable(path, frequency_hz * same, azimuth, incidence_deg * same, power, ("",) * len(azimuth))


def write_csv(path: Path, table: RcsTable) -> None:
    """Write a table as CSV with the columns `COLUMNS` and `polarization`."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow((*COLUMNS, "polarization"))
        with np.errstate(divide="ignore"):
            decibels = 10.0 * np.log10(table.rcs_m2)
        columns = (table.frequency_hz, table.incidence_deg, 90.0 - table.azimuth_deg, decibels)
        for row, pol in zip(zip(*(c.tolist() for c in columns), strict=True), table.polarization, strict=True):
            writer.writerow((*(f"{value:.12g}" for value in row), pol))


def _numbers(words: Sequence[str]) -> list[float] | None:
    try:
        return [float(word) for word in words] if words else None
    except ValueError:
        return None


def _suite(path: Path, text: str) -> RcsTable:
    """Four columns without names: frequency [Hz], theta, phi [deg], RCS [dBsm]; the file's name has H or V."""
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        row = _numbers(words)
        if row is None or len(row) != 4:
            raise InputError(
                f"{path}: line {number}: found {line.strip()[:60]!r}; must be four numbers: frequency [Hz], theta, phi "
                "[deg], RCS [dBsm]"
            )
        rows.append(row)
    found = _SUITE.search(path.name)
    pol = "" if found is None else found["polarization"].upper() * 2
    return _table(path, np.array(rows).reshape(-1, 4), phi=True, polarization=[pol] * len(rows))


def _csv(path: Path, text: str) -> RcsTable:
    reader = csv.reader(io.StringIO(text))
    header = [name.strip().lower() for name in next(reader, [])]
    phi = "phi_deg" in header
    theta = "theta_deg" if "theta_deg" in header else "incidence_deg"
    names = ("frequency_hz", theta, "phi_deg" if phi else "azimuth_deg", "rcs_dbsm")
    missing = [one for one, name in zip(COLUMNS, names, strict=True) if name not in header]
    if missing:
        raise InputError(
            f"{path}: found the columns {', '.join(header)[:200] or 'none'}; {', '.join(missing)} must be there "
            "(incidence_deg may stand for theta_deg, azimuth_deg for phi_deg)"
        )
    at, pol = [header.index(name) for name in names], header.index("polarization") if "polarization" in header else None
    rows, pols = [], []
    try:
        for words in reader:
            if not words:
                continue
            row = _numbers([words[i] or "nan" for i in at]) if len(words) > max(at) else None
            if row is None or (pol is not None and len(words) <= pol):
                raise InputError(f"{path}: line {reader.line_num}: found {','.join(words)[:60]!r}; must hold numbers")
            rows.append(row)
            pols.append("" if pol is None else words[pol].strip().upper())
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: no CSV ({error})") from error
    return _table(path, np.array(rows).reshape(-1, 4), phi=phi, polarization=pols)


def _table(path: Path, rows: NDArray[np.float64], *, phi: bool, polarization: Sequence[str]) -> RcsTable:
    with np.errstate(over="ignore"):
        power = 10.0 ** (rows[:, 3] / 10.0)
    azimuth = 90.0 - rows[:, 2] if phi else rows[:, 2]
    return RcsTable(path, rows[:, 0], azimuth, rows[:, 1], power, tuple(polarization))


def _checked(table: RcsTable) -> RcsTable:
    """Itself; raises InputError for numbers that no measurement can have."""
    if not table.rcs_m2.size:
        raise InputError(f"{table.path}: found no row; must hold at least one")
    bounds = {
        "frequency_hz": (table.frequency_hz, 1e6, 1e13),
        "theta_deg": (table.incidence_deg, 0.0, 180.0),
        "phi_deg": (90.0 - table.azimuth_deg, -360.0, 450.0),
    }
    for name, (values, low, high) in bounds.items():
        bad = ~((values >= low) & (values <= high))  # NaN is between nothing
        if bad.any():
            raise InputError(f"{table.path}: found {name} = {values[bad][0]:g}; must be from {low:g} to {high:g}")
    high = table.rcs_m2 > 10.0 ** (LARGEST_DBSM / 10.0)
    if high.any():
        worst = table.rcs_m2[high][0]
        raise InputError(f"{table.path}: found an RCS of {worst:.3g} m2; must be at most {LARGEST_DBSM:g} dBsm")
    if np.isnan(table.rcs_m2).all():
        raise InputError(f"{table.path}: found no number among the RCS; must be dBsm")
    if bad_names := sorted({*table.polarization} - {"", "HH", "HV", "VH", "VV"}):
        raise InputError(f"{table.path}: found the polarization {bad_names[0]!r}; must be one of HH, HV, VH, VV")
    return table
