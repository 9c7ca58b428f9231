"""Places and areas beside sarsen's (B-Open, Apache 2.0): another program's zero Doppler and another's facets.

sarsen fits one polynomial of degree 5 to state vectors, gives each post an area about it, and spreads that over the
nearest four pixels (bilinear, after Small 2011). It knows no layover order and no shadow; the hills here have neither.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from product_files import Band, write_safe
from terrain_files import dem

import warpsar
from warpsar.formats import registry
from warpsar.products.product import Product
from warpsar.products.zero_doppler import abeam
from warpsar.world.earth import geodetic_to_ecef
from warpsar.world.frame import SPEED_OF_LIGHT

pytest.importorskip("sarsen", reason="sarsen is not installed: pip install sarsen")

SHAPE = (96, 256)
DAY = np.datetime64("2024-01-01T00:00:00", "ns")


def acquired(product: Product, path: Path, vectors: int = 6) -> Any:
    """Lines, pixels and areas [m2] of posts by sarsen, and the posts: latitude, longitude [deg], height [m]."""
    import xarray
    from sarsen import apps, orbit, scene

    state = product.required_orbit
    first = int(
        np.clip(np.searchsorted(state.time_s, product.grid.middle_s) - vectors // 2, 0, state.time_s.size - vectors)
    )
    chosen = slice(first, first + vectors)
    epoch = float(state.time_s[first])
    times = DAY + np.round((state.time_s[chosen] - epoch) * 1e9).astype("timedelta64[ns]")
    position = xarray.DataArray(
        state.position_m[chosen], dims=("azimuth_time", "axis"), coords={"azimuth_time": times, "axis": [0, 1, 2]}
    )
    track = orbit.OrbitPolyfitInterpolator.from_position(position)
    raster = scene.open_dem_raster(str(path), chunks=None)
    posts = scene.convert_to_dem_ecef(raster, source_crs="EPSG:4979")
    found = apps.simulate_acquisition(
        posts, track, {"azimuth_time", "slant_range_time", "gamma_area"}, zero_doppler_distance=1e-3
    )
    time = (found["azimuth_time"].values - DAY).astype("timedelta64[ns]").astype(np.float64) * 1e-9 + epoch
    latitude, longitude = np.meshgrid(raster.y.values, raster.x.values, indexing="ij")
    geodetic = np.stack([latitude, longitude, raster.transpose("y", "x").values], axis=-1)
    slant = 0.5 * SPEED_OF_LIGHT * found["slant_range_time"].values
    return product.grid.line(time, slant), product.grid.pixel(time, slant), found["gamma_area"].values, geodetic


def summed(line: np.ndarray, pixel: np.ndarray, area: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Areas spread over the nearest four pixels."""
    total = np.zeros(shape)
    top, left = np.floor(line).astype(int), np.floor(pixel).astype(int)
    for down in (0, 1):
        for along in (0, 1):
            weight = np.abs(1 - down - (line - top)) * np.abs(1 - along - (pixel - left))
            row, column = top + down, left + along
            inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
            np.add.at(total, (row[inside], column[inside]), (weight * area)[inside])
    return total


def blocks(values: np.ndarray, lines: int, pixels: int) -> np.ndarray:
    rows, columns = values.shape[0] // lines, values.shape[1] // pixels
    return values[: rows * lines, : columns * pixels].reshape(rows, lines, columns, pixels).sum(axis=(1, 3))


def test_places_and_areas_of_hills(tmp_path: Path) -> None:
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(np.random.default_rng(5).standard_normal((161, 161)), 4.0)
    path = dem(tmp_path, 300.0 + 30.0 * rough / rough.std())
    band = Band(lines=SHAPE[0], pixels=SHAPE[1], centre=(47.5, 127.5))
    safe = write_safe(tmp_path, np.zeros(SHAPE, np.complex64), band)
    found = warpsar.twin(safe, path, geoid_offset_m=0.0, device="cpu")
    line, pixel, area, geodetic = acquired(found.product, path)
    # places: what sarsen's post lies on shows that post's longitude and latitude
    top, left = found.window.lines[0], found.window.pixels[0]
    inside = (line > top + 4) & (line < top + SHAPE[0] - 5) & (pixel > left + 8) & (pixel < left + SHAPE[1] - 9)
    assert inside.sum() > 2000
    time, slant = abeam(found.product.required_orbit, geodetic_to_ecef(geodetic[inside]), found.product.grid.middle_s)
    off = [found.product.grid.line(time, slant) - line[inside], found.product.grid.pixel(time, slant) - pixel[inside]]
    assert np.abs(off).max() < 1e-3
    # areas: sarsen's posts are points, 20 m apart, so sums over 220 m x 190 m are compared
    image = np.nan_to_num(found.image["area_gamma"][8:-8, 16:-16])
    theirs = summed(line - top, pixel - left, area, found.window.shape)[8:-8, 16:-16]
    ratio = blocks(image, 16, 56) / blocks(theirs, 16, 56)
    # a sum is of 110 posts: a row of ten on its border, half in and half out, makes 4 %
    assert np.abs(ratio - 1.0).max() < 0.04
    assert image.sum() == pytest.approx(theirs.sum(), rel=0.005)


@pytest.mark.measured
def test_places_over_rome(measured_data: Path, tmp_path: Path) -> None:
    """Sentinel-1's own state vectors, every 20th post of a real elevation model."""
    import rasterio

    folder = measured_data / "sentinel1_rome"
    (product,) = registry.products(next(folder.glob("S1B*.SAFE")))
    path = tmp_path / "coarse.tif"
    with rasterio.open(folder / "Rome-30m-DEM.tif") as file:
        shape = file.height // 20, file.width // 20
        coarse = file.read(1, out_shape=shape)
        affine = file.transform * file.transform.scale(file.width / shape[1], file.height / shape[0])
        with rasterio.open(
            path, "w", driver="GTiff", width=shape[1], height=shape[0], count=1, dtype="float32", crs=file.crs,
            transform=affine,
        ) as made:  # fmt: skip
            made.write(coarse.astype(np.float32), 1)
    line, pixel, _, geodetic = acquired(product, path)
    time, slant = abeam(product.required_orbit, geodetic_to_ecef(geodetic), product.grid.middle_s)
    near = (np.abs(line) < 2 * product.grid.lines) & (pixel > 0) & (pixel < product.grid.pixels)
    assert near.sum() > 100
    off = [
        (mine - theirs)[near]
        for mine, theirs in ((product.grid.line(time, slant), line), (product.grid.pixel(time, slant), pixel))
    ]
    assert np.abs(off).max() < 1e-3
