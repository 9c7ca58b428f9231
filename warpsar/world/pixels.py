"""An image that lies in memory, where a scene file would name one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError


class Pixels:
    """A copy of an array of shape (rows, cols) that never changes: float32, or bool for a mask.

    Two are equal where their values are. NumPy takes one as the array itself. Raises InputError for an array that
    is not of two dimensions, is empty, or holds no real numbers.
    """

    def __init__(self, array: Any) -> None:
        found = np.asarray(array)
        if found.ndim != 2 or not found.size:
            raise InputError(f"an image in memory: found shape {found.shape}; must be (rows, cols), none of them 0")
        if found.dtype.kind not in "fiub":
            raise InputError(f"an image in memory: found values of type {found.dtype}; must be real numbers")
        with np.errstate(over="ignore"):  # beyond float32 is infinite, and is treated as such
            self.values: NDArray[Any] = np.array(found, bool if found.dtype.kind == "b" else np.float32, order="C")
        self.values.flags.writeable = False

    @property
    def shape(self) -> tuple[int, int]:
        rows, cols = self.values.shape
        return rows, cols

    @cached_property
    def sha256(self) -> str:
        """Of the shape, the type and the values."""
        total = hashlib.sha256(repr((self.shape, str(self.values.dtype))).encode())
        total.update(self.values.data)
        return total.hexdigest()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.values, dtype) if copy or dtype not in (None, self.values.dtype) else self.values

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Pixels) and self.sha256 == other.sha256

    def __hash__(self) -> int:
        return hash(self.sha256)

    def __repr__(self) -> str:
        return f"<{self.shape[0]} x {self.shape[1]} pixels, SHA-256 {self.sha256[:12]}>"


def in_memory(value: Any) -> bool:
    """Whether a value is an array (NumPy's, PyTorch's, xarray's) rather than the name of a file."""
    return isinstance(value, Pixels) or (hasattr(value, "__array__") and np.ndim(value) > 0)


def measured(value: Any, name: Callable[[Any], Any]) -> Any:
    """A file's name, or an image of linear power. Isolated NaN or infinite pixels are allowed, and masked later."""
    if not in_memory(value):
        return name(value)
    pixels = value if isinstance(value, Pixels) else Pixels(value)
    finite = np.isfinite(pixels.values)
    if not finite.any():
        raise InputError("a measured image in memory: every pixel is NaN or infinite; must be linear power")
    if (negative := finite & (pixels.values < 0)).any():
        raise InputError(
            f"a measured image in memory: {int(negative.sum())} pixels are negative (down to "
            f"{float(pixels.values[negative].min()):g}); must be linear power, 0 or more"
        )
    return pixels


def mask(value: Any, name: Callable[[Any], Any]) -> Any:
    if not in_memory(value):
        return name(value)
    pixels = value if isinstance(value, Pixels) else Pixels(value)
    used = Pixels(np.nan_to_num(pixels.values) != 0)
    if not used.values.any():
        raise InputError("a mask in memory: every pixel is 0; must be nonzero where pixels are used")
    return used
