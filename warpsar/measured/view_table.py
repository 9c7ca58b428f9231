"""A table of views beside chips that do not say themselves from where they were taken: a CSV file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from warpsar.errors import InputError
from warpsar.io import input_file
from warpsar.scene.file import refuse
from warpsar.world.problems import first_problem
from warpsar.world.tables import View

NAMES = ("chip", "view", "name")
ELEVATIONS = ("incidence_deg", "depression_deg", "grazing_deg")
_LARGEST_BYTES = 2**24


def read(path: Path) -> dict[str, View]:
    """The views of a table, by chip name: columns `chip` (or view, or name), azimuth_deg, one of incidence_deg,
    depression_deg and grazing_deg, and, if stated, role and looks. Other columns are not read.

    Raises InputError, one message with all that is wrong, before any image is read.
    """
    text = input_file.read_text(path, "a table of views", _LARGEST_BYTES)
    try:
        reader = csv.DictReader(io.StringIO(text, newline=""))
        rows, columns = list(reader), list(reader.fieldnames or [])
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as a table of views ({error})") from None
    name = _one_of(path, columns, NAMES)
    elevation = _one_of(path, columns, ELEVATIONS)
    if "azimuth_deg" not in columns:
        raise InputError(f"{path}: found the columns {', '.join(columns)}; azimuth_deg is missing")
    found: dict[str, View] = {}
    problems: list[str] = []
    for number, row in enumerate(rows, 2):
        stated = {key: row.get(key) for key in ("azimuth_deg", elevation, "looks", "role") if row.get(key)}
        if row[name] in found:
            problems.append(f"line {number}: {row[name]} stands twice")
            continue
        try:
            found[row[name]] = View.model_validate({"name": row[name]} | {k: _value(k, v) for k, v in stated.items()})
        except ValueError as error:
            problems.append(f"line {number} ({row[name]}): {first_problem(error, View)}")
    refuse(path, problems)
    return found


def chosen(path: Path, views: dict[str, View], sources: Iterable[Path]) -> list[tuple[Path, View]]:
    """Every source with the view that its file name, less the suffix, names. Raises InputError for one without."""
    pairs, problems, seen = [], [], set()
    for source in sources:
        if source.stem in seen:
            problems.append(f"{source}: a chip of this name is given twice")
        elif source.stem not in views:
            problems.append(f"{source}: no line of the table is called {source.stem}")
        else:
            pairs.append((source, views[source.stem]))
        seen.add(source.stem)
    refuse(path, problems)
    return pairs


def _one_of(path: Path, columns: list[str], allowed: tuple[str, ...]) -> str:
    found = [column for column in columns if column in allowed]
    if len(found) != 1:
        raise InputError(
            f"{path}: found the columns {', '.join(columns)}; exactly one of {', '.join(allowed)} is needed"
        )
    return found[0]


def _value(key: str, text: Any) -> Any:
    if key == "role":
        return text
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    return number if math.isfinite(number) else text
