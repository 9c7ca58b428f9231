"""`warpsar import` for curves: CSV beside the scene file, and a `[[curves]]` table for each curve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import tomlkit

from warpsar.errors import InputError
from warpsar.io import curves
from warpsar.io.images import replacing
from warpsar.scene import file as scenefile


def import_curves(
    sources: Sequence[str | Path],
    scene_path: str | Path,
    *,
    polarization: str | None = None,
    role: Literal["train", "test"] = "train",
) -> list[Path]:
    """Write each file of curves as `<stem>.csv` beside the scene file, and declare every curve that it holds.

    `polarization` is for files that name none. A curve that is declared already gets the new file's role. Returns the
    files written. Raises InputError for files that are no curves.
    """
    scene_path = Path(scene_path)
    text, _ = scenefile.read(scene_path)
    document: Any = tomlkit.parse(text)
    tables = [(Path(source), curves.read(Path(source))) for source in sources]
    written = []
    for source, table in tables:
        known = sorted({*table.polarization} - {""})
        if not known and polarization is None:
            raise InputError(f"{source}: says no polarization; use --polarization")
        named = curves.RcsTable(
            table.path, table.frequency_hz, table.azimuth_deg, table.incidence_deg, table.rcs_m2,
            tuple(each or str(polarization) for each in table.polarization),
        )  # fmt: skip
        path = scene_path.parent / f"{source.stem}.csv"
        if path.resolve() == source.resolve():
            raise InputError(f"{source}: lies beside the scene file; it would be replaced. Declare it in [[curves]]")
        curves.write_csv(path, named)
        written.append(path)
        for frequency in named.frequencies_hz():
            for pol in sorted({*named.polarization}):
                _declare(document, path.name, frequency, pol, role)
    with replacing(scene_path) as temporary:
        temporary.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
    return written


def _declare(document: Any, file: str, frequency_hz: float, polarization: str, role: str) -> None:
    """Put a curve into the scene file's `[[curves]]`, once."""
    stated = {"file": file, "frequency_hz": float(frequency_hz), "polarization": polarization}
    for table in document.get("curves", []):
        if all(table.get(key) == value for key, value in stated.items()):
            table["role"] = role
            return
    if "curves" not in document:
        document.append("curves", tomlkit.aot())
    made = tomlkit.item({**stated, "role": role})
    made.trivia.indent = "\n"
    document["curves"].append(made)
