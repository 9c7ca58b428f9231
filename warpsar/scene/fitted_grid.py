"""The pixels that hold a whole mesh, from all the sides that it is seen from."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from warpsar.world.frame import ViewGeometry
from warpsar.world.tables import Grid

PIXELS = 512
"""Pixels along an axis, at most."""
_MARGIN = 1.05  # a rim of 2.5 % on either side
_BLOCK = 16  # numbers of pixels are multiples of it
_ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
_SMALLEST_M, _LARGEST_M = 1e-5, 1e5  # what [image].spacing_m allows


def fitted_grid(
    vertices: NDArray[np.float64],
    reference_m: NDArray[np.float64],
    looks: Iterable[ViewGeometry],
    finest_m: float = 0.0,
) -> Grid:
    """Square pixels of `finest_m` or more, at most 512 along an axis, about `reference_m` (3,) [m].

    They hold the `vertices` (n, 3) [m] as every plane wave of `looks` sees them, layover included. They also hold the
    shadows on level ground at the mesh's foot: a point at the height z above it shades up to z / cos(incidence)
    behind itself in range.
    """
    at = vertices - reference_m
    height = at[:, 2] - at[:, 2].min()
    reach = np.zeros(2)
    for look in looks:
        slant, azimuth = at @ look.d, at @ look.u
        shadow = slant + height / look.s[2]
        reach = np.maximum(reach, [max(-slant.min(), shadow.max()), np.abs(azimuth).max()])
    size = 2.0 * _MARGIN * reach
    spacing = min(max(_rounded_up(float(size.max()) / PIXELS), _SMALLEST_M, finest_m), _LARGEST_M)
    rows, columns = (_BLOCK * max(1, math.ceil(each / spacing / _BLOCK)) for each in size)
    return Grid(shape=(rows, columns), spacing_m=(spacing, spacing))


def _rounded_up(value: float) -> float:
    power = math.floor(math.log10(value))
    return next(each for step in _ROUND if (each := float(f"{step}e{power}")) >= value)
