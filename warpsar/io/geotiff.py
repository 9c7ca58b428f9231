"""GeoTIFF through rasterio (extra `geo`): the one place that opens one."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io import tiff
from warpsar.io.bands import release
from warpsar.io.images import replacing
from warpsar.runtime.threads import thread_count

TILE = 512
COG = {
    "BLOCKSIZE": str(TILE),
    "COMPRESS": "DEFLATE",
    "LEVEL": "1",  # a file of layers grows by 4 % from that of level 6, in half the time
    "PREDICTOR": "YES",
    "BIGTIFF": "IF_SAFER",
}
"""Of GDAL's driver."""
IN_MEMORY = 2**29
"""Bytes of a raster that is put together in memory."""
CACHE_BYTES = 2**27
"""Of GDAL for tiles that it reads and writes: by default it takes a twentieth of the machine's memory."""


@dataclass(frozen=True)
class RasterPlace:
    """Where a raster, north up, lies on a map: `crs` is rasterio's; the rest is in its units."""

    crs: Any
    left: float
    top: float
    pixel: float

    @property
    def affine(self) -> Any:
        """From columns and rows of pixels' corners to the map."""
        from rasterio.transform import from_origin

        return from_origin(self.left, self.top, self.pixel, self.pixel)


@dataclass(frozen=True)
class AffinePlace:
    """The same of a raster with any pixels: `affine` takes columns and rows of pixels' corners to the map."""

    crs: Any
    affine: Any

    @property
    def askew(self) -> bool:
        """Whether rows and columns do not run along the axes of the coordinate system."""
        return bool(self.affine.b != 0.0 or self.affine.d != 0.0)


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
        with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES), warnings.catch_warnings(), np.errstate(all="ignore"):
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


def write_cog(
    path: Path,
    bands: Mapping[str, NDArray[Any]],
    tags: Mapping[str, Any],
    place: RasterPlace | AffinePlace | None = None,
    *,
    kind: Literal["float32", "float64"] = "float32",
) -> None:
    """A cloud-optimized GeoTIFF of bands of one shape, named by their descriptions; whole or not at all.

    Tiles and directories in the order of the format's standard are GDAL's COG driver's. `tags` are texts, numbers, or
    lists of them, which become JSON. NaN is no data. Without `place` the image lies nowhere.

    Overviews are means, made before the copy: the driver itself would pack, unpack and pack again what it makes. Bands
    of more than `IN_MEMORY` are first written to a file beside `path`, so memory does not grow with them.
    """
    first = next(iter(bands.values()))
    profile: dict[str, Any] = {
        "count": len(bands),
        "height": first.shape[0],
        "width": first.shape[1],
        "dtype": kind,
        "nodata": float("nan"),
    }
    if place is not None:
        profile |= {"crs": place.crs, "transform": place.affine}
    large = len(bands) * first.size * np.dtype(kind).itemsize > IN_MEMORY
    with replacing(path) as temporary, _scratch(path) as scratch:
        import rasterio
        import rasterio.shutil
        from rasterio.enums import Resampling
        from rasterio.errors import RasterioError

        if large:
            room = {
                "driver": "GTiff",
                "tiled": True,
                "blockxsize": TILE,
                "blockysize": TILE,
                "interleave": "band",
                "bigtiff": "YES",
                **profile,
            }
        else:
            room = {"driver": "MEM", **profile}
        threads = str(thread_count())
        try:
            with (
                rasterio.Env(GDAL_NUM_THREADS=threads, GDAL_CACHEMAX=CACHE_BYTES),  # threads: of overviews
                _created(scratch if large else "", room) as source,
            ):
                source.update_tags(**{k: json.dumps(v) if isinstance(v, list) else str(v) for k, v in tags.items()})
                source.descriptions = tuple(bands)
                for number, band in enumerate(bands.values(), start=1):
                    for top in range(0, first.shape[0], TILE):
                        rows = slice(top, min(top + TILE, first.shape[0]))
                        window = ((rows.start, rows.stop), (0, first.shape[1]))
                        source.write(np.asarray(band[rows], kind), number, window=window)
                        release(band)
                source.build_overviews(_halvings(first.shape), Resampling.average)
                rasterio.shutil.copy(source, temporary, driver="COG", **COG, NUM_THREADS=threads)
        except RasterioError as error:
            raise OSError(f"{path}: cannot be written ({error})") from error


_creating = Lock()
"""Filters of warnings belong to the process, and files are written side by side."""


def _created(path: Path | str, profile: dict[str, Any]) -> Any:
    """A rasterio data set to write. That it lies nowhere is no reason to warn."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with _creating, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        return rasterio.open(path, "w+", **profile)


@contextmanager
def _scratch(path: Path) -> Iterator[Path]:
    """A file name beside `path`; what is written there does not stay."""
    made = path.with_name(f".{uuid4().hex}{path.suffix}")
    try:
        yield made
    finally:
        made.unlink(missing_ok=True)


def _halvings(shape: tuple[int, ...]) -> list[int]:
    """Factors of overviews, until one fits into a tile."""
    factors = [2**k for k in range(1, 32)]
    return [each for each in factors if 2 * max(shape) > TILE * each]
