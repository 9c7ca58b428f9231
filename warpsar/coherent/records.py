"""Arrays of a kernel's structs, filled on the host."""

from __future__ import annotations

from threading import Lock
from typing import Any

import numpy as np
import warp as wp

_parser = Lock()
"""NumPy parses a struct's layout with Python's own parser, which counts its depth for all threads together (3.11)."""


def records(kind: Any, shape: int | tuple[int, ...]) -> Any:
    """Zeros of a Warp struct, as a NumPy array with its fields."""
    with _parser:
        return np.zeros(shape, kind.numpy_dtype())


def upload(values: Any, dtype: Any, device: wp.Device) -> Any:
    """A copy on the device."""
    with _parser:
        return wp.array(values, dtype=dtype, device=device)


def host(array: wp.array) -> Any:
    """The values on the host; those of structs as a NumPy array with their fields."""
    with _parser:
        return array.numpy()
