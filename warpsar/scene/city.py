"""`warpsar new` for buildings of a real place: outlines or surfaces on an elevation model become one mesh."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io import geotiff
from warpsar.runtime import console
from warpsar.runtime.extra import Extra
from warpsar.scene import footprints
from warpsar.scene.footprints import Buildings, Outline, Ring, Surfaces
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Origin

EXTRA = Extra("geo", ("shapely", "rasterio"))

if TYPE_CHECKING:
    from affine import Affine

LIBRARY = {"ground": "grass", "walls": "brick", "roofs": "roof_tiles"}
"""The city's materials, and the surfaces of the library that they begin as."""
NAMES = tuple(LIBRARY)
MARGIN_M = 30.0
MOST_CELLS = 1000
"""Cells of the ground along a side."""
MERCATOR = ("EPSG:3857", "EPSG:3395")
"""Systems whose metre is shorter than a metre far from the equator, and means to be."""
MOST_STRETCH = 0.02
"""Twenty times what UTM and the grids of countries stretch a length by."""
_BURIED_M = 0.5  # walls begin below the ground, so that no gap shows on a slope


class Ground(Protocol):
    """Heights [m] at places (n, 2)."""

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]: ...


@dataclass(frozen=True)
class Terrain:
    """Heights over a grid: `z` [m], (rows, cols), at `x` and `y` [m], ascending."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bilinear heights at points (n, 2); of the border outside."""
        column, fx = _cell(self.x, points[:, 0])
        row, fy = _cell(self.y, points[:, 1])
        z = self.z
        low = z[row, column] * (1 - fx) + z[row, column + 1] * fx
        high = z[row + 1, column] * (1 - fx) + z[row + 1, column + 1] * fx
        return np.asarray(low * (1 - fy) + high * fy)


