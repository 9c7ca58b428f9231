"""The index of a batch: one row for each image that is there.

Each process adds rows to a part of its own, right after the image's file. The parts are merged when a run begins and
when it ends, so that a run that was killed at any moment goes on where it stopped.
"""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from warpsar.io.images import replacing
from warpsar.runtime import once

INDEX, PARTS = "index.csv", "index.parts"
FIELDS = ("name", "scene", "azimuth_deg", "incidence_deg", "frequency_hz", "file", "sha256", "inputs")
_TEMPORARY = re.compile(r"\.[0-9a-f]{32}\.\w+")  # what `images.replacing` leaves when it is killed

Row = dict[str, str]


class Index:
    """The rows of `index.csv` in a batch's folder, by image name, and this process's own part."""

    def __init__(self, out: Path) -> None:
        self.out = out
        once.find(self._tidy)
        self.rows = {row["name"]: row for row in self._read(out / INDEX)}
        self._stream: TextIO | None = None
        self._part = out / PARTS / f"{once.number()}.csv"

    def add(self, row: Row) -> None:
        """Add a row; it is on disk when this returns."""
        if self._stream is None:
            self._part.parent.mkdir(exist_ok=True)
            self._stream = self._part.open("a", newline="", encoding="utf-8")
        try:
            csv.DictWriter(self._stream, FIELDS).writerow(row)
            self._stream.flush()
        except OSError as error:
            error.filename = str(self._part)
            raise

    def close(self) -> None:
        """Merge the rows that all processes added; each of them calls this."""
        if self._stream is not None:
            self._stream.close()
        once.wait()
        once.write(self._merge)

    def _tidy(self) -> None:
        """Take in the rows of a killed run, and remove the files that it had not finished."""
        for folder, _, files in os.walk(self.out):
            for name in files:
                if _TEMPORARY.fullmatch(name):
                    (Path(folder) / name).unlink()
        self._merge()

    def _merge(self) -> None:
        parts = sorted((self.out / PARTS).glob("*.csv"))
        if not parts and (self.out / INDEX).exists():
            return
        rows = {row["name"]: row for path in [self.out / INDEX, *parts] for row in self._read(path)}
        with replacing(self.out / INDEX) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, FIELDS)
            writer.writeheader()
            writer.writerows(sorted(rows.values(), key=lambda row: row["file"]))
        for path in parts:
            path.unlink()
        if (self.out / PARTS).is_dir():
            (self.out / PARTS).rmdir()

    @staticmethod
    def _read(path: Path) -> Iterator[Row]:
        """The complete rows; a killed process may leave half a line at the end."""
        if not path.exists():
            return
        with path.open(newline="", encoding="utf-8") as stream:
            lines = (line for line in stream if line.endswith("\n"))
            for fields in csv.reader(lines):
                if len(fields) == len(FIELDS) and tuple(fields) != FIELDS:
                    yield dict(zip(FIELDS, fields, strict=True))
