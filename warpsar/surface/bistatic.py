"""Numbers that the kernels of bistatic scattering share."""

from __future__ import annotations

from functools import cache

import numpy as np
import warp as wp
from scipy.special import gammaln

from warpsar.kernels.coherent.bistatic import ORDERS


@cache
def log_factorials(device: str) -> wp.array:
    """ln n! for each order of `kernels.coherent.bistatic.higher_orders`, (ORDERS,), float64."""
    return wp.array(gammaln(np.arange(int(ORDERS)) + 1.0), dtype=wp.float64, device=device)
