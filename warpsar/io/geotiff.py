"""GeoTIFF through rasterio (extra `geo`): the one place that opens one."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpsar.errors import InputError
from warpsar.io import tiff

if TYPE_CHECKING:
    from rasterio import DatasetReader


@contextmanager
def projecting(path: Path) -> Iterator[None]:
    """A `with` block around rasterio and its results: what it raises becomes one message, and warnings are silent."""
    os.environ.setdefault("PROJ_DEBUG", "0")  # else PROJ writes to stderr what it finds wrong in a coordinate system
    try:
        import rasterio
        from affine import AffineError
        from rasterio._err import CPLE_BaseError  # GDAL's own errors, which rasterio.warp lets through
        from rasterio.errors import NotGeoreferencedWarning, RasterioError
    except ImportError as error:
        raise InputError(f'{path}: GeoTIFF needs rasterio: pip install "warpsar[geo]"') from error
    try:
        # Env: outside of it PROJ does not find its tables.
        with rasterio.Env(), warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            yield
    except (
        *(AffineError, CPLE_BaseError, RasterioError),
        *(ArithmeticError, AttributeError, LookupError, OSError, TypeError, ValueError),
    ) as error:
        raise InputError(f"{path}: cannot be read as TIFF ({' '.join(str(error).split())[:500]})") from error


@contextmanager
def opened(path: Path) -> Iterator[DatasetReader]:
    """A rasterio data set. Only GDAL's GTiff driver opens it: others read files that name files, or the network."""
    with projecting(path):
        import rasterio

        tiff.check(path)
        with rasterio.open(path, driver="GTiff") as source:
            yield source
