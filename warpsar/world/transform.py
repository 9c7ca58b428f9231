"""From a value to the coordinate that a fit moves, and back: free of units, and 1 is a large step.

`xp` is the library whose arrays are given: NumPy, PyTorch or `jax.numpy`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from warpsar.kernels.codes import FRACTION_LIMIT


@dataclass(frozen=True)
class Transform:
    """How a coordinate x stands for a value v.

    "linear": x = v / span. "log": x = ln(v / span). "contrast": x = ln(v - 1), of a permittivity. "logit": x = ln(v) -
    ln(1 - v) of a share, where the coordinates +-`FRACTION_LIMIT` stand for 1 and 0.
    """

    kind: Literal["linear", "log", "contrast", "logit"] = "linear"
    span: float = 1.0

    def to_coordinate(self, value: Any, xp: Any = np) -> Any:
        """x of a value, of its shape."""
        with np.errstate(divide="ignore"):
            if self.kind == "contrast":
                return xp.log(value - 1.0)
            if self.kind == "logit":
                return xp.clip(xp.log(value) - xp.log1p(-value), -FRACTION_LIMIT, FRACTION_LIMIT)
            scaled = value / self.span
            return xp.log(scaled) if self.kind == "log" else scaled

    def from_coordinate(self, x: Any) -> Any:
        """The value at x, of its shape."""
        x = np.asarray(x, float)
        if self.kind == "logit":
            share = 1.0 / (1.0 + np.exp(-x))
            return np.where(x <= -FRACTION_LIMIT, 0.0, np.where(x >= FRACTION_LIMIT, 1.0, share))
        if self.kind == "contrast":
            return 1.0 + np.exp(x)
        return self.span * (np.exp(x) if self.kind == "log" else x)

    def slope(self, x: Any) -> Any:
        """d value / dx at x, of its shape."""
        if self.kind == "contrast":
            return np.exp(x)
        return self.slope_at(self.from_coordinate(x))

    def slope_at(self, value: Any) -> Any:
        """d value / dx where the value is `value`, of its shape."""
        if self.kind == "logit":
            return value * (1.0 - value)
        if self.kind == "contrast":
            return value - 1.0
        return value if self.kind == "log" else np.full(np.shape(value), self.span)
