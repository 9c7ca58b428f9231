"""All layers of a product: blocks one after the other, or side by side, into arrays of the whole window."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock, Semaphore
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.errors import NothingShownError
from warpsar.io.bands import bands_of, in_file, release
from warpsar.io.geotiff import AffinePlace
from warpsar.products.product import ImagedPoint, Product, to_beta0
from warpsar.runtime import console
from warpsar.runtime.devices import load_kernels
from warpsar.runtime.threads import in_threads
from warpsar.terrain.blocks import Box, ImageBlock, ImageWindow, blocks_of, window_of
from warpsar.terrain.elevation import Elevation
from warpsar.terrain.ground import edges_of, ground_of
from warpsar.terrain.memory import TwinForecast, forecast, refuse_small_disk
from warpsar.terrain.projection import BlockPixels, BlockProjection
from warpsar.terrain.scenery import Scenery
from warpsar.world.earth import same_turn

F64 = NDArray[np.float64]
LEAST_COVER = 0.99
"""Of a pixel: with less ground under it, it lies at the edge of the elevation model, and has no value."""
LEAST_SURFACE = 0.01
"""Lit surfaces of a pixel: with less, its areas say nothing of sigma0 and gamma0."""
FINEST = 8
"""Parts of a post's cell along one side, on the map."""


@dataclass(frozen=True)
class SimulatedProduct:
    """Layers of a product, by the names in `layers.py`; NaN where there is no ground, or nothing is seen."""

    product: Product
    elevation: Elevation
    window: ImageWindow
    """The part of the product that the layers of `image` are."""
    image: dict[str, np.ndarray]
    """(lines, pixels) each."""
    map: dict[str, np.ndarray]
    """(rows, columns) each."""
    map_place: AffinePlace
    scenery: Scenery
    pixels: str
    """What the product's own pixels are; why there are none."""
    forecast: TwinForecast

    @property
    def measured(self) -> bool:
        """Whether the product has pixels to look at."""
        return "measured" in self.image


def simulated(
    product: Product,
    elevation: Elevation,
    scenery: Scenery,
    crop: Box | None,
    device: wp.Device,
    scratch: Path | None = None,
) -> SimulatedProduct:
    """The layers of the part of `product` that `elevation` covers, or of `crop` of it.

    Layers that memory should not hold are arrays in files without a name in `scratch`, by default in the folder for
    temporary ones. Raises NothingShownError where the product does not show the elevation model, and InputError where
    a disk is too small.
    """
    window = window_of(product, elevation, crop)
    blocks = list(blocks_of(product, elevation, window))
    if not blocks:
        raise NothingShownError(f"{product.source}: it shows no place of {elevation.path}; must overlap")
    load_kernels(device, "terrain")
    fine = _fineness(product, elevation, window)
    rows = min(b.rows[0] for b in blocks), max(b.rows[1] for b in blocks)
    columns = min(b.columns[0] for b in blocks), max(b.columns[1] for b in blocks)
    pixels, words = _pixels(product, window)
    canvas = _Canvas(
        product, elevation, window, blocks, rows, columns, fine, device, noise=_has_noise(product),
        measured=pixels, surfaces=len(scenery.surfaces), scratch=scratch,
    )  # fmt: skip
    bar = console.progress(len(blocks), "twin", "block")
    turns = Semaphore(canvas.forecast.at_once)

    def fill(block: ImageBlock) -> None:
        with turns:
            canvas.fill(block, scenery, device)

    tasks = [partial(fill, block) for block in blocks]
    for _ in in_threads(tasks):  # on a GPU, too: most of a block's time is the host's
        bar.update()
    bar.close()
    if not canvas.any_ground:
        raise NothingShownError(
            f"{product.source}: it shows no ground of {elevation.path}; must overlap where that has data"
        )
    canvas.crop_map()
    place = _part(elevation.affine, columns[0] + canvas.map_left / fine, rows[0] + canvas.map_top / fine, fine)
    return SimulatedProduct(
        product,
        elevation,
        window,
        canvas.image,
        canvas.map,
        AffinePlace(elevation.crs, place),
        scenery,
        words,
        canvas.forecast,
    )


def _part(affine: Any, column: float, row: float, fine: int) -> Any:
    """The affine of a raster that begins at a column and row, with cells `fine` times as small."""
    a, b, c, d, e, f = tuple(affine)[:6]
    left, top = c + a * column + b * row, f + d * column + e * row
    return type(affine)(a / fine, b / fine, left, d / fine, e / fine, top)


def _has_noise(product: Product) -> bool:
    return product.noise is not None and product.gain is not None and product.radiometry is not None


