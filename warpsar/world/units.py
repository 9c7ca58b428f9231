"""The unit of a mesh file that states none: a guess, and its words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.world.mesh import GLTF
from warpsar.world.meshes.dem import SUFFIXES as DEM_SUFFIXES
from warpsar.world.objects.table import UNITS

MILLIMETRES_FROM = 1000.0
"""Larger meshes whose format states no unit are taken as millimetres."""
_IN_METRES = (*GLTF, *DEM_SUFFIXES)  # by their standard, or turned into metres by their reader


def guessed_unit(path: Path, vertices: NDArray[np.float64]) -> tuple[str, str | None]:
    """The likely unit of a file's coordinates, shape (n, 3), a key of `UNITS`; and how to change it, in words. None
    where the format states its unit."""
    if path.suffix.lower() in _IN_METRES:
        return "m", None
    size = np.ptp(vertices, axis=0)
    unit = "mm" if size.max() > MILLIMETRES_FROM else "m"
    across = " x ".join(f"{each:.4g}" for each in size)
    others = ", ".join(each for each in UNITS if each != unit)
    return unit, f"{path}: {across} units across; taken as {unit}, a guess. If it is wrong: --units with {others}"
