"""NumPy files of pictures in the slant plane, of real or complex numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import read_channel, read_npy


def read(path: Path, stated: Stated) -> ImageChip:
    """Complex numbers as complex64; of real ones the only channel."""
    array = read_npy(path)
    if array.dtype.kind != "c":
        return in_slant_plane(path, read_channel(path, stated.polarization), stated)
    with np.errstate(all="ignore"):
        return in_slant_plane(path, np.array(array, np.complex64), stated)


FORMAT = Format("npy", "NPY", "`.npy`", SLANT_PLANE, read, suffixes=(".npy",), asks=ASKS)
