"""Places of the layers on orbits, looks and grounds unlike Rome's, against a geocoder written here.

The orbit is a circle in space over a turning earth, in closed form. PROJ makes places earth-centred, and zero Doppler
is the root of the distance's slope, bracketed. Nothing of the project's geometry is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyproj
import pytest
from scipy.optimize import brentq

import warpsar
from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.products.zero_doppler import Side

F64 = np.ndarray
EARTH_TURN = 7.2921159e-5  # [rad/s]
A_M, B_M = 6378137.0, 6356752.314245
"""Half axes of WGS 84."""
LINES, PIXELS = 120, 160
LINE_S, STEP_M = 2.0e-3, 8.0
WITHIN = 0.02
"""Of a line or pixel; a tenth is asked for. Layers keep longitude and latitude as 64-bit, heights as 32-bit numbers."""


@dataclass(frozen=True)
class Pass:
    """A circular orbit over a place: `around_deg`, the argument of latitude in the middle, sets latitude and direction
    of flight (90 to 270: south), `look_deg` from the nadir and `side` set which ground is seen, at `longitude`."""

    around_deg: float
    look_deg: float
    side: Side
    longitude: float
    height_m: float
    inclination_deg: float = 98.18
    radius_m: float = 7.071e6
    period_s: float = 5924.0

    def place(self, time_s: float, node: float = 0.0) -> F64:
        """Earth-fixed [m]."""
        around = np.deg2rad(self.around_deg) + 2.0 * np.pi / self.period_s * time_s
        tilt = np.deg2rad(self.inclination_deg)
        turned = node - EARTH_TURN * time_s
        x, y = np.cos(around), np.sin(around) * np.cos(tilt)
        return self.radius_m * np.array(
            [
                x * np.cos(turned) - y * np.sin(turned),
                x * np.sin(turned) + y * np.cos(turned),
                np.sin(around) * np.sin(tilt),
            ]
        )

    def velocity(self, time_s: float, node: float = 0.0) -> F64:
        """By central differences of fourth order: right to 1e-6 m/s."""
        near, far = (self.place(time_s + d, node) - self.place(time_s - d, node) for d in (0.01, 0.02))
        return (8.0 * near - far) / 0.12

    def aimed(self) -> tuple[F64, float]:
        """Latitude, longitude [deg] and height of what is seen in the middle, and the node that brings it to
        `longitude`: a ray in the plane of zero Doppler meets the ellipsoid, made larger by the height."""
        position, velocity = self.place(0.0), self.velocity(0.0)
        ahead = velocity / np.linalg.norm(velocity)
        down = -position - (-position @ ahead) * ahead
        down /= np.linalg.norm(down)
        right = np.cross(down, ahead)
        angle = np.deg2rad(self.look_deg)
        ray = np.cos(angle) * down + np.sin(angle) * (right if self.side == "right" else -right)
        axes = np.array([A_M, A_M, B_M]) + self.height_m
        p, d = position / axes, ray / axes
        distance = (-p @ d - np.sqrt((p @ d) ** 2 - (d @ d) * (p @ p - 1.0))) / (d @ d)
        longitude, latitude, _ = TO_GEODETIC.transform(*(position + distance * ray))
        return np.array([latitude, self.longitude, self.height_m]), float(np.deg2rad(self.longitude - longitude))


TO_GEODETIC = pyproj.Transformer.from_crs("EPSG:4978", "EPSG:4979", always_xy=True)
TO_EARTH = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)


def approach(one: Pass, node: float, longitude: float, latitude: float, height: float) -> tuple[float, float]:
    """Time [s] at which the distance's slope is zero, and that distance [m]."""
    point = np.array(TO_EARTH.transform(longitude, latitude, height))
    time = brentq(lambda t: float((one.place(t, node) - point) @ one.velocity(t, node)), -60.0, 60.0, xtol=1e-12)
    return time, float(np.linalg.norm(one.place(time, node) - point))


def product_of(one: Pass) -> tuple[Product, F64, float]:
    """The product about the place that is seen, that place, and the node."""
    at, node = one.aimed()
    time, distance = approach(one, node, at[1], at[0], at[2])
    times = np.arange(-70.0, 71.0, 10.0)
    orbit = Orbit.of("made", times, [one.place(t, node) for t in times], [one.velocity(t, node) for t in times])
    grid = LineGrid(LINES, PIXELS, time - 0.5 * LINES * LINE_S, LINE_S, distance - 0.5 * PIXELS * STEP_M, STEP_M)
    made = Product(
        "made", "made", np.datetime64("2024-03-05T12:00:00", "us"), "VV", 5.405e9, one.side, grid, orbit, None,
        "power", "beta0",
    )  # fmt: skip
    return made, at, node


def hill(x_m: F64, y_m: F64) -> F64:
    """Slopes of up to 9 degrees."""
    return 60.0 * np.sin(x_m / 400.0) + 0.05 * y_m


