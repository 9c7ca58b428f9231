"""How alike two complex images are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter

from warpsar.errors import InputError, shown


def coherence(one: ArrayLike, other: ArrayLike, window: tuple[int, int] = (7, 7)) -> NDArray[np.complex64]:
    """Complex coherence of two images (rows, cols) on one grid: over windows,
    `sum s1 conj(s2) / sqrt(sum abs(s1)^2 sum abs(s2)^2)`.

    Its magnitude is 0 to 1, its angle the interferogram's phase [rad] (Bamler and Hartl, Inverse Problems 14, 1998,
    eq. 35). Of L independent samples the magnitude is sqrt(pi / 4L) in the mean where nothing is alike. NaN where a
    window holds a sample that is not finite. Raises InputError for images of different shapes, and for a window that is
    not odd.
    """
    try:
        first, second = np.asarray(one, np.complex128), np.asarray(other, np.complex128)
    except (TypeError, ValueError):
        raise InputError(f"coherence: found {shown(one)} and {shown(other)}; must be two arrays of numbers") from None
    if first.shape != second.shape or first.ndim != 2:
        raise InputError(f"coherence: found shapes {first.shape} and {second.shape}; must be one shape (rows, cols)")
    if any(size < 1 or size % 2 == 0 for size in window):
        raise InputError(f"coherence: found window {window}; must be two odd numbers")
    bad = ~(np.isfinite(first) & np.isfinite(second))
    first, second = np.where(bad, 0.0, first), np.where(bad, 0.0, second)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return uniform_filter(values, window, mode="constant")

    product = first * second.conj()
    power = mean(np.abs(first) ** 2) * mean(np.abs(second) ** 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        found = (mean(product.real) + 1j * mean(product.imag)) / np.sqrt(power)
    found[mean(bad.astype(float)) > 0.5 / np.prod(window)] = np.nan
    return found.astype(np.complex64)
