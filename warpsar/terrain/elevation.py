"""An elevation model in GeoTIFF: read in windows, its posts placed on the earth.

From the heights of a file to heights above the WGS 84 ellipsoid: never by a guess.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.world.earth import geodetic_to_ecef, same_turn
from warpsar.world.meshes.dem import LARGEST_PER_BYTE, check_heights

F64 = NDArray[np.float64]
HEIGHTS_M = (-500.0, 9000.0)
"""Of the land, with a margin: others are no metres, or a value of no data that the file does not name."""
METRES = ("m", "metre", "meter", "metres", "meters")
"""As files call the unit of heights."""
READ_POSTS = 2**22
LARGEST_SIDE = 2**18
"""Posts along one side; 1 arc second over 72 degrees."""
LARGEST_OFFSET_M = 200.0
"""The geoid lies within 110 m of the ellipsoid."""
ELLIPSOID = "EPSG:4979"


@dataclass(frozen=True)
class VerticalDatum:
    """How heights became ellipsoidal. `ecef` takes the file's x, y and heights (...) to longitude, latitude [deg] and
    ellipsoidal height [m]."""

    words: str
    to_geodetic: Callable[[F64, F64, F64], tuple[F64, F64, F64]]


def datum_of(path: Path, crs_wkt: str, geoid_offset_m: float | None, unit: str = "m") -> VerticalDatum:
    """What a file's coordinate system and the user say of its heights.

    With `geoid_offset_m` that is added to all heights. Without it the file must name a vertical datum, and PROJ must
    have the grid that leads from there to the ellipsoid. Raises InputError otherwise: most elevation models hold
    heights above the sea, and most files do not say so.
    """
    if geoid_offset_m is not None and not abs(geoid_offset_m) <= LARGEST_OFFSET_M:
        raise InputError(
            f"--geoid-offset: found {geoid_offset_m:g} m; must be from {-LARGEST_OFFSET_M:g} to {LARGEST_OFFSET_M:g}: "
            "the height of the sea's level over the WGS 84 ellipsoid"
        )
    try:
        import pyproj
        from pyproj.exceptions import ProjError
    except ImportError as error:
        raise InputError(f'{path}: `twin` needs pyproj: pip install "warpsar[geo]"') from error
    try:
        crs = pyproj.CRS.from_wkt(crs_wkt)
        flat = crs.to_2d() if crs.sub_crs_list == [] else crs.sub_crs_list[0]
        level = pyproj.Transformer.from_crs(flat, "EPSG:4326", always_xy=True)
    except ProjError as error:
        raise InputError(f"{path}: its coordinate system is not known to PROJ ({str(error)[:200]})") from error
    # of a vertical datum PROJ knows the unit
    if (geoid_offset_m is not None or not crs.is_vertical) and unit.lower() not in METRES:
        raise InputError(f"{path}: found heights in {unit!r}, by its band; must be metres ('m')")
    if geoid_offset_m is not None:
        words = f"{geoid_offset_m:+g} m were added to all heights, as stated"
        return VerticalDatum(words, lambda x, y, z: (*_flat(level, x, y), z + geoid_offset_m))
    if crs.is_vertical:
        name = crs.sub_crs_list[-1].name if crs.sub_crs_list else crs.name
        return VerticalDatum(*_by_grid(path, crs, name))
    if len(crs.axis_info) == 3:
        return VerticalDatum("the file's heights are above the ellipsoid, as it says", _three(crs))
    raise InputError(
        f"{path}: its coordinate system ({crs.name}) does not say what its heights are above; state --geoid-offset: "
        "0 for heights above the WGS 84 ellipsoid, else the geoid's height there [m]"
    )


def _flat(level: Any, x: F64, y: F64) -> tuple[F64, F64]:
    longitude, latitude = level.transform(x, y)
    return np.asarray(longitude), np.asarray(latitude)


def _three(crs: Any) -> Callable[[F64, F64, F64], tuple[F64, F64, F64]]:
    import pyproj

    whole = pyproj.Transformer.from_crs(crs, ELLIPSOID, always_xy=True)

    def convert(x: F64, y: F64, z: F64) -> tuple[F64, F64, F64]:
        longitude, latitude, height = whole.transform(x, y, z)
        return np.asarray(longitude), np.asarray(latitude), np.asarray(height)

    return convert


def _by_grid(path: Path, crs: Any, name: str) -> tuple[str, Callable[[F64, F64, F64], tuple[F64, F64, F64]]]:
    """By PROJ's own operation. It is refused where a grid is missing: PROJ would then leave heights as they are."""
    from pyproj.transformer import TransformerGroup

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of missing grids, which are named below
        group = TransformerGroup(crs, ELLIPSOID, always_xy=True, allow_ballpark=False)
    if not group.transformers or not group.best_available:
        grids = [grid.short_name for one in group.unavailable_operations for grid in one.grids if not grid.available]
        missing = f"PROJ lacks its grid {grids[0]}" if grids else "PROJ knows no way from there"
        how = f" (`pyproj sync --file {grids[0]}` fetches it)" if grids else ""
        raise InputError(
            f"{path}: heights are above {name}, and {missing}{how}; must be there, or state --geoid-offset: the "
            "geoid's height above the WGS 84 ellipsoid there [m]"
        )
    best = group.transformers[0]

    def convert(x: F64, y: F64, z: F64) -> tuple[F64, F64, F64]:
        longitude, latitude, height = best.transform(x, y, z)
        return np.asarray(longitude), np.asarray(latitude), np.asarray(height)

    return f"heights above {name} became ellipsoidal by PROJ: {best.description}", convert


@dataclass(frozen=True)
class PostWindow:
    """Longitude, latitude [deg] and ellipsoidal height [m], (rows, columns) each; height is NaN where there is no
    data."""

    longitude: F64
    latitude: F64
    height: F64


