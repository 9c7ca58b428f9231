"""Land cover in GeoTIFF: classes of a stated table become surfaces of the library."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, did_you_mean, shown
from warpsar.io import geotiff
from warpsar.terrain.elevation import READ_POSTS
from warpsar.world.earth import same_turn
from warpsar.world.library.surfaces import SURFACES

F64 = NDArray[np.float64]
MOST_CLASSES = 1000
MARGIN_CELLS = 2
WORLDCOVER = {
    10: "grass",
    20: "grass",
    30: "grass",
    40: "soil_dry",
    50: "asphalt",
    60: "gravel",
    70: "snow_dry",
    80: "water_calm",
    90: "soil_wet",
    95: "soil_wet",
    100: "grass",
}
"""ESA WorldCover 2020 and 2021 (Zanaga et al. 2022). The library has no trees: forest is ground. Built-up is the ground
between houses."""
_CORINE = (
    *("111 112 121 122 123 124", "asphalt"),
    *("131 132", "gravel"),
    *("133", "soil_dry"),
    *("141 142", "grass"),
    *("211 212", "soil_dry"),
    *("213", "soil_wet"),
    *("221 222 223", "soil_dry"),
    *("231", "grass"),
    *("241 242", "soil_dry"),
    *("243 244 311 312 313 321 322 323 324", "grass"),
    *("331", "soil_dry"),
    *("332 333", "gravel"),
    *("334", "soil_dry"),
    *("335", "snow_dry"),
    *("411 412 421 422 423", "soil_wet"),
    *("511 512 521", "water_calm"),
    *("522 523", "water_rough"),
)
_BY_CODE = {
    int(code): surface for codes, surface in zip(_CORINE[::2], _CORINE[1::2], strict=True) for code in codes.split()
}
CORINE = {**dict(enumerate(_BY_CODE.values(), 1)), **_BY_CODE}
"""CORINE Land Cover: the three digits of its nomenclature, or 1 to 44 as its rasters have them, in the same order."""
TABLES: Mapping[str, Mapping[int, str]] = {"worldcover": WORLDCOVER, "corine": CORINE}


def table_of(name: str) -> Mapping[int, str]:
    """A table by name, or a TOML file with `[surfaces]`: class = "surface of the library". Raises InputError."""
    if name in TABLES:
        return TABLES[name]
    path = Path(name)
    if not path.is_file():
        hint = did_you_mean(name, TABLES)
        raise InputError(f"--landcover-table: found {name!r}; must be {', '.join(TABLES)}, or a TOML file{hint}")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read as TOML ({error})") from error
    surfaces = content.get("surfaces")
    if set(content) != {"surfaces"} or not isinstance(surfaces, dict) or not surfaces:
        raise InputError(
            f"{path}: found {shown(', '.join(content) or 'nothing')}; must hold one table [surfaces], with lines such "
            'as 10 = "grass"'
        )
    found: dict[int, str] = {}
    for key, surface in surfaces.items():
        if not key.isdecimal():
            raise InputError(f"{path}: surfaces: found the class {shown(key)}; must be a whole number from 0")
        if surface not in SURFACES:
            hint = did_you_mean(str(surface), SURFACES)
            raise InputError(
                f"{path}: surfaces.{key}: found {shown(surface)}; must be one of {', '.join(SURFACES)}{hint}"
            )
        found[int(key)] = surface
    return found


@dataclass(frozen=True)
class LandCover:
    """A raster of classes. A place outside of it, or without a class, has `row_elsewhere`."""

    path: Path
    shape: tuple[int, int]
    crs: Any
    """rasterio's."""
    affine: Any
    row_of: Mapping[int, int]
    """Of each class: the row of sigma0."""
    row_elsewhere: int

    @classmethod
    def read(cls, path: Path, table: Mapping[int, str], surfaces: list[str], elsewhere: str) -> LandCover:
        """Adds the surfaces that the raster's classes are to `surfaces`, whose order is that of the rows of sigma0.

        Raises InputError for a raster without whole numbers or a place, or with a class that the table does not name.
        """
        found: set[int] = set()
        with geotiff.opened(path) as source:
            if source.count != 1 or np.dtype(source.dtypes[0]).kind not in "iu":
                raise InputError(
                    f"{path}: found {source.count} bands of {source.dtypes[0]}; must be one band of whole numbers, the "
                    "classes"
                )
            if source.crs is None:
                raise InputError(f"{path}: found no coordinate system; must have one")
            shape, crs, affine = (source.height, source.width), source.crs, source.transform
            rows = max(READ_POSTS // shape[1], 1)
            for first in range(0, shape[0], rows):
                window = ((first, min(first + rows, shape[0])), (0, shape[1]))
                found |= set(np.unique(source.read(1, window=window, masked=True).compressed()).tolist())
                if len(found) > MOST_CLASSES:
                    raise InputError(f"{path}: found more than {MOST_CLASSES} classes; must hold classes of land cover")
        found -= {0} - set(table)  # of no data, in all of these rasters
        unknown = sorted(found - set(table))
        if unknown:
            some = ", ".join(map(str, unknown[:8])) + (", ..." if len(unknown) > 8 else "")
            raise InputError(
                f"{path}: found the classes {some}; the table knows {', '.join(map(str, sorted(table)[:15]))}"
                f"{', ...' if len(table) > 15 else ''}; state another one by --landcover-table: "
                f"{', '.join(TABLES)}, or a TOML file"
            )
        if not found:
            raise InputError(f"{path}: found no class; must hold some")
        for code in sorted(found):
            if table[code] not in surfaces:
                surfaces.append(table[code])
        rows_of = {code: surfaces.index(table[code]) for code in found}
        return cls(path, shape, crs, affine, rows_of, surfaces.index(elsewhere))

    def meets(self, longitude: F64, latitude: F64) -> bool:
        """Whether the raster reaches into the box about these places [deg]."""
        return all(
            at.max() > 0.0 and at.min() < count
            for at, count in zip(self._at(longitude.ravel(), latitude.ravel()), reversed(self.shape), strict=True)
        )

    def _at(self, longitude: F64, latitude: F64) -> tuple[F64, F64]:
        """Columns and rows of places (n,) [deg]; whole numbers are corners of cells."""
        with geotiff.projecting(self.path):
            from rasterio.warp import transform

            x, y = (np.asarray(each) for each in transform("EPSG:4326", self.crs, longitude, latitude))
        if self.crs.is_geographic:
            x = same_turn(x, self.affine.c + 0.5 * (self.shape[1] * self.affine.a + self.shape[0] * self.affine.b))
        inverse = ~self.affine
        return inverse.a * x + inverse.b * y + inverse.c, inverse.d * x + inverse.e * y + inverse.f

    def around(self, geodetic: F64) -> tuple[NDArray[np.int32], F64]:
        """Rows of sigma0 (r, c) about places (n, 3: latitude, longitude, height), and each place's column and row in
        that part, (n, 2). Beyond the raster's edge lies a cell of `row_elsewhere`."""
        column, row = self._at(geodetic[:, 1], geodetic[:, 0])
        # a cell more than the raster has, on every side: outside of it
        (top, bottom), (left, right) = (
            (max(int(np.floor(at.min())) - MARGIN_CELLS, -1), min(int(np.ceil(at.max())) + MARGIN_CELLS, count + 1))
            for at, count in zip((row, column), self.shape, strict=True)
        )
        if bottom <= max(top, 0) or right <= max(left, 0) or top >= self.shape[0] or left >= self.shape[1]:
            return np.full((1, 1), self.row_elsewhere, np.int32), np.zeros((len(geodetic), 2))
        inside = (max(top, 0), min(bottom, self.shape[0])), (max(left, 0), min(right, self.shape[1]))
        with geotiff.opened(self.path) as source:
            read = source.read(1, window=inside, masked=True)
        known = ~np.ma.getmaskarray(read)
        classes = np.full(read.shape, self.row_elsewhere, np.int32)
        for code, number in self.row_of.items():
            classes[known & (read.data == code)] = number
        edges = ((inside[0][0] - top, bottom - inside[0][1]), (inside[1][0] - left, right - inside[1][1]))
        classes = np.pad(classes, edges, constant_values=self.row_elsewhere)
        return classes, np.stack([column - left, row - top], axis=-1)
