"""8-bit pictures of amplitude, as JPEG: one grey level per pixel, and a top level at which everything brighter ends."""

from __future__ import annotations

import struct
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.data import ImageChip
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.pictures import ASKS, SLANT_PLANE, in_slant_plane
from warpsar.io.images import LARGEST_IMAGE

if TYPE_CHECKING:
    from PIL.JpegImagePlugin import JpegImageFile

TOP = 255.0
"""The largest level: a pixel that has it measured at least as much."""
GREY = 1.0  # levels of colour that turning planes into whole numbers of red, green and blue, and back, may leave
_MOST_PER_BYTE = 2048  # pixels: a block of 64 takes half a bit at the least
_ERRORS = (OSError, SyntaxError, ValueError, EOFError, LookupError, struct.error)


def read(path: Path, stated: Stated) -> ImageChip:
    """The picture, clipped at the top level, with what rounding may leave."""
    samples, error = levels(path)
    return in_slant_plane(path, samples, stated, top=TOP, error=error)


def levels(path: Path) -> tuple[np.ndarray, float]:
    """Grey levels, shape (rows, cols), float32, and the error that rounding may leave in one of them, rms.

    A block's 64 cosine coefficients are rounded to multiples of q, the file's quantisation table (ISO/IEC 10918-1,
    A.3.4). An error spread evenly over a step has the variance q^2 / 12, and the transform is orthonormal: a level's
    variance is the mean over the table. That is the most: a coefficient far under half a step errs by itself alone.
    Raises InputError for a broken file and for a picture in colour.
    """
    from PIL.JpegImagePlugin import JpegImageFile

    try:
        picture = JpegImageFile(BytesIO(path.read_bytes()))
        most = min(LARGEST_IMAGE, _MOST_PER_BYTE * path.stat().st_size)
        if not 0 < picture.width * picture.height <= most:
            raise InputError(
                f"{path}: found {picture.height} x {picture.width} pixels; must be 1 to {most}, by its size"
            )
        steps = np.array(picture.quantization[0], float)
        return _grey(path, picture), float(np.sqrt((steps**2).mean() / 12.0))
    except _ERRORS as error:
        raise InputError(f"{path}: cannot be read as a JPEG ({error})") from error


def _grey(path: Path, picture: JpegImageFile) -> np.ndarray:
    """Its levels, of shape (rows, cols). A grey picture may have two planes of colour, which then are even."""
    if picture.mode == "RGB":
        planes = np.asarray(picture.convert("YCbCr"), np.float32)
        if np.abs(planes[..., 1:] - 128.0).max() <= GREY:
            return planes[..., 0]
    if picture.mode != "L":
        raise InputError(f"{path}: found a picture in colour ({picture.mode}); must be grey, one level per pixel")
    return np.asarray(picture, np.float32)


FORMAT = Format(
    "jpeg",
    "JPEG",
    "`ff d8 ff`",
    f"{SLANT_PLANE}; 8 bits of amplitude, one level per pixel",
    read,
    detect=lambda path, head: head.startswith(b"\xff\xd8\xff"),
    asks=ASKS,
)
