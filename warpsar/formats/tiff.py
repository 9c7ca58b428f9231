"""TIFF pictures in the slant plane: those without a coordinate system."""

from __future__ import annotations

from pathlib import Path

from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import read_channel


def read(path: Path, stated: Stated) -> ImageChip:
    """The only channel, or the one of the polarization."""
    return in_slant_plane(path, read_channel(path, stated.polarization), stated)


FORMAT = Format("tiff", "TIFF", "`.tif`, `.tiff`", SLANT_PLANE, read, suffixes=(".tif", ".tiff"), asks=ASKS)