@dataclass(frozen=True)
class Elevation:
    """A raster of heights; posts are the middles of its pixels."""

    path: Path
    shape: tuple[int, int]
    crs: Any
    """rasterio's."""
    affine: Any
    datum: VerticalDatum
    lowest_m: float
    """Above the ellipsoid, of all posts."""
    highest_m: float
    spacing_m: tuple[float, float]
    """Between rows, and between columns, in the middle."""
    longitude_deg: float
    """Of the middle: longitudes of layers are counted from there, so that the date line makes no step."""

    @classmethod
    def read(cls, path: Path, geoid_offset_m: float | None = None) -> Elevation:
        """Raises InputError for a file that holds no heights, does not say where, or above what."""
        with geotiff.opened(path) as source:
            check_heights(path, source)
            if source.crs is None:
                raise InputError(f"{path}: found no coordinate system; must have one")
            if source.transform.is_identity:
                raise InputError(f"{path}: found no place of its heights (no geotransform); must have one")
            shape, crs, affine = (source.height, source.width), source.crs, source.transform
            if min(shape) < 2 or max(shape) > LARGEST_SIDE:
                raise InputError(
                    f"{path}: found {shape[0]} x {shape[1]} heights; must be at least 2 x 2, and at most "
                    f"{LARGEST_SIDE} along a side"
                )
            if shape[0] * shape[1] > LARGEST_PER_BYTE * path.stat().st_size:
                raise InputError(
                    f"{path}: found {shape[0]} x {shape[1]} heights in {path.stat().st_size} bytes: broken"
                )
            datum = datum_of(path, crs.to_wkt(), geoid_offset_m, source.units[0] or "m")
            low, high = np.inf, -np.inf
            rows = max(READ_POSTS // shape[1], 1)
            for first in range(0, shape[0], rows):
                band = _heights(source, first, min(first + rows, shape[0]), 0, shape[1])
                if np.isfinite(band).any():
                    low, high = min(low, np.nanmin(band)), max(high, np.nanmax(band))
        if not low <= high:
            raise InputError(f"{path}: found no valid height; must hold some")
        if low < HEIGHTS_M[0] or high > HEIGHTS_M[1]:
            raise InputError(
                f"{path}: found heights from {low:g} to {high:g}; must be metres from {HEIGHTS_M[0]:g} to "
                f"{HEIGHTS_M[1]:g}, and what means no data must be named in the file"
            )
        row, column = shape[0] // 2, shape[1] // 2
        row, column = min(row, shape[0] - 2), min(column, shape[1] - 2)
        square = _placed(affine, datum, np.array([row, row + 1]), np.array([column, column + 1]), np.zeros((2, 2)))
        lifted = square[2].mean()  # what the datum adds there
        corner = geodetic_to_ecef(np.stack([square[1], square[0], 0.0 * square[2]], axis=-1))
        steps = np.linalg.norm(corner[1, 0] - corner[0, 0]), np.linalg.norm(corner[0, 1] - corner[0, 0])
        if not all(np.isfinite(steps)) or min(steps) <= 0.0:
            raise InputError(f"{path}: its pixels have no size on the earth; check its coordinate system")
        margin = 10.0  # [m]: the geoid is not level over the file
        return cls(
            path, shape, crs, affine, datum, float(low + lifted - margin), float(high + lifted + margin),
            (float(steps[0]), float(steps[1])), float(square[0][0, 0]),
        )  # fmt: skip

    def window(self, rows: tuple[int, int], columns: tuple[int, int]) -> PostWindow:
        """Posts of rows and columns, from the first up to the last, that excluded."""
        with geotiff.opened(self.path) as source:
            height = _heights(source, *rows, *columns)
        placed = _placed(self.affine, self.datum, np.arange(*rows), np.arange(*columns), height)
        return PostWindow(*placed)

    def posts_at(self, longitude: F64, latitude: F64) -> tuple[F64, F64]:
        """Rows and columns of places [deg]; whole numbers are posts."""
        with geotiff.projecting(self.path):
            from rasterio.warp import transform

            flat = [np.asarray(each, np.float64).ravel() for each in (longitude, latitude)]
            x, y = (np.asarray(each) for each in transform("EPSG:4326", self.crs, *flat))
        if self.crs.is_geographic:
            x = same_turn(x, _through(self.affine, 0.5 * self.shape[1], 0.5 * self.shape[0])[0])
        column, row = _through(~self.affine, x, y)
        shape = np.shape(longitude)
        return np.reshape(row, shape) - 0.5, np.reshape(column, shape) - 0.5


def _heights(source: Any, top: int, bottom: int, left: int, right: int) -> F64:
    band = source.read(1, window=((top, bottom), (left, right)), masked=True)
    found = np.ma.filled(band.astype(np.float64), np.nan) * source.scales[0] + source.offsets[0]
    return np.where(np.isfinite(found), found, np.nan)


def _through(affine: Any, x: Any, y: Any) -> tuple[Any, Any]:
    return affine.a * x + affine.b * y + affine.c, affine.d * x + affine.e * y + affine.f


def _placed(
    affine: Any, datum: VerticalDatum, rows: NDArray[np.int64], columns: NDArray[np.int64], height: F64
) -> tuple[F64, F64, F64]:
    """Longitude, latitude and ellipsoidal height. A post without a height keeps its place."""
    column, row = np.meshgrid(columns + 0.5, rows + 0.5)
    x, y = _through(affine, column, row)
    known = np.isfinite(height)
    longitude, latitude, lifted = datum.to_geodetic(x, y, np.where(known, height, 0.0))
    return longitude, latitude, np.where(known, lifted, np.nan)
