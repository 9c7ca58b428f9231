"""How much memory and disk a twin takes, before the work: neither memory nor its forecast grows with the window.

Work is on blocks, some at a time, and layers above `IN_MEMORY` lie in files. What is written, compared and drawn goes
by bands of rows.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import warp as wp

from warpsar.errors import InputError
from warpsar.runtime.memory import default_gib
from warpsar.runtime.threads import thread_count
from warpsar.terrain.blocks import ImageBlock

IN_MEMORY = 2**30
"""Bytes of layers that memory holds."""
PROGRAM = 0.5 * 2**30
"""Bytes of the program and its libraries."""
BANDS = 0.25 * 2**30
"""Bytes of bands, of tiles that are packed, and of pictures."""
LEAST_PIXELS = 4
"""Along the side of a cell in which measured pixels are averaged and compared."""
MOST_CELLS = 2**20
"""Cells of a larger window are larger."""
CELL_BYTES, CELL_BYTES_OF_SURFACE = 320, 48
"""Of a cell in which measured pixels are compared: what is asked of it, and what each surface adds."""
PIXEL_BYTES, POST_BYTES = 400, 250
"""Of a block while it is worked on; a little more than measured on blocks of 3 pixels and of 0.7 for a post."""


@dataclass(frozen=True)
class TwinForecast:
    """`bytes`: of memory, at most about; `disk_bytes`: of files that are there while the twin is made."""

    blocks: int
    at_once: int
    bytes: float
    in_files: bool
    disk_bytes: float

    def __str__(self) -> str:
        words = (
            f"{self.blocks} block{'s' if self.blocks > 1 else ''}, {self.at_once} at a time: at most about "
            f"{self.bytes / 2**30:.1f} GiB of memory"
        )
        return words + f", and {self.disk_bytes / 2**30:.1f} GiB of disk for layers" if self.in_files else words

    def content(self) -> dict[str, Any]:
        return {
            "memory_gib": round(self.bytes / 2**30, 2),
            "disk_gib": round(self.disk_bytes / 2**30, 2),
            "blocks_at_once": self.at_once,
        }


def forecast(
    blocks: Sequence[ImageBlock], image_bytes: float, map_bytes: float, compared: int, surfaces: int
) -> TwinForecast:
    """Of layers on the product's grid and on the map [bytes]. `compared`: measured pixels; 0 where there are none."""
    block = max(
        PIXEL_BYTES * one.window.shape[0] * one.window.shape[1]
        + POST_BYTES * (one.rows[1] - one.rows[0]) * (one.columns[1] - one.columns[0])
        for one in blocks
    )
    layers = image_bytes + map_bytes
    in_files = layers > IN_MEMORY
    cells = min(compared // LEAST_PIXELS**2, MOST_CELLS)
    # layers that memory holds are copied into files that memory holds, too
    fixed = PROGRAM + BANDS + cells * (CELL_BYTES + surfaces * CELL_BYTES_OF_SURFACE) + (0 if in_files else 2 * layers)
    there = default_gib(wp.get_device("cpu")) * 2**30
    at_once = int(min(max((there - fixed) / block, 1), thread_count(), len(blocks)))
    # a GeoTIFF is put together in a file beside the layers
    disk = layers + max(image_bytes, map_bytes) if in_files else 0.0
    return TwinForecast(len(blocks), at_once, fixed + at_once * block, in_files, disk)


def refuse_small_disk(found: TwinForecast, scratch: Path | None) -> None:
    """Raise InputError where the layers' files, in `scratch` or the folder for temporary files, find no room."""
    folder = Path(tempfile.gettempdir()) if scratch is None else scratch
    free = shutil.disk_usage(folder).free
    if free < found.disk_bytes:
        raise InputError(
            f"{folder}: found {free / 2**30:.1f} GiB free; must be {found.disk_bytes / 2**30:.1f} for layers while the "
            "twin is made; take a part by --crop, or another disk"
        )
