"""TIFF pictures in the slant plane: those without a coordinate system."""

from __future__ import annotations

from pathlib import Path

from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import read_levels


def read(path: Path, stated: Stated) -> ImageChip:
    """The only channel, or the one of the polarization; levels of 8 or 16 bits are clipped at their top."""
    samples, top = read_levels(path, stated.polarization)
    return in_slant_plane(path, samples, stated, top=top)


FORMAT = Format("tiff", "TIFF", "`.tif`, `.tiff`", SLANT_PLANE, read, suffixes=(".tif", ".tiff"), asks=ASKS)
