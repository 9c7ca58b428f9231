"""8-bit pictures of amplitude, as JPEG: one grey level per pixel, and a top level at which everything brighter ends."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.io.images import LARGEST_IMAGE

SUFFIXES = (".jpg", ".jpeg")
TOP = 255.0
"""The largest level: a pixel that has it measured at least as much."""
_MOST_PER_BYTE = 2048  # pixels: a block of 64 takes half a bit at the least
_ERRORS = (OSError, SyntaxError, ValueError, EOFError, struct.error)


def read(path: Path) -> np.ndarray:
    """Grey levels, shape (rows, cols), float32. Raises InputError for a broken file and for a picture in colour."""
    from PIL.JpegImagePlugin import JpegImageFile

    try:
        picture = JpegImageFile(BytesIO(path.read_bytes()))
        most = min(LARGEST_IMAGE, _MOST_PER_BYTE * path.stat().st_size)
        if not 0 < picture.width * picture.height <= most:
            raise InputError(
                f"{path}: found {picture.height} x {picture.width} pixels; must be 1 to {most}, by its size"
            )
        if picture.mode != "L":
            raise InputError(f"{path}: found a picture in colour ({picture.mode}); must be grey, one level per pixel")
        return np.asarray(picture, np.float32)
    except _ERRORS as error:
        raise InputError(f"{path}: cannot be read as a JPEG ({error})") from error