def dem_about(folder: Path, at: F64, crs: str, step_m: float = 30.0) -> tuple[Path, Callable[[F64, F64], F64]]:
    """Posts about a place in a coordinate system, and the heights of the same ground at longitudes and latitudes."""
    import rasterio
    from rasterio.transform import from_origin

    size = 141
    to_map = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    if crs == "EPSG:4326":
        middle = at[1], at[0]
        steps = step_m / 111_320.0 / np.cos(np.deg2rad(at[0])), step_m / 111_320.0
    else:
        middle, steps = to_map.transform(at[1], at[0]), (step_m, step_m)
    left, top = middle[0] - 0.5 * size * steps[0], middle[1] + 0.5 * size * steps[1]
    column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    heights = at[2] + hill((column - 0.5 * size) * step_m, (0.5 * size - row) * step_m)
    path = folder / "dem.tif"
    with rasterio.open(
        path, "w", driver="GTiff", width=size, height=size, count=1, dtype="float64", crs=crs,
        transform=from_origin(left, top, *steps),
    ) as file:  # fmt: skip
        file.write(heights, 1)

    def height(longitude: F64, latitude: F64) -> F64:
        x, y = (longitude, latitude) if crs == "EPSG:4326" else to_map.transform(longitude, latitude)
        x = middle[0] + (np.mod(x - middle[0] + 180.0, 360.0) - 180.0) if crs == "EPSG:4326" else x
        return np.asarray(at[2] + hill((x - middle[0]) / steps[0] * step_m, (y - middle[1]) / steps[1] * step_m))

    return path, height


CASES = {
    "descending, right, south": (Pass(145.0 + 60.0, 33.0, "right", 20.0, 100.0), "EPSG:4326"),
    "ascending, right, north": (Pass(44.0, 36.0, "right", 12.0, 300.0), "EPSG:4326"),
    "ascending, left, south": (Pass(-35.0, 30.0, "left", -70.0, 50.0), "EPSG:4326"),
    "descending, left, plateau of 4,000 m": (Pass(148.0, 34.0, "left", 90.0, 4000.0), "EPSG:32646"),
    "a steep look": (Pass(10.0, 18.0, "right", 30.0, 200.0), "EPSG:4326"),
    "a grazing look": (Pass(150.0, 47.0, "right", 30.0, 200.0), "EPSG:4326"),
    "across the date line, east of 180": (Pass(130.0, 33.0, "right", 180.0, 80.0), "EPSG:4326"),
    "across the date line, west of -180": (Pass(130.0, 33.0, "right", -180.0, 80.0), "EPSG:4326"),
    "across the date line, UTM": (Pass(20.0, 33.0, "left", 180.0, 80.0), "EPSG:32660"),
    "near the pole": (Pass(90.0, 40.0, "left", 140.0, 0.0), "EPSG:3413"),
    "over the pole": (Pass(90.0, 32.0, "left", 140.0, 10.0, inclination_deg=87.0), "EPSG:3413"),
    "near the south pole": (Pass(-88.0, 40.0, "right", -60.0, 2800.0), "EPSG:3031"),
}


@pytest.mark.parametrize("name", CASES)
def test_places_are_those_of_another_geocoder(tmp_path: Path, name: str) -> None:
    one, crs = CASES[name]
    product, at, node = product_of(one)
    path, height = dem_about(tmp_path, at, crs)
    found = warpsar.twin(product, path, geoid_offset_m=0.0, device="cpu")
    image = found.image
    known = np.argwhere(np.isfinite(image["longitude"]) & (image["surfaces"] > 0.99))
    assert len(known) > 0.97 * LINES * PIXELS  # the ground reaches beyond the product
    chosen = known[np.random.default_rng(0).choice(len(known), 40, replace=False)]
    for row, column in chosen:
        longitude, latitude, above = (float(image[each][row, column]) for each in ("longitude", "latitude", "height"))
        time, distance = approach(one, node, longitude, latitude, above)
        line = (time - product.grid.first_line_s) / LINE_S - found.window.lines[0]
        pixel = (distance - product.grid.near_range_m) / STEP_M - found.window.pixels[0]
        assert (line, pixel) == (pytest.approx(row, abs=WITHIN), pytest.approx(column, abs=WITHIN))
    rows, columns = chosen.T
    places = [image[each][rows, columns] for each in ("longitude", "latitude")]
    # a facet's chord lies below a crest of radius 2.7 km by 15^2 / 2 / 2700 m at most, in both directions
    np.testing.assert_allclose(image["height"][rows, columns], height(*places), atol=0.1)
    seen_from_above(found, one, node, product, chosen)


def seen_from_above(found: object, one: Pass, node: float, product: Product, chosen: F64) -> None:
    """Incidence on the ellipsoid: between the ellipsoid's normal, PROJ's own, and the line to the satellite."""
    image = found.image  # type: ignore[attr-defined]
    for row, column in chosen[:5]:
        longitude, latitude, above = (float(image[each][row, column]) for each in ("longitude", "latitude", "height"))
        time, distance = approach(one, node, longitude, latitude, above)
        foot, top = (np.array(TO_EARTH.transform(longitude, latitude, above + up)) for up in (0.0, 1000.0))
        cosine = (one.place(time, node) - foot) @ (top - foot) / 1000.0 / distance
        assert image["ellipsoid_incidence"][row, column] == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.005)
