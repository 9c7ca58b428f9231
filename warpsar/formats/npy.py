"""NumPy files of pictures in the slant plane, of real or complex numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import read_levels, read_npy


def read(path: Path, stated: Stated) -> ImageChip:
    """Complex numbers as complex64; of real ones the only channel; levels of 8 or 16 bits are clipped at their top."""
    array = read_npy(path)
    if array.dtype.kind != "c":
        samples, top = read_levels(path, stated.polarization)
        return in_slant_plane(path, samples, stated, top=top)
    with np.errstate(all="ignore"):
        return in_slant_plane(path, np.array(array, np.complex64), stated)


FORMAT = Format("npy", "NPY", "`.npy`", SLANT_PLANE, read, suffixes=(".npy",), asks=ASKS)
