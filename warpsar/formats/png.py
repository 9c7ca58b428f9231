"""8- and 16-bit pictures, as PNG: one grey level per pixel, and a top level at which everything brighter ends."""

from __future__ import annotations

from pathlib import Path

from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import read_levels


def read(path: Path, stated: Stated) -> ImageChip:
    """The picture, clipped at its top level."""
    samples, top = read_levels(path)
    return in_slant_plane(path, samples, stated, top=top)


FORMAT = Format(
    "png",
    "PNG",
    "`89 50 4e 47`",
    f"{SLANT_PLANE}; 8 or 16 bits, one level per pixel",
    read,
    detect=lambda path, head: head.startswith(b"\x89PNG"),
    asks=ASKS,
)
