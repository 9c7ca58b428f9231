"""Rasters that need not fit into memory: arrays in files without a name, and work on them by bands of rows.

Results do not depend on how many bands there are.
"""

from __future__ import annotations

import math
import mmap
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PIXELS = 2**21
"""Of a band, about."""
_DIGIT = 16
"""Bits of a number that one pass over a raster settles."""


def in_file(shape: Sequence[int], kind: type, folder: Path | None = None) -> np.ndarray:
    """An array in a file without a name in `folder`, by default in the one for temporary files. It holds zeros.

    The file goes with the array. Raises OSError where there is no room.
    """
    count = max(math.prod(shape), 1) * np.dtype(kind).itemsize
    with tempfile.TemporaryFile(dir=folder) as file:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(
                file.fileno(), 0, count
            )  # a full disk is an error here, and later the end of the process
        else:
            file.truncate(count)
        return np.ndarray(tuple(shape), kind, buffer=mmap.mmap(file.fileno(), count))


def release(values: np.ndarray) -> None:
    """Let go of the memory that pages of an array of `in_file`, or of a part of one, take: its numbers stay in the
    file. Any other array is left as it is."""
    base: Any = values
    while isinstance(base, np.ndarray):
        base = base.base
    if isinstance(base, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)


def bands_of(shape: Sequence[int], multiple: int = 1) -> Iterator[slice]:
    """Rows of a raster of that shape, in bands of about `PIXELS`; each but the last is a multiple of so many rows."""
    rows = max(PIXELS // (max(shape[1], 1) * multiple), 1) * multiple
    for top in range(0, shape[0], rows):
        yield slice(top, min(top + rows, shape[0]))


def order_statistics(
    values: np.ndarray, places: Callable[[int], NDArray[np.int64]], *, above_zero: bool = False
) -> NDArray[np.float64]:
    """The numbers at `places`, from 0 up, among the finite ones of a raster in their order; `places` gets how many they
    are. With `above_zero` those above 0 alone. Empty where there are none.

    Floating-point numbers as whole ones have the same order, once negative ones are turned. The first pass counts their
    upper bits; each further one, those below of numbers whose upper ones are a wanted number's.
    """
    bits = 8 * values.dtype.itemsize

    def keys() -> Iterator[np.ndarray]:
        for rows in bands_of(values.shape):
            part = np.ascontiguousarray(values[rows]).ravel()
            yield _keys(part[np.isfinite(part) & ((part > 0.0) | (not above_zero))])
            release(values)

    counts = sum((_counted(part >> (bits - _DIGIT)) for part in keys()), np.zeros(2**_DIGIT, np.int64))
    total = int(counts.sum())
    if not total:
        return np.zeros(0)
    left = np.asarray(places(total), np.int64).copy()
    found = np.zeros(left.size, np.uint64)
    histograms = {0: counts}
    for shift in range(bits - _DIGIT, -1, -_DIGIT):
        for i, upper in enumerate(found.tolist()):
            until = np.cumsum(histograms[upper])
            digit = int(np.searchsorted(until, left[i], side="right"))
            left[i] -= until[digit - 1] if digit else 0
            found[i] = upper << _DIGIT | digit
        if shift:
            histograms = {upper: np.zeros(2**_DIGIT, np.int64) for upper in found.tolist()}
            for part in keys():
                for upper, into in histograms.items():
                    lower = part[part >> shift == upper] >> (shift - _DIGIT)
                    into += _counted(lower & (2**_DIGIT - 1))
    return _numbers(found.astype(f"u{values.dtype.itemsize}"), values.dtype).astype(np.float64)


def median(values: np.ndarray) -> float:
    """Of the finite numbers of a raster; NaN where there are none."""
    found = order_statistics(values, lambda count: np.array([(count - 1) // 2, count // 2]))
    return float(found.mean()) if found.size else np.nan


def _counted(digits: np.ndarray) -> NDArray[np.int64]:
    return np.bincount(digits.astype(np.intp), minlength=2**_DIGIT)


def _keys(values: np.ndarray) -> np.ndarray:
    """Whole numbers without a sign, in the order of floating-point ones."""
    size = values.dtype.itemsize
    whole = values.view(f"u{size}")
    top = whole.dtype.type(1 << (8 * size - 1))
    return np.where(whole & top, ~whole, whole | top)


def _numbers(keys: np.ndarray, kind: np.dtype) -> np.ndarray:
    top = keys.dtype.type(1 << (8 * keys.dtype.itemsize - 1))
    return np.where(keys & top, keys ^ top, ~keys).view(kind)
