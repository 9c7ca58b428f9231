"""A file of poses: a CSV with a body in each line, such as a survey of parked vehicles."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from warpsar.errors import InputError
from warpsar.io import input_file
from warpsar.world.objects.table import Object
from warpsar.world.problems import first_problem

POSITION = (("east_m", "x_m"), ("north_m", "y_m"), ("up_m", "z_m"))
"""The columns of each element of a position: either name."""
SIZE = ("length_m", "width_m", "height_m")
ANGLES = ("heading_deg", "pitch_deg", "roll_deg")
COUNTER_CLOCKWISE = "heading_ccw_deg"
TEXT = ("name", "material")
MOST_BYTES = 2**24
COLUMNS = (*TEXT, *(name for names in POSITION for name in names), *ANGLES, COUNTER_CLOCKWISE, *SIZE)
"""Every column that is read."""


def posed(one: Object, path: Path) -> list[Object]:
    """The bodies of the table `one` that the file `path` of its `poses` places, in the file's order.

    `east_m` and `north_m` (or `x_m` and `y_m`) must be there. A column that is missing leaves the table's own value:
    `up_m` or `z_m`, `heading_deg` clockwise from north or `heading_ccw_deg`, `pitch_deg`, `roll_deg`, `length_m`,
    `width_m`, `height_m`, `material`, and `name`, which is the table's with the number of the line otherwise. A
    primitive without `size_m` must have all three columns of it. Other columns are not read, and neither is a line that
    begins with `#`.

    Raises InputError, one message for each line that cannot be meant.
    """
    columns, rows = _rows(path)
    known = [name for name in columns if name in COLUMNS]
    for names in POSITION:
        if len([name for name in names if name in known]) > 1:
            raise InputError(f"{path}: found the columns {' and '.join(names)}; must be one of them")
    for names in POSITION[:2]:
        if not set(names) & set(known):
            raise InputError(f"{path}: found the columns {', '.join(columns)}; {' or '.join(names)} is missing")
    if {"heading_deg", COUNTER_CLOCKWISE} <= set(known):
        raise InputError(f"{path}: found heading_deg and {COUNTER_CLOCKWISE}; must be one of them")
    if (sized := [name for name in SIZE if name in known]) and one.primitive is None:
        raise InputError(f"{path}: found the column {sized[0]} beside a mesh, which has a size; must be left out there")
    if one.primitive is not None and one.size_m is None and len(sized) < len(SIZE):
        lacking = ", ".join(name for name in SIZE if name not in sized)
        raise InputError(
            f"{path}: found no column {lacking} for a {one.primitive} without size_m; "
            f"must have {', '.join(SIZE)}, or the table must state size_m"
        )
    stated = one.model_dump(mode="python", exclude_unset=True, exclude={"poses"}, warnings=False)
    stated.setdefault("survey", path.stem)
    found, problems = [], []
    for k, (line, row) in enumerate(rows):
        try:
            table = {**stated, "name": f"{one.label}{k:03d}", **_stated(row, one)}
            found.append(Object.model_validate(table))
        except ValueError as error:
            problems.append(f"{path}: line {line}: {first_problem(error, Object)}")
    if not rows:
        problems.append(f"{path}: found no line with a pose; must have one for each body")
    if problems:
        raise InputError("\n".join(problems))
    return found


def _rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """The names of the columns, and every row with the number of its line."""
    text = input_file.read_text(path, "a file of poses", MOST_BYTES)
    try:
        lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"]
        cells = [(k, [cell.strip() for cell in row]) for k, line in lines for row in csv.reader([line], strict=True)]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as a file of poses ({error})") from None
    if not cells:
        raise InputError(f"{path}: cannot be read as a file of poses (no line names the columns)")
    columns = cells[0][1]
    if twice := next((name for k, name in enumerate(columns) if name in columns[:k]), None):
        raise InputError(f"{path}: found the column {twice} twice; must be there once")
    for k, row in cells[1:]:
        if len(row) != len(columns):
            raise InputError(f"{path}: line {k}: found {len(row)} values; must be {len(columns)}, as the columns are")
    return columns, [(k, dict(zip(columns, row, strict=True))) for k, row in cells[1:]]


def _stated(row: Mapping[str, str], one: Object) -> dict[str, Any]:
    """What a line says of an object, as keys of its table."""
    found: dict[str, Any] = {key: row[key] for key in TEXT if row.get(key)}
    numbers = {key: _number(key, row[key]) for key in COLUMNS if key in row and key not in TEXT}
    position = [next((numbers[n] for n in names if n in numbers), 0.0) for names in POSITION]
    found["position_m"] = tuple(position)
    found |= {key: numbers[key] for key in ANGLES if key in numbers}
    if COUNTER_CLOCKWISE in numbers:
        found["heading_deg"] = -numbers[COUNTER_CLOCKWISE]
    if one.primitive is not None:
        of_table = one.size_m or (None,) * len(SIZE)
        found["size_m"] = tuple(numbers.get(key, size) for key, size in zip(SIZE, of_table, strict=True))
    return found


def _number(key: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{key}: found {text[:40]!r}; must be a number")
    return number