def _cell(axis: NDArray[np.float64], value: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    index = np.clip(np.searchsorted(axis, value) - 1, 0, axis.size - 2)
    return index, np.clip((value - axis[index]) / (axis[index + 1] - axis[index]), 0.0, 1.0)


def mesh_of(path: Path, dem: Path | None) -> tuple[Mesh, Origin]:
    """The buildings of a file on the ground, in metres about their middle, and where that is on the earth.

    World metres are azimuthal equidistant about the origin. Heights count from the ground at the origin; without an
    elevation model the ground is level, and every building stands on it. Raises InputError.
    """
    found = plan_of(path)
    terrain, base = _terrain(found.extent_m, dem, found.local_crs)
    made = _Made()
    made.ground(terrain)
    made.outlines(found, terrain)
    made.surfaces(found, base if dem is not None else None)
    latitude, longitude = round(found.latitude_deg, 8), round(found.longitude_deg, 8)
    return made.mesh(), Origin(latitude_deg=latitude, longitude_deg=longitude, height_m=round(base, 3))


def mesh_on(path: Path, ground: Callable[[TownPlan], Ground]) -> tuple[Mesh, TownPlan, NDArray[np.int32]]:
    """Buildings alone, on a ground of the caller's, and the building that each vertex belongs to.

    Vertices are metres of `TownPlan.local_crs`. Of outlines they have the ground's heights; those of surfaces are the
    file's own. An outline where the ground has no height (NaN) is left out. Raises InputError where none is left.
    """
    found = plan_of(path)
    made = _Made()
    made.outlines(found, ground(found))
    made.surfaces(found, 0.0)
    if not made.vertices:
        count = len(found.buildings.found)
        raise InputError(f"{path}: none of its {count} buildings lies where the ground has heights; must overlap")
    return made.mesh(), found, np.array(made.building, np.int32)


@dataclass(frozen=True)
class TownPlan:
    """Buildings in metres east and north of their middle: azimuthal equidistant, `local_crs`."""

    buildings: Buildings
    rings: list[list[Ring]]
    """Of each outline; none where the file has surfaces."""
    polygons: list[list[list[Ring]]]
    """Of each building of surfaces."""
    latitude_deg: float
    longitude_deg: float

    @property
    def local_crs(self) -> str:
        return f"+proj=aeqd +lat_0={self.latitude_deg} +lon_0={self.longitude_deg} +datum=WGS84 +units=m"

    @property
    def extent_m(self) -> NDArray[np.float64]:
        """The least and the greatest x and y, (2, 2)."""
        all_of = [*self.rings, *(rings for polygons in self.polygons for rings in polygons)]
        flat = np.concatenate([ring[:, :2] for rings in all_of for ring in rings])
        return np.stack([flat.min(axis=0), flat.max(axis=0)])

    def geodetic(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Longitude and latitude [deg] of places (n, 2)."""
        return _moved(self.local_crs, "EPSG:4326", points)


def plan_of(path: Path) -> TownPlan:
    """The buildings of a file about their middle. Raises InputError."""
    EXTRA.require(f"{path}: a file of buildings")
    buildings = _whole(path, footprints.read(path))
    flat = np.concatenate([ring[:, :2] for ring in _rings(buildings)])
    with geotiff.projecting(path):
        geographic = _geographic(buildings.crs)
        if geographic:
            flat = flat[:, ::-1] if buildings.latitude_first else flat
            _on_earth(path, flat)
        longitude, latitude = _moved(buildings.crs, "EPSG:4326", (flat.min(axis=0) + flat.max(axis=0))[None] / 2.0)[0]
    if not np.isfinite([longitude, latitude]).all():
        raise InputError(f"{path}: found x, y of {flat[0, 0]:g}, {flat[0, 1]:g}; must lie where {buildings.crs} holds")
    found = TownPlan(buildings, [], [], float(latitude), float(longitude))
    with geotiff.projecting(path):
        plan = _moved(buildings.crs, found.local_crs, flat)
    moved = iter(np.split(plan, np.cumsum([len(r) for r in _rings(buildings)])[:-1]))
    for one in buildings.found:
        if isinstance(one, Outline):
            found.rings.append([next(moved) for _ in one.rings])
        else:
            heights = [[ring[:, 2] for ring in rings] for rings in one.polygons]
            found.polygons.append([[np.column_stack([next(moved), z]) for z in rings] for rings in heights])
    if np.ptp(plan, axis=0).max() > 1e5:
        raise InputError(
            f"{path}: found buildings over {np.ptp(plan, axis=0).max() / 1e3:.0f} km; must be within 100 km"
        )
    _say(path, buildings, latitude, longitude)
    if not geographic and buildings.crs not in MERCATOR:
        _check_stretch(path, buildings, flat, plan, (latitude, longitude))
    return found


def _whole(path: Path, buildings: Buildings) -> Buildings:
    """Without outlines that cross themselves or have no area. Raises InputError where none is left."""
    import shapely

    kept = [one for one in buildings.found if isinstance(one, Outline)]
    if not kept:
        return buildings
    made = [shapely.Polygon(one.rings[0], one.rings[1:]) for one in kept]
    sound = [one for one, polygon in zip(kept, made, strict=True) if polygon.is_valid and polygon.area > 0.0]
    if not sound:
        raise InputError(f"{path}: found {len(kept)} outlines that cross themselves or have no area; must be others")
    if len(sound) < len(kept):
        console.warn([f"{path}: {len(kept) - len(sound)} outlines cross themselves or have no area, and are left out"])
    return Buildings(buildings.crs, sound, buildings.latitude_first)


def _on_earth(path: Path, flat: NDArray[np.float64]) -> None:
    """Raises InputError for what is no longitude and latitude."""
    wrong = np.flatnonzero((np.abs(flat) > (180.0, 90.0)).any(axis=1))
    if wrong.size:
        x, y = flat[wrong[0]]
        raise InputError(
            f"{path}: found longitude {x:g}, latitude {y:g}; must lie within 180 and 90 degrees. In GeoJSON longitude "
            f'comes first, and metres need a member "crs" that names their system'
        )


def _check_stretch(
    path: Path, buildings: Buildings, flat: NDArray[np.float64], plan: NDArray[np.float64], at: tuple[float, float]
) -> None:
    """Warn where lengths in the file's own metres, `flat`, are far from those on the ground, `plan`."""
    from rasterio.crs import CRS

    unit_m = CRS.from_string(buildings.crs).linear_units_factor[1]
    along, across = (float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()) for points in (plan, flat))
    stretch = along / (across * unit_m)
    if abs(stretch - 1.0) > MOST_STRETCH:
        console.warn(
            [
                f"{path}: a metre of {buildings.crs} is {stretch:.2f} m there, at latitude {at[0]:.3f}, longitude "
                f"{at[1]:.3f}; x was taken as east and y as north: are they exchanged?"
            ]
        )


def _say(path: Path, buildings: Buildings, latitude: float, longitude: float) -> None:
    unknown = sum(isinstance(one, Outline) and one.height_m is None for one in buildings.found)
    unknown_heights = f"; {unknown} without a height are {footprints.UNKNOWN_M:g} m high" if unknown else ""
    place = f"; about latitude {latitude:.4f}, longitude {longitude:.4f}"
    console.say(f"{path}: {len(buildings.found)} buildings{unknown_heights}{place}")


def _rings(buildings: Buildings) -> list[Ring]:
    """Every ring of every building, in order."""
    found: list[Ring] = []
    for one in buildings.found:
        found += one.rings if isinstance(one, Outline) else [ring for rings in one.polygons for ring in rings]
    return found


def _geographic(crs: str) -> bool:
    from rasterio.crs import CRS

    return bool(CRS.from_string(crs).is_geographic)


def _moved(source: str, target: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 2) in another coordinate system, x or longitude first."""
    from rasterio.crs import CRS
    from rasterio.warp import transform

    known = [CRS.from_string(name) for name in (source, target)]
    return np.column_stack(transform(*known, points[:, 0], points[:, 1]))


def _terrain(extent: NDArray[np.float64], dem: Path | None, local: str) -> tuple[Terrain, float]:
    """The ground under the buildings, and the height [m] at the origin, which becomes zero."""
    low, high = extent[0] - MARGIN_M, extent[1] + MARGIN_M
    if dem is None:
        x, y = (np.array([a, b]) for a, b in zip(low, high, strict=True))
        return Terrain(x, y, np.zeros((2, 2))), 0.0
    with geotiff.opened(dem) as source:
        if source.crs is None:
            raise InputError(f"{dem}: found no coordinate system; must have one, so that buildings find their place")
        heights = np.ma.filled(source.read(1, masked=True).astype(float), np.nan) * source.scales[0] + source.offsets[0]
        place, crs = source.transform, source.crs.to_string()
    cell = max(1.0, float((high - low).max()) / MOST_CELLS, _pixel_m(crs, local, place))
    x, y = (np.arange(a, b + cell, cell) for a, b in zip(low, high, strict=True))
    grid = np.column_stack([axis.ravel() for axis in np.meshgrid(x, y)])
    with geotiff.projecting(dem):
        column, row = _applied(~place, _moved(local, crs, grid)).T - 0.5
    rows, cols = heights.shape
    if not ((row > -1.0) & (row < rows) & (column > -1.0) & (column < cols)).all():
        raise InputError(f"{dem}: does not reach under all buildings and {MARGIN_M:g} m beyond; must cover them")
    raster = Terrain(np.arange(cols, dtype=float), np.arange(rows, dtype=float), heights)
    z = raster.at(np.column_stack([column, row])).reshape(y.size, x.size)
    if not np.isfinite(z).all():
        raise InputError(f"{dem}: found pixels without a height under the buildings; must have one everywhere there")
    base = float(Terrain(x, y, z).at(np.zeros((1, 2)))[0])
    return Terrain(x, y, z - base), base


def _pixel_m(crs: str, local: str, place: Affine) -> float:
    """A pixel of the elevation model [m], at the origin."""
    at = _applied(~place, _moved(local, crs, np.zeros((1, 2))))
    ends = _applied(place, np.concatenate([at, at + np.array([1.0, 0.0])]))
    return float(np.linalg.norm(np.diff(_moved(crs, local, ends), axis=0)))


def _applied(place: Affine, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """An affine map of points (n, 2)."""
    x, y = points.T
    return np.column_stack([place.a * x + place.b * y + place.c, place.d * x + place.e * y + place.f])


class _Made:
    """Triangles of the city by material, as they are added."""

    def __init__(self) -> None:
        self.vertices: list[NDArray[np.float64]] = []
        self.faces: list[NDArray[np.int32]] = []
        self.owner: list[int] = []
        self.building: list[int] = []
        self.now = -1
        self.count = 0

    def add(self, name: str, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
        self.vertices.append(vertices)
        self.building += [self.now] * len(vertices)
        self.faces.append((faces + self.count).astype(np.int32))
        self.owner += [NAMES.index(name)] * len(faces)
        self.count += len(vertices)

    def ground(self, terrain: Terrain) -> None:
        x, y = np.meshgrid(terrain.x, terrain.y)
        at = np.arange(x.size).reshape(x.shape)
        a, b, c, d = (corner.ravel() for corner in (at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]))
        vertices = np.column_stack([x.ravel(), y.ravel(), terrain.z.ravel()])
        self.add("ground", vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))

    def outlines(self, plan: TownPlan, ground: Ground) -> None:
        for self.now, (one, rings) in enumerate(zip(plan.buildings.found, plan.rings, strict=False)):
            assert isinstance(one, Outline)
            self.prism(rings, one.height_m or footprints.UNKNOWN_M, ground)

    def surfaces(self, plan: TownPlan, zero_m: float | None) -> None:
        """Heights count from `zero_m`; None: from each building's lowest point."""
        for self.now, (one, polygons) in enumerate(zip(plan.buildings.found, plan.polygons, strict=False)):
            assert isinstance(one, Surfaces)
            lowest = min(float(ring[:, 2].min()) for rings in polygons for ring in rings)
            self.solid(polygons, one.kinds, lowest if zero_m is None else zero_m)

    def prism(self, rings: list[Ring], height: float, terrain: Ground) -> None:
        """Upright walls and a flat roof, `height` above the mean ground at the outline."""
        foot = terrain.at(rings[0])
        if not np.isfinite(foot).all():
            return
        top = float(foot.mean()) + height
        flat = np.concatenate(rings)
        self.add("roofs", np.column_stack([flat, np.full(len(flat), top)]), _triangles(rings))
        for number, ring in enumerate(rings):
            ring = ring if _counterclockwise(ring) == (number == 0) else ring[::-1]  # so that walls look outward
            n = len(ring)
            bottom = np.full(n, float(foot.min()) - _BURIED_M)
            both = np.concatenate([np.column_stack([ring, z]) for z in (bottom, np.full(n, top))])
            i, j = np.arange(n), (np.arange(n) + 1) % n
            self.add("walls", both, np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]))

    def solid(self, polygons: list[list[Ring]], kinds: list[str], zero_m: float) -> None:
        """Polygons in space; heights count from `zero_m`."""
        for rings, kind in zip(polygons, kinds, strict=True):
            corners = np.concatenate(rings) - (0.0, 0.0, zero_m)
            up = footprints.normal(rings[0])
            if not up.any():
                continue
            dropped = int(np.argmax(np.abs(up)))  # the plane on which the polygon is widest
            faces = _triangles([np.delete(ring, dropped, axis=1) for ring in rings])
            if up[dropped] * (-1.0, 1.0)[dropped != 1] < 0.0:  # the plane's own third axis is x, -y or z
                faces = faces[:, ::-1]
            self.add("roofs" if kind == "roof" else "walls", corners, faces)

    def mesh(self) -> Mesh:
        """The whole; materials without a face are left out."""
        owner = np.array(self.owner, np.int32)
        used = np.unique(owner)
        names = tuple(NAMES[index] for index in used)
        return Mesh(
            np.concatenate(self.vertices),
            np.concatenate(self.faces),
            np.searchsorted(used, owner).astype(np.int32),
            names,
        )


def _counterclockwise(ring: Ring) -> bool:
    x, y = (ring - ring[0]).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) > 0.0


def _triangles(rings: list[Ring]) -> NDArray[np.int64]:
    """Counterclockwise triangles of a flat polygon with holes, as indices into its corners; none for one that crosses
    itself."""
    import shapely

    corners = np.concatenate(rings)
    polygon = shapely.Polygon(rings[0], rings[1:])
    if not polygon.is_valid or polygon.area <= 0.0:
        return np.empty((0, 3), np.int64)
    index = {tuple(corner): at for at, corner in enumerate(corners.tolist())}
    parts = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    parts = shapely.orient_polygons(parts)
    found = [[index[tuple(corner)] for corner in shapely.get_coordinates(part)[:3].tolist()] for part in parts]
    return np.array(found, np.int64).reshape(-1, 3)
