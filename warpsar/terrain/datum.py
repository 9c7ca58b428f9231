"""From the heights of a file to heights above the WGS 84 ellipsoid: never by a guess."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError

F64 = NDArray[np.float64]
LARGEST_OFFSET_M = 200.0
"""The geoid lies within 110 m of the ellipsoid."""
ELLIPSOID = "EPSG:4979"


@dataclass(frozen=True)
class VerticalDatum:
    """How heights became ellipsoidal. `ecef` takes the file's x, y and heights (...) to longitude, latitude [deg] and
    ellipsoidal height [m]."""

    words: str
    to_geodetic: Callable[[F64, F64, F64], tuple[F64, F64, F64]]


def datum_of(path: Path, crs_wkt: str, geoid_offset_m: float | None) -> VerticalDatum:
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
