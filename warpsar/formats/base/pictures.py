"""Pictures: images of real numbers, of which only their maker knows what they are, or complex ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.formats.base.data import Facts, ImageChip, Quantity
from warpsar.formats.base.format import Stated

SLANT_PLANE = "picture already in the slant plane: range down, near range first, the reference point in the middle"
ASKS = ("quantity", "radar_at", "spacing_m")
"""What a picture in the slant plane does not say."""


def in_slant_plane(
    path: Path, samples: np.ndarray, stated: Stated, *, top: float | None = None, error: float | None = None
) -> ImageChip:
    """A picture of shape (rows, cols), with range along its rows and the reference point in its middle.

    Near range is first, or last where the radar is at the bottom. Its spacing, if not stated, is that of the view,
    divided by the looks. `top` and `error` as in `ImageChip`.
    """
    facts = Facts(polarization=stated.polarization)
    return ImageChip(
        str(path),
        samples[::-1] if stated.radar_at == "bottom" else samples,
        quantity_of(path, samples.dtype, stated.quantity),
        lambda reference_point_m: facts,
        spacing_m=stated.spacing_m,
        top=top,
        error=error,
    )


def quantity_of(path: Path, dtype: np.dtype, stated: Quantity | None) -> Quantity:
    """What the numbers of a picture are. Raises InputError for real ones of which nothing is stated."""
    if dtype.kind == "c":
        if stated is not None:
            raise InputError(f"{path}: holds complex numbers; --quantity {stated} is for detected images")
        return "complex"
    if stated not in ("amplitude", "power"):
        raise InputError(f"{path}: the format does not say whether these are amplitudes or powers; use --quantity")
    return stated
