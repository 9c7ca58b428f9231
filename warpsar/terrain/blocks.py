"""A product's window in blocks of bounded size, each with the part of the elevation model that it may show."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, NothingShownError
from warpsar.products.grid import LineGrid
from warpsar.products.product import Product
from warpsar.products.zero_doppler import abeam, locate
from warpsar.runtime import console
from warpsar.terrain.elevation import Elevation
from warpsar.world.earth import geodetic_to_ecef

F64 = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""West, south, east, north [deg]."""
SIDE = 1024
"""Pixels along a block's side at most; with `MOST_POSTS` it bounds the memory of a block."""
MOST_POSTS = 2**21
LEAST_SIDE = 32
MARGIN_POSTS = 3
LOOKS = 48
"""Places along each side of the elevation model at which its part of the image is looked for."""


@dataclass(frozen=True)
class ImageWindow:
    """Lines and pixels of a product: from the first up to the last, that excluded."""

    lines: tuple[int, int]
    pixels: tuple[int, int]

    @property
    def shape(self) -> tuple[int, int]:
        return self.lines[1] - self.lines[0], self.pixels[1] - self.pixels[0]


@dataclass(frozen=True)
class ImageBlock:
    """A part of the window. `grid` has one burst at most; its line 0 is the product's `grid_line`."""

    window: ImageWindow
    grid: LineGrid
    grid_line: int
    rows: tuple[int, int]
    """Of the elevation model."""
    columns: tuple[int, int]


def bursts_of(grid: LineGrid) -> list[tuple[int, LineGrid]]:
    """The first line of each burst, and its own grid; the whole grid where there are none."""
    if not grid.burst_start_s:
        return [(0, grid)]
    lines = grid.lines // len(grid.burst_start_s)
    return [
        (i * lines, replace(grid, lines=lines, first_line_s=start, burst_start_s=()))
        for i, start in enumerate(grid.burst_start_s)
    ]


def window_of(product: Product, ground: Elevation, crop: Box | None) -> ImageWindow:
    """The part of the image that can show the elevation model, or `crop` of it. Raises NothingShownError where there
    is none.

    Places over the model, at its lowest and its highest height, go through zero Doppler.
    """
    _refuse_short_orbit(product)
    longitude, latitude = places_on(ground)
    inside = np.ones(longitude.shape, bool)
    if crop is not None:
        longitude, latitude = places_in(crop)
        inside = _over(ground, longitude, latitude)
    places = np.concatenate(
        [
            np.stack([latitude[inside], longitude[inside], np.full(int(inside.sum()), height)], axis=-1)
            for height in (ground.lowest_m, ground.highest_m)
        ]
    )
    time, slant = abeam(product.required_orbit, geodetic_to_ecef(places), product.grid.middle_s)
    orbit = product.required_orbit
    reached = orbit.covered(time, float(np.diff(orbit.time_s).max()))
    time, slant = time[reached], slant[reached]
    lines: list[int] = []
    pixels: list[int] = []
    for first, grid in bursts_of(product.grid):
        line, pixel = grid.line(time, slant), _pixel(grid, time, slant)
        if _meets(line, grid.lines) and _meets(pixel, grid.pixels):
            lines += [first + _inside(line.min(), grid.lines), first + _inside(line.max(), grid.lines)]
            pixels += [_inside(pixel.min(), grid.pixels), _inside(pixel.max(), grid.pixels)]
    if not lines:
        raise NothingShownError(
            f"{product.source}: it shows no place of {ground.path} (which reaches from {_reach(ground)}); must overlap"
        )
    return ImageWindow((min(lines), max(lines) + 1), (min(pixels), max(pixels) + 1))


def check_crop(ground: Elevation, crop: Box) -> None:
    """Raise InputError for a crop beyond the elevation model; warn of one that reaches over its edge."""
    over = _over(ground, *places_in(crop))
    west, south, east, north = crop
    if not over.any():
        raise InputError(
            f"--crop: found {west:g} {south:g} {east:g} {north:g}; {ground.path} holds none of it (it reaches from "
            f"{_reach(ground)})"
        )
    if not over.all():
        part = f"{ground.path} holds {100.0 * over.mean():.2g} % of it, and reaches from {_reach(ground)}"
        console.warn([f"--crop: {part}; that part is simulated"])


def _over(ground: Elevation, longitude: F64, latitude: F64) -> NDArray[np.bool_]:
    row, column = ground.posts_at(longitude, latitude)
    return np.asarray((row >= 0) & (row <= ground.shape[0] - 1) & (column >= 0) & (column <= ground.shape[1] - 1))


def _refuse_short_orbit(product: Product) -> None:
    """Raise InputError where the state vectors leave out a part of the image."""
    grid, orbit = product.grid, product.required_orbit
    ends = np.sort([float(grid.time_s(line, 0.5 * grid.pixels)) for line in (0, grid.lines - 1)])
    if not orbit.covers(ends, float(np.diff(orbit.time_s).max())):
        raise InputError(
            f"{product.source}: found state vectors of the orbit from {product.date(orbit.time_s[0])} to "
            f"{product.date(orbit.time_s[-1])}; must reach over the image, from {product.date(ends[0])} to "
            f"{product.date(ends[1])} UTC"
        )


def places_on(ground: Elevation) -> tuple[F64, F64]:
    """Longitudes and latitudes [deg] of some posts all over the elevation model, `LOOKS` along a side."""
    return _places(ground, *(np.linspace(0, n - 1, min(LOOKS, n)) for n in ground.shape))