def _pixels(product: Product, window: ImageWindow) -> tuple[bool, str]:
    """Whether the product has pixels that are worth a look, and words about them."""
    if product.samples is None:
        return False, "the product has annotation alone, no pixels: layers only, no comparison"
    if product.radiometry is None:
        return False, "the product does not say what its power is: layers only, no comparison; state --radiometry"
    step = max(window.shape[0] // 64, 1)
    for top in range(*window.lines, step):
        if np.any(product.samples[slice(top, min(top + step, window.lines[1])), slice(*window.pixels)]):
            return True, "the product's pixels are compared"
    return False, "all pixels of the product are zero there: layers only, no comparison"


def _fineness(product: Product, elevation: Elevation, window: ImageWindow) -> int:
    """Parts of a post's cell along one side: about as fine as the product's pixels are on the ground."""
    line, pixel = (0.5 * (a + b - 1) for a, b in (window.lines, window.pixels))
    mean = 0.5 * (elevation.lowest_m + elevation.highest_m)
    from_here = np.deg2rad(product.to_ground([line, line + 1, line], [pixel, pixel, pixel + 1], mean)[:, :2])
    east = (from_here[:, 1] - from_here[0, 1]) * np.cos(from_here[0, 0])
    steps = 6.371e6 * np.hypot(from_here[1:, 0] - from_here[0, 0], east[1:])
    return int(np.clip(round(float(np.mean(elevation.spacing_m) / steps.max())), 1, FINEST))


class _Canvas:
    """Arrays of the whole window. Each block fills its own part."""

    def __init__(
        self,
        product: Product,
        elevation: Elevation,
        window: ImageWindow,
        blocks: Sequence[ImageBlock],
        rows: tuple[int, int],
        columns: tuple[int, int],
        fine: int,
        device: wp.Device,
        *,
        noise: bool,
        measured: bool,
        surfaces: int,
        scratch: Path | None,
    ) -> None:
        self.product, self.elevation, self.window = product, elevation, window
        self.rows, self.columns, self.fine = rows, columns, fine
        self.map_top = self.map_left = 0
        self._turn: AbstractContextManager[Any] = nullcontext() if device.is_cpu else Lock()  # one block on a GPU
        single = ["beta0", "sigma0", "gamma0", "incidence", "ellipsoid_incidence", "layover", "shadow", "surfaces"]
        single += ["area_beta", "area_sigma", "area_gamma", "height"]
        single += ["noise"] * noise + ["measured"] * measured + ["cover"] * (surfaces > 1)
        mapped = ["beta0", "sigma0", "gamma0", "incidence", "layover", "shadow", "surfaces"]
        mapped += ["measured", "measured_gamma0"] * measured
        shape = (rows[1] - rows[0]) * fine, (columns[1] - columns[0]) * fine
        # two layers of each are in double precision
        sizes = [4 * (len(names) + 4) * math.prod(size) for names, size in ((single, window.shape), (mapped, shape))]
        self.forecast = forecast(blocks, sizes[0], sizes[1], math.prod(window.shape) * measured, surfaces)
        console.say(f"twin: {self.forecast}")
        refuse_small_disk(self.forecast, scratch)
        room = partial(_room, large=self.forecast.in_files, scratch=scratch)
        self.image = _rooms(window.shape, single, ("longitude", "latitude"), room)
        self.map = _rooms(shape, mapped, ("line", "pixel"), room)
        self._filled = np.zeros(shape[0], bool), np.zeros(shape[1], bool)
        self.any_ground = False

    def fill(self, block: ImageBlock, scenery: Scenery, device: wp.Device) -> None:
        ground = ground_of(self.product, self.elevation, block, scenery)
        if ground is None:
            return
        edges = edges_of(block.grid, _lines(block), block.window.pixels)
        spacing = min(self.elevation.spacing_m)
        with self._turn:
            projection = BlockProjection(ground, edges, scenery.sigma0, spacing, device)
            pixels, cells = projection.pixels(), projection.cells(self.fine)
            del projection
        found = self._fill_image(block, pixels, edges)
        inside = cells.pixel >= 0
        at, lit = cells.pixel[inside], cells.lit[inside] > 0
        over = (cells.folded[inside] > 0) | (found["layover"].ravel()[at] >= 0.5)
        made = {
            "incidence": cells.incidence[inside],
            "shadow": np.where(lit, 0.0, 1.0),
            "layover": np.where(lit & over, 1.0, 0.0),
            "line": cells.line_at[inside] + block.window.lines[0],
            "pixel": cells.pixel_at[inside] + block.window.pixels[0],
        }
        for name in self.map.keys() & found.keys() - made.keys():
            made[name] = found[name].ravel()[at]
            made[name][~lit] = np.nan  # such a pixel shows other ground
        rows, columns = (
            slice((of[0] - whole[0]) * self.fine, (of[1] - whole[0]) * self.fine)
            for of, whole in ((block.rows, self.rows), (block.columns, self.columns))
        )
        for name, values in made.items():
            self.map[name][rows, columns][inside] = values
            release(self.map[name])
        for filled, part, axis in zip(self._filled, (rows, columns), (1, 0), strict=True):
            filled[part][inside.any(axis=axis)] = True

    def _fill_image(self, block: ImageBlock, found: BlockPixels, edges: F64) -> dict[str, np.ndarray]:
        """The block's part of each layer."""
        line = np.arange(*block.window.lines)[:, None]
        pixel = np.arange(*block.window.pixels)[None, :]
        ground = found.covered > LEAST_COVER
        beta_area = np.abs(np.diff(edges, axis=1)) * self._azimuth_m(block)
        beta0 = found.power / beta_area
        seen = found.surfaces > LEAST_SURFACE
        with np.errstate(all="ignore"):
            made = {
                "beta0": beta0,
                "sigma0": np.where(seen, found.power / found.area, np.nan),
                "gamma0": np.where(seen, found.power / found.across, np.nan),
                "incidence": found.incidence,
                "ellipsoid_incidence": found.ellipsoid_incidence,
                "layover": np.minimum(found.folded, 1.0),
                "shadow": np.clip(1.0 - found.surfaces, 0.0, 1.0),
                "surfaces": found.surfaces,
                "area_beta": beta_area,
                "area_sigma": found.area,
                "area_gamma": found.across,
                "longitude": same_turn(found.longitude, self.elevation.longitude_deg),
                "latitude": found.latitude,
                "height": found.height,
                "cover": found.cover,
            }
            if "noise" in self.image or "measured" in self.image:
                made |= self._radiometry(block, line, pixel, found, beta_area)
        if not ground.all():
            made = {name: np.where(ground, values, np.nan) for name, values in made.items()}
        top, left = block.window.lines[0] - self.window.lines[0], block.window.pixels[0] - self.window.pixels[0]
        for name, values in made.items():
            if name in self.image:
                part = self.image[name][top : top + values.shape[0], left : left + values.shape[1]]
                part[...] = values
                release(part)
        self.any_ground |= bool(np.isfinite(made["area_sigma"]).any())
        return made

    def _radiometry(
        self, block: ImageBlock, line: np.ndarray, pixel: np.ndarray, found: BlockPixels, beta_area: np.ndarray
    ) -> dict[str, np.ndarray]:
        """The product's noise and pixels as beta0."""
        product = self.product
        gain = 1.0 if product.gain is None else product.gain(line, pixel)
        gain = gain * to_beta0(product.radiometry, found.ellipsoid_incidence)
        made: dict[str, np.ndarray] = {}
        noise: np.ndarray | float = 0.0
        if "noise" in self.image and product.noise is not None:
            made["noise"] = noise = product.noise(line, pixel) * gain
        if "measured" in self.image and product.samples is not None:
            value = product.samples[slice(*block.window.lines), slice(*block.window.pixels)]
            power = value if product.quantity == "power" else np.abs(value.astype(np.complex64)) ** 2
            measured = np.where(power > 0.0, power * gain, np.nan)  # 0 stands for no data
            made["measured"] = measured
            lit = found.surfaces > LEAST_SURFACE
            made["measured_gamma0"] = np.where(lit, (measured - noise) * beta_area / found.across, np.nan)
        return made

    def _azimuth_m(self, block: ImageBlock) -> np.ndarray:
        """A line's length on the ground for each pixel, (1, pixels) [m]: linear between three of them."""
        middle = 0.5 * (_lines(block)[0] + _lines(block)[1] - 1)
        at = np.linspace(block.window.pixels[0], block.window.pixels[1] - 1, 3)
        times, slants = block.grid.time_s(middle, at), block.grid.slant_m(middle, at)
        points = [
            ImagedPoint(float(t), float(r), middle, p, np.zeros(3)) for t, r, p in zip(times, slants, at, strict=True)
        ]
        speed = [self.product.speed_m_s(each) for each in points]
        length = np.interp(np.arange(*block.window.pixels), at, speed) * abs(block.grid.line_s)
        return np.asarray(length)[None, :]

    def crop_map(self) -> None:
        """Leave out rows and columns of the map that no block has filled."""
        rows, columns = map(np.flatnonzero, self._filled)
        if not rows.size:
            return
        self.map_top, self.map_left = int(rows[0]), int(columns[0])
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        self.map = {name: values[part] for name, values in self.map.items()}


def _lines(block: ImageBlock) -> tuple[int, int]:
    return block.window.lines[0] - block.grid_line, block.window.lines[1] - block.grid_line


def _rooms(
    shape: Sequence[int],
    single: Sequence[str],
    double: Sequence[str],
    room: Callable[[Sequence[int], type], np.ndarray],
) -> dict[str, np.ndarray]:
    """Layers by name, in single and in double precision."""
    kinds = dict.fromkeys(single, np.float32) | dict.fromkeys(double, np.float64)
    made = in_threads([partial(room, shape, kind) for kind in kinds.values()])
    return dict(zip(kinds, made, strict=True))


def _room(shape: Sequence[int], kind: type, *, large: bool, scratch: Path | None) -> np.ndarray:
    """NaN everywhere; in a file where `large`."""
    if not large:
        return np.full(shape, np.nan, kind)
    made = in_file(shape, kind, scratch)
    for rows in bands_of(shape):
        made[rows] = np.nan
        release(made)
    return made
