"""Arrays of a kernel's structs, filled on the host."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp


def records(kind: Any, shape: int | tuple[int, ...]) -> Any:
    """Zeros of a Warp struct, as a NumPy array with its fields."""
    return np.zeros(shape, kind.numpy_dtype())


def upload(values: Any, dtype: Any, device: wp.Device) -> Any:
    """A copy on the device."""
    return wp.array(values, dtype=dtype, device=device)
