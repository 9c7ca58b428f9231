"""A table of sigma0 over incidence for each polarization, read from CSV: what a material with the model `facet` has."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, shown
from warpsar.io import input_file
from warpsar.io.images import replacing
from warpsar.kernels.codes import Polarization

LARGEST_FILE = 2**22
"""Bytes: more rows than an angle has."""
LARGEST_DB = 100.0
ANGLE = "incidence_deg"
CHANNELS = ("HH", "VV", "HV")
"""Columns of sigma0 [dB]; HV is VH too."""
SPREAD_DB = 3.0
"""What a fit expects of a value's difference from the table as given."""
WIDTH_DEG = 10.0
"""Incidence over which these differences are alike."""
ROW_DB = 0.25
"""By which a row differs from what is smooth."""


@dataclass(frozen=True)
class Sigma0Table:
    """`incidence_deg`, (n,), ascending; `sigma0_db`, by polarization, each (n,)."""

    incidence_deg: NDArray[np.float64]
    sigma0_db: dict[str, NDArray[np.float64]]

    def column(self, polarization: str) -> str | None:
        """The column of a polarization; a like one that is missing has the other one's, and HV that is missing none."""
        own = "HV" if polarization == "VH" else polarization
        other = {"HH": "VV", "VV": "HH"}.get(polarization, "")
        return next((name for name in (own, other) if name in self.sigma0_db), None)

    def filled(self, column: str) -> list[int]:
        """The polarizations, as `kernels.codes` numbers them, whose values a column gives."""
        return [int(one) for one in Polarization if self.column(one.name) == column]

    def channel(self, polarization: str) -> NDArray[np.float64]:
        """The values of a polarization's column; -300 dB without one."""
        name = self.column(polarization)
        return np.full(self.incidence_deg.size, -300.0) if name is None else self.sigma0_db[name]

    def prior_root(self) -> NDArray[np.float64]:
        """A root of the covariance that a fit expects of a column's differences from the table as given, (n, n) [dB].

        The covariance is SPREAD^2 exp(-(difference of incidence / WIDTH)^2 / 2), and ROW^2 of each row alone.
        """
        apart = (self.incidence_deg[:, None] - self.incidence_deg) / WIDTH_DEG
        covariance = SPREAD_DB**2 * np.exp(-0.5 * apart**2) + ROW_DB**2 * np.eye(len(apart))
        return np.asarray(np.linalg.cholesky(covariance), np.float64)

    def write(self, path: Path) -> None:
        """Write it as CSV, which `read` gives back to the bit."""
        columns = [self.incidence_deg, *self.sigma0_db.values()]
        with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow([ANGLE, *self.sigma0_db])
            writer.writerows(np.column_stack(columns).tolist())


def read(path: Path) -> Sigma0Table:
    """Read columns `incidence_deg` and one or more of HH, VV, HV [dB]. Raises InputError."""
    text = input_file.read_text(path, f"a CSV of {ANGLE} and {', '.join(CHANNELS)}", LARGEST_FILE)
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text)) if any(map(str.strip, row))]
    except csv.Error as error:
        raise InputError(f"{path}: {error}; must be a CSV") from None
    head = rows[0] if rows else []
    known = {ANGLE, *CHANNELS}
    if ANGLE not in head or len(set(head)) < len(head) or not set(head) <= known or len(head) < 2:
        raise InputError(
            f"{path}: found the columns {', '.join(head) or 'none'}; "
            f"must be {ANGLE} and one or more of {', '.join(CHANNELS)}"
        )
    values = np.empty((len(rows) - 1, len(head)))
    for number, row in enumerate(rows[1:]):
        try:
            values[number] = [float(cell) for cell in row]
        except ValueError:
            raise InputError(f"{path}: row {number + 2}: found {row}; must be {len(head)} numbers") from None
    columns = dict(zip(head, values.T, strict=True))
    angles = columns.pop(ANGLE)
    if angles.size < 2:
        raise InputError(f"{path}: found {angles.size} rows; must be two or more")
    # as float32, because kernels divide by the difference of two rows
    if not ((angles >= 0) & (angles <= 90)).all() or not (np.diff(angles.astype(np.float32)) > 0).all():
        raise InputError(f"{path}: {ANGLE}: found {shown(angles.tolist())}; must ascend, within 0 to 90, in float32")
    for name, column in columns.items():
        if not (np.abs(column) <= LARGEST_DB).all():
            raise InputError(f"{path}: {name}: must be numbers within -{LARGEST_DB:g} and {LARGEST_DB:g} dB")
    return Sigma0Table(angles, columns)
