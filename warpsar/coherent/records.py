"""Arrays of a kernel's structs, filled on the host."""

from __future__ import annotations

from functools import cache
from threading import Lock
from typing import Any

import numpy as np
import warp as wp

_parser = Lock()
"""NumPy parses a struct's layout with Python's own parser, which counts its depth for all threads together (3.11)."""


def records(kind: Any, shape: int | tuple[int, ...]) -> Any:
    """Zeros of a Warp struct, as a NumPy array with its fields."""
    with _parser:
        dtype = np.dtype(kind.numpy_dtype())
    raw = np.empty(int(np.prod(shape)) * dtype.itemsize, np.uint8)  # large pages, which `np.zeros` does not take
    raw[:] = 0
    return raw.view(dtype).reshape(shape)


def upload(values: Any, dtype: Any, device: wp.Device) -> Any:
    """A copy on the device."""
    with _parser:
        return wp.array(values, dtype=dtype, device=device)


def field(array: wp.array, name: str, dtype: Any) -> wp.array:
    """One field of an array of structs, (n,), where it lies: no copy."""
    at = (array.ptr or 0) + _offset(array.dtype, name)
    found: Any = wp.array(ptr=at, dtype=dtype, shape=array.shape, strides=array.strides, device=array.device)
    found._whole = array  # which must live as long
    return found


@cache
def _offset(kind: Any, name: str) -> int:
    """Of a field from the begin of its struct [bytes]."""
    with _parser:
        fields = np.dtype(kind.numpy_dtype()).fields
    assert fields is not None
    return int(fields[name][1])


def host(array: wp.array) -> Any:
    """The values on the host; those of structs as a NumPy array with their fields."""
    with _parser:
        return array.numpy()
