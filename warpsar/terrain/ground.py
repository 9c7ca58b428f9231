"""What one block of a product may show: posts of the ground in lines and slant ranges, facets, and buildings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.products.grid import LineGrid
from warpsar.products.product import Product
from warpsar.products.zero_doppler import abeam, axes_up, locate
from warpsar.terrain.blocks import ImageBlock
from warpsar.terrain.elevation import Elevation
from warpsar.terrain.scenery import Scenery
from warpsar.world.earth import LocalEarth, ecef_to_geodetic, geodetic_to_ecef, same_turn

F64 = NDArray[np.float64]
TOLERANCE_S = 1e-8
"""Of zero-Doppler times: under 0.1 mm of flight."""


@dataclass(frozen=True)
class GroundPosts:
    """Posts (n,) of a block, and facets (m, 3) between them, counter-clockwise from above."""

    point_m: F64
    """(n, 3), local: east, north and up at `origin`."""
    geodetic: F64
    """(n, 3): latitude, longitude [deg], height [m]."""
    line: F64
    """From the block's first."""
    slant_m: F64
    """From `start_m`."""
    look: F64
    """(n, 3): unit vectors to the radar, local."""
    up: F64
    """(n, 3): the ellipsoid's normals, local."""
    facets: NDArray[np.int32]
    origin: LocalEarth
    start_m: float
    forward: float
    """Sign of a level facet's area in (line, slant range)."""
    cell: NDArray[np.int32]
    """(rows - 1, columns - 1): the first of the two facets between four posts; -1 for none."""
    turned: bool
    """Whether facets have their corners in the other order than the raster has: its rows run north, or columns west."""
    ground_facets: int
    """Facets of the ground; those after them are of buildings."""
    cover: NDArray[np.int32]
    """(m,): the row of sigma0 of each facet; -1 where `classes` says it."""
    class_place: F64
    """(n, 2): column and row of each post in `classes`; whole numbers are corners of cells."""
    classes: NDArray[np.int32]
    """(rows, columns): the row of sigma0."""


def ground_of(product: Product, elevation: Elevation, block: ImageBlock, scenery: Scenery) -> GroundPosts | None:
    """None where the elevation model has no data there."""
    found = elevation.window(block.rows, block.columns)
    rows, columns = found.height.shape
    known = np.isfinite(found.height)
    whole = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    if not whole.any():
        return None
    number = np.arange(rows * columns).reshape(rows, columns)
    corner = number[:-1, :-1][whole]
    # the diagonal is that of `world/meshes/dem.py`
    pairs = np.stack(
        [
            np.stack([corner, corner + columns, corner + 1], axis=1),
            np.stack([corner + 1, corner + columns, corner + columns + 1], axis=1),
        ],
        axis=1,
    )
    used = np.zeros(rows * columns, bool)
    used[pairs] = True
    post = np.where(used, np.cumsum(used) - 1, -1)
    cell = np.full(whole.shape, -1, np.int32)
    cell[whole] = 2 * np.arange(corner.size)
    facets = post[pairs.reshape(-1, 3)]
    geodetic = np.stack([each.ravel()[used] for each in (found.latitude, found.longitude, found.height)], axis=-1)
    point = geodetic_to_ecef(geodetic)
    middle = block.grid.time_s(
        0.5 * (block.window.lines[0] + block.window.lines[1]) - block.grid_line,
        0.5 * (block.window.pixels[0] + block.window.pixels[1]),
    )
    orbit = product.required_orbit
    time, slant = abeam(orbit, point, float(middle), TOLERANCE_S)
    cover = np.full(len(facets), scenery.ground_row, np.int32)
    classes, class_place = scenery.classes_at(geodetic)
    built = None if scenery.buildings is None else scenery.buildings.within(block.rows, block.columns)
    ground_facets = len(facets)
    origin = LocalEarth(*ecef_to_geodetic(point.mean(axis=0)))  # a mean of longitudes fails at the date line
    centre = geodetic_to_ecef(np.array([origin.latitude_deg, origin.longitude_deg, origin.height_m]))
    a, b, c = ((point[facets[0, i]] - centre) @ origin.axes.T for i in range(3))
    turned = bool(_around(a, b, c) < 0.0)
    if turned:
        facets = facets[:, ::-1]
    if built is not None:
        facets = np.concatenate([facets, built.faces + len(point)])
        cover = np.concatenate([cover, built.row])
        geodetic, class_place = (
            np.concatenate([geodetic, built.geodetic]),
            np.pad(class_place, ((0, len(built.geodetic)), (0, 0))),
        )
        corners = geodetic_to_ecef(built.geodetic)
        time, slant = (
            np.concatenate(pair)
            for pair in zip((time, slant), abeam(orbit, corners, float(middle), TOLERANCE_S), strict=True)
        )
        point = np.concatenate([point, corners])
    geodetic[:, 1] = same_turn(geodetic[:, 1], origin.longitude_deg)
    local = (point - centre) @ origin.axes.T
    look = (orbit.at(time)[0] - point) / slant[:, None] @ origin.axes.T
    line = block.grid.line(time, slant) - (block.window.lines[0] - block.grid_line)
    start = float(slant.mean())
    return GroundPosts(
        local, geodetic, line, slant - start, look, axes_up(geodetic) @ origin.axes.T,
        np.ascontiguousarray(facets, np.int32), origin, start, _forward(product, block.grid, float(middle), start),
        cell, turned, ground_facets, cover, class_place, classes,
    )  # fmt: skip


def _forward(product: Product, grid: LineGrid, time: float, slant: float) -> float:
    """Of three places on the ellipsoid, counter-clockwise from above: the sign of their area in (line, slant range)."""
    orbit = product.required_orbit
    at = locate(orbit, [time, time + 0.01, time], [slant, slant, slant + 20.0], 0.0, product.side)
    here = LocalEarth(*at[0])
    local = (geodetic_to_ecef(at) - geodetic_to_ecef(at[0])) @ here.axes.T
    return float(np.sign(_around(*local[:, :2])) * np.sign(grid.line_s))


def _around(a: F64, b: F64, c: F64) -> float:
    """Positive for three places on the plane that run counter-clockwise."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def edges_of(grid: LineGrid, lines: tuple[int, int], pixels: tuple[int, int]) -> F64:
    """Slant ranges [m] at which pixels begin and end, (lines, pixels + 1), lines of this grid."""
    line = np.arange(*lines)[:, None]
    pixel = np.arange(pixels[0], pixels[1] + 1)[None, :] - 0.5
    found: F64 = np.broadcast_to(grid.slant_m(line, pixel), (line.size, pixel.size))
    return found