def places_in(crop: Box) -> tuple[F64, F64]:
    """The same all over a box."""
    west, south, east, north = crop
    longitude, latitude = np.meshgrid(np.linspace(west, east, LOOKS), np.linspace(south, north, LOOKS))
    return longitude, latitude


def _pixel(grid: LineGrid, time: F64, slant: F64) -> F64:
    """Pixels; of ground range far beyond the image the polynomials say nothing, so slant ranges are kept near it."""
    if grid.ground is None:
        return grid.pixel(time, slant)
    ends = [float(grid.slant_m(0.5 * grid.lines, at)) for at in (-0.5, grid.pixels - 0.5)]
    span = ends[1] - ends[0]
    kept = np.clip(slant, ends[0] - 0.02 * span, ends[1] + 0.02 * span)
    return grid.pixel(time, kept)


def _meets(found: F64, count: int) -> bool:
    return bool(found.size and found.min() < count - 0.5 and found.max() > -0.5)


def _inside(found: float, count: int) -> int:
    return int(np.clip(round(float(found)), 0, count - 1))


def _places(ground: Elevation, rows: F64, columns: F64) -> tuple[F64, F64]:
    column, row = np.meshgrid(columns + 0.5, rows + 0.5)
    affine = ground.affine
    x, y = affine.a * column + affine.b * row + affine.c, affine.d * column + affine.e * row + affine.f
    longitude, latitude, _ = ground.datum.to_geodetic(x, y, np.zeros_like(x))
    return longitude, latitude


def _reach(ground: Elevation) -> str:
    longitude, latitude = _places(
        ground, np.array([0.0, ground.shape[0] - 1.0]), np.array([0.0, ground.shape[1] - 1.0])
    )
    return (
        f"longitude {longitude.min():.5g} to {longitude.max():.5g}, latitude {latitude.min():.5g} to "
        f"{latitude.max():.5g}"
    )


def blocks_of(product: Product, ground: Elevation, window: ImageWindow) -> Iterator[ImageBlock]:
    """Blocks of the window, by bursts, lines and pixels, with the posts that each may show or be shadowed by."""
    side = _side(product, ground, window)
    for first, grid in bursts_of(product.grid):
        top, bottom = max(window.lines[0], first), min(window.lines[1], first + grid.lines)
        for line in _cuts(top, bottom, side):
            for pixel in _cuts(*window.pixels, side):
                part = ImageWindow(line, pixel)
                posts = _posts(product, ground, part, grid, first)
                if posts is not None:
                    yield ImageBlock(part, grid, first, *posts)


def _side(product: Product, ground: Elevation, window: ImageWindow) -> int:
    line, pixel = (0.5 * (a + b - 1) for a, b in (window.lines, window.pixels))
    mean = 0.5 * (ground.lowest_m + ground.highest_m)
    near = geodetic_to_ecef(product.to_ground([line, line + 1, line], [pixel, pixel, pixel + 1], mean))
    cell = float(np.linalg.norm(np.cross(near[1] - near[0], near[2] - near[0])))
    posts_per_pixel = cell / math.prod(ground.spacing_m)
    # a block lies askew on the model: the box about it is up to two and a half times as large
    return int(np.clip(math.sqrt(MOST_POSTS / (2.5 * posts_per_pixel)), LEAST_SIDE, SIDE))


def _cuts(first: int, last: int, side: int) -> list[tuple[int, int]]:
    if last <= first:
        return []
    count = -(-(last - first) // side)
    edges = np.linspace(first, last, count + 1).round().astype(int).tolist()
    return list(pairwise(edges))


def _posts(
    product: Product, ground: Elevation, window: ImageWindow, grid: LineGrid, first: int
) -> tuple[tuple[int, int], tuple[int, int]] | None:
    """Rows and columns about all that the window shows, and about all that may throw a shadow there."""
    edge = np.linspace(0.0, 1.0, 9)
    line = window.lines[0] - first - 1.0 + edge * (window.shape[0] + 1.0)
    pixel = window.pixels[0] - 1.0 + edge * (window.shape[1] + 1.0)
    line, pixel = (each.ravel() for each in np.meshgrid(line, pixel, indexing="ij"))
    time, slant = grid.time_s(line, pixel), grid.slant_m(line, pixel)
    orbit, found = product.required_orbit, []
    for height in (ground.lowest_m, ground.highest_m):
        found.append(locate(orbit, time, slant, height, product.side))
    # a ray from the lowest ground leaves the highest layer there: from its incidence, with a tenth to spare
    up = orbit.at(time)[0] - geodetic_to_ecef(found[0])
    cosine = (up * geodetic_to_ecef(found[0])).sum(-1)
    cosine /= np.linalg.norm(up, axis=-1) * np.linalg.norm(geodetic_to_ecef(found[0]), axis=-1)
    climb = 1.1 * (ground.highest_m - ground.lowest_m) / np.maximum(cosine, 0.05)
    found.append(locate(orbit, time, slant - climb, ground.highest_m, product.side))
    places = np.concatenate(found)
    row, column = ground.posts_at(places[:, 1], places[:, 0])
    rows, columns = (
        (max(math.floor(at.min()) - MARGIN_POSTS, 0), min(math.ceil(at.max()) + MARGIN_POSTS + 1, count))
        for at, count in zip((row, column), ground.shape, strict=True)
    )
    return None if rows[1] - rows[0] < 2 or columns[1] - columns[0] < 2 else (rows, columns)
