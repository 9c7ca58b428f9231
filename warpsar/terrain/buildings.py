"""Buildings of GeoJSON and CityGML on the elevation model's ground, as facets in geodetic coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.runtime import console
from warpsar.scene import city
from warpsar.scene.city import TownPlan
from warpsar.terrain.elevation import Elevation

F64 = NDArray[np.float64]
SURFACES = {name: city.LIBRARY[name] for name in ("walls", "roofs")}
"""Of the library."""


@dataclass(frozen=True)
class TerrainBuildings:
    """Vertices (n,) and triangles (m, 3), counter-clockwise from outside."""

    path: Path
    count: int
    """Buildings that lie on the elevation model."""
    geodetic: F64
    """(n, 3): latitude, longitude [deg], height above the ellipsoid [m]."""
    post: F64
    """(n, 2): row and column of the elevation model, fractional."""
    faces: NDArray[np.int64]
    building: NDArray[np.int32]
    """(m,): which one a triangle is of, from 0."""
    row: NDArray[np.int32]
    """(m,): of sigma0."""
    highest_m: float
    """Above the ellipsoid."""

    def within(self, rows: tuple[int, int], columns: tuple[int, int]) -> TerrainBuildings | None:
        """Buildings with a corner on these rows and columns of the elevation model; None where there are none."""
        inside = np.ones(len(self.post), bool)
        for at, (first, last) in zip(self.post.T, (rows, columns), strict=True):
            inside &= (at >= first) & (at <= last - 1)
        there = np.zeros(int(self.building.max()) + 1, bool)
        np.logical_or.at(there, self.building, inside[self.faces].any(axis=1))
        return self.part(there[self.building]) if there.any() else None

    def part(self, kept: NDArray[np.bool_]) -> TerrainBuildings:
        """Triangles that are kept (m,), and their vertices alone."""
        faces = self.faces[kept]
        used, number = np.unique(faces, return_inverse=True)
        return replace(
            self, geodetic=self.geodetic[used], post=self.post[used], faces=number.reshape(-1, 3),
            building=self.building[kept], row=self.row[kept],
        )  # fmt: skip


class _Posts:
    """Heights above the ellipsoid between posts, at places of a town's plan; NaN outside, and without data."""

    def __init__(self, elevation: Elevation, plan: TownPlan) -> None:
        self._elevation, self._plan = elevation, plan
        low, high = plan.extent_m
        edge = np.linspace(0.0, 1.0, 9)
        x, y = (each.ravel() for each in np.meshgrid(*((a + edge * (b - a)) for a, b in zip(low, high, strict=True))))
        row, column = self._rows(np.column_stack([x, y]))
        self._rows_kept, self._columns_kept = (
            (max(int(at.min()) - 2, 0), min(int(at.max()) + 3, count))
            for at, count in zip((row, column), elevation.shape, strict=True)
        )
        self._there = all(last - first >= 2 for first, last in (self._rows_kept, self._columns_kept))
        if self._there:
            self._height = elevation.window(self._rows_kept, self._columns_kept).height

    def _rows(self, points: F64) -> tuple[F64, F64]:
        longitude, latitude = self._plan.geodetic(points).T
        return self._elevation.posts_at(longitude, latitude)

    def at(self, points: F64) -> F64:
        if not self._there:
            return np.full(len(points), np.nan)
        row, column = self._rows(points)
        down, along = row - self._rows_kept[0], column - self._columns_kept[0]
        rows, columns = self._height.shape
        inside = (down >= 0) & (down <= rows - 1) & (along >= 0) & (along <= columns - 1)
        i, j = (np.clip(np.floor(at).astype(int), 0, n - 2) for at, n in ((down, rows), (along, columns)))
        u, v = down - i, along - j
        z = self._height
        upper, lower = (z[k, j] * (1 - v) + z[k, j + 1] * v for k in (i, i + 1))
        return np.where(inside, upper * (1 - u) + lower * u, np.nan)


def placed(path: Path, elevation: Elevation, surfaces: list[str]) -> TerrainBuildings:
    """A file's buildings, each outline on the mean ground along it. Adds what they are made of to `surfaces`.

    Heights of CityGML are taken to be above what the elevation model's are. Buildings that reach beyond the elevation
    model are left out, with a warning. Raises InputError where none is left.
    """
    mesh, plan, owner = city.mesh_on(path, lambda plan: _Posts(elevation, plan))
    with geotiff.projecting(path):
        longitude, latitude = plan.geodetic(mesh.vertices[:, :2]).T
    height = np.asarray(mesh.vertices[:, 2], np.float64)
    if plan.polygons:
        longitude, latitude, height = _lifted(elevation, longitude, latitude, height)
    row, column = elevation.posts_at(longitude, latitude)
    over = np.isfinite(height) & (row >= 0) & (column >= 0)
    over &= (row <= elevation.shape[0] - 1) & (column <= elevation.shape[1] - 1)
    total = len(plan.buildings.found)
    whole = np.ones(total, bool)
    np.logical_and.at(whole, owner, over)
    whole &= np.bincount(owner, minlength=total) > 0
    if not whole.any():
        raise InputError(f"{path}: none of its {total} buildings lies on {elevation.path}; must overlap")
    if not whole.all():
        console.warn(
            [f"{path}: {int((~whole).sum())} of {total} buildings reach beyond {elevation.path}, and are left out"]
        )
    for name in SURFACES.values():
        if name not in surfaces:
            surfaces.append(name)
    rows = np.array([surfaces.index(SURFACES[name]) for name in mesh.materials], np.int32)
    building = owner[mesh.faces[:, 0]]
    found = TerrainBuildings(
        path, int(whole.sum()), np.stack([latitude, longitude, height], axis=-1), np.stack([row, column], axis=-1),
        np.asarray(mesh.faces, np.int64), building, rows[mesh.face_material], 0.0,
    ).part(whole[building])  # fmt: skip
    return replace(found, highest_m=float(found.geodetic[:, 2].max()))


def _lifted(elevation: Elevation, longitude: F64, latitude: F64, height: F64) -> tuple[F64, F64, F64]:
    """Heights above what the elevation model's are, to heights above the ellipsoid."""
    with geotiff.projecting(elevation.path):
        from rasterio.warp import transform

        x, y = (np.asarray(each) for each in transform("EPSG:4326", elevation.crs, longitude, latitude))
    return elevation.datum.to_geodetic(x, y, height)
