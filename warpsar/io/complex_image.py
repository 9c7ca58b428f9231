"""Complex images in files: `range_m`, `azimuth_m` [m], and an array complex64 for each polarization, in one NPZ."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io.images import replacing


def write(
    path: Path,
    range_m: NDArray[np.float64],
    azimuth_m: NDArray[np.float64],
    images: Mapping[str, NDArray[np.complex64]],
) -> None:
    """The file, whole or not at all."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez(file, range_m=range_m, azimuth_m=azimuth_m, **images)  # type: ignore[arg-type]


def read(path: Path, polarization: str) -> tuple[NDArray[np.complex64], NDArray[np.float64], NDArray[np.float64]]:
    """The image (rows, columns), NaN where nothing was measured, and places of rows and columns [m].

    Raises InputError for a file that is no such image, or does not hold the polarization.
    """
    try:
        with np.load(path, allow_pickle=False) as held:
            if polarization not in held:
                raise InputError(f"{path}: found {', '.join(held)}; must hold {polarization}")
            image, range_m, azimuth_m = held[polarization], held["range_m"], held["azimuth_m"]
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise InputError(f"{path}: not a readable complex image ({error})") from None
    if image.dtype != np.complex64 or image.shape != (len(range_m), len(azimuth_m)):
        raise InputError(
            f"{path}: {polarization}: found {image.dtype} of shape {image.shape}; must be complex64 of shape "
            f"({len(range_m)}, {len(azimuth_m)})"
        )
    return image, range_m, azimuth_m
