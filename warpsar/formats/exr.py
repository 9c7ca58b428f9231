"""EXR pictures in the slant plane."""

from __future__ import annotations

from pathlib import Path

from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import read_channel


def read(path: Path, stated: Stated) -> ImageChip:
    """The only channel, or the one of the polarization."""
    return in_slant_plane(path, read_channel(path, stated.polarization), stated)


FORMAT = Format("exr", "EXR", "`.exr`", SLANT_PLANE, read, suffixes=(".exr",), asks=ASKS)
