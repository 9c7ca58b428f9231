"""On measured products: ESA's geolocation grid of a Sentinel-1 image, and a real elevation model."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import warpsar
from warpsar.formats import registry
from warpsar.terrain.blocks import ImageWindow
from warpsar.world.earth import LocalEarth, geodetic_to_ecef

pytestmark = pytest.mark.measured

PIXEL_M = 10.0
STEP_DEG = 0.0004


def rome(measured_data: Path) -> tuple[Path, Path]:
    folder = measured_data / "sentinel1_rome"
    return next(folder.glob("S1B*.SAFE")), folder / "Rome-30m-DEM.tif"


def grid_points(safe: Path) -> list[dict[str, float]]:
    """The annotation's own points: another program, ESA's, computed them."""
    path = next((safe / "annotation").glob("*.xml"))
    names = ("line", "pixel", "latitude", "longitude", "height", "incidenceAngle")
    points = ElementTree.parse(path).getroot().iterfind(".//geolocationGridPoint")
    return [{name: float(one.findtext(name) or "nan") for name in names} for one in points]


def angle_deg(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.degrees(np.arccos(one @ other / np.linalg.norm(one) / np.linalg.norm(other))))


def patch(folder: Path, point: dict[str, float]) -> Path:
    """An elevation model of 9 x 9 posts about a point, level at its height above the ellipsoid."""
    import rasterio
    from rasterio.transform import from_origin

    path = folder / "patch.tif"
    left, top = point["longitude"] - 4.5 * STEP_DEG, point["latitude"] + 4.5 * STEP_DEG
    with rasterio.open(
        path, "w", driver="GTiff", width=9, height=9, count=1, dtype="float64", crs="EPSG:4326",
        transform=from_origin(left, top, STEP_DEG, STEP_DEG),
    ) as file:  # fmt: skip
        file.write(np.full((9, 9), point["height"]), 1)
    return path


@pytest.mark.parametrize("every", [15, pytest.param(1, marks=pytest.mark.slow)])
def test_places_are_those_of_the_geolocation_grid(measured_data: Path, tmp_path: Path, every: int) -> None:
    """The pixel that ESA gives for a place shows that place: to 0.1 pixel, and far better. All 210 points are slow."""
    safe, _ = rome(measured_data)
    (product,) = registry.products(safe)
    points = grid_points(safe)
    assert len(points) == 210
    off, angle, stated = [], [], []
    for point in points[::every]:
        found = warpsar.twin(product, patch(tmp_path, point), geoid_offset_m=0.0, device="cpu")
        row, column = int(point["line"]) - found.window.lines[0], int(point["pixel"]) - found.window.pixels[0]
        seen = np.array([found.image[name][row, column] for name in ("latitude", "longitude", "height")])
        there = np.array([point[name] for name in ("latitude", "longitude", "height")])
        off.append(LocalEarth(*there).axes @ (geodetic_to_ecef(seen) - geodetic_to_ecef(there)))
        radar = product.to_image(there).toward_radar @ LocalEarth(*there).axes
        angle.append((found.image["ellipsoid_incidence"][row, column], angle_deg(radar, geodetic_to_ecef(there))))
        stated.append(point["incidenceAngle"])
    farthest = np.linalg.norm(off, axis=1).max() / PIXEL_M
    own, from_centre = np.abs(np.array(angle) - np.array(stated)[:, None]).max(axis=0)
    print(
        f"{len(off)} points: {farthest:.4f} pixels at most; incidence {own:.4f} deg at most, {from_centre:.4f} from the"
    )
    print("direction of the earth's centre")
    assert farthest < 0.1
    # ESA's angle is from the earth's centre, not from the ellipsoid's normal: 0.19 deg apart here, mostly across
    assert from_centre < 0.002
    assert own < 0.05


def noise_db(safe: Path, window: ImageWindow) -> float:
    """From the nearest vectors of the annotation, by hand: noise over the square of betaNought, in the middle."""
    line, pixel = (0.5 * sum(ends) for ends in (window.lines, window.pixels))

    def nearest(kind: str, vectors: str, values: str) -> float:
        root = ElementTree.parse(next((safe / "annotation" / "calibration").glob(f"{kind}-*.xml"))).getroot()
        one = min(root.iterfind(vectors), key=lambda each: abs(float(each.findtext("line") or 0) - line))
        at, found = (np.array((one.findtext(name) or "").split(), float) for name in ("pixel", values))
        return float(found[np.abs(at - pixel).argmin()])

    noise = nearest("noise", ".//noiseRangeVector", "noiseRangeLut")
    beta = nearest("calibration", ".//calibrationVector", "betaNought")
    root = ElementTree.parse(next((safe / "annotation" / "calibration").glob("noise-*.xml"))).getroot()
    factor = 1.0
    for one in root.iterfind(".//noiseAzimuthVector"):
        first, last, left, right = (
            float(one.findtext(name) or 0)
            for name in ("firstAzimuthLine", "lastAzimuthLine", "firstRangeSample", "lastRangeSample")
        )
        if first <= line <= last and left <= pixel <= right:
            at, found = (np.array((one.findtext(name) or "").split(), float) for name in ("line", "noiseAzimuthLut"))
            factor = float(found[np.abs(at - line).argmin()])
    return float(10.0 * np.log10(noise * factor / beta**2))


@pytest.mark.parametrize("height", [0.0, 3000.0])
def test_places_are_those_of_isce3s_grid(measured_data: Path, tmp_path: Path, height: float) -> None:
    """ALOS in NISAR's form: ISCE3's grid over heights says what the first pixel of the first line shows.

    To 0.5 m, or 0.05 pixel of 8.9 m: state vectors are 60 s apart, and both programs interpolate in their own way.
    """
    import h5py

    path = measured_data / "alos_polcal" / "calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
    with h5py.File(path) as file:
        grid = file["science/LSAR/RSLC/metadata/geolocationGrid"]
        (at,) = np.flatnonzero(grid["heightAboveEllipsoid"][()] == height)
        longitude, latitude = (float(grid[name][at, 0, 0]) for name in ("coordinateX", "coordinateY"))
        incidence = float(grid["incidenceAngle"][at, 0, 0])
    model = patch(tmp_path, {"longitude": longitude, "latitude": latitude, "height": height})
    found = warpsar.twin(path, model, geoid_offset_m=0.0, polarization="HH", device="cpu")
    assert (found.window.lines[0], found.window.pixels[0]) == (0, 0)
    shown = np.array([found.image[name][0, 0] for name in ("latitude", "longitude", "height")])
    expected = np.array([latitude, longitude, height])
    assert np.linalg.norm(geodetic_to_ecef(shown) - geodetic_to_ecef(expected)) < 0.5
    # ISCE3 takes the angle to the satellite from the ellipsoid's normal; float32 in the file
    assert found.image["ellipsoid_incidence"][0, 0] == pytest.approx(incidence, abs=0.02)


def test_rome(measured_data: Path) -> None:
    """Hills of 100 m at 44 degrees: no layover, no shadow; lit areas seen from the radar add up to level ground's."""
    safe, dem = rome(measured_data)
    crop = (12.48, 41.98, 12.50, 42.0)
    found = warpsar.twin(safe, dem, geoid_offset_m=48.6, crop=crop, device="cpu")
    image = found.image
    ground = np.isfinite(image["surfaces"])
    assert ground.all()
    assert not found.measured
    assert "annotation alone" in found.pixels
    assert image["shadow"].max() < 0.01
    # Without shadow and layover, what the radar sees of a line between two pixels is as wide as the angle between them
    # at the radar: area_gamma adds up to line's length x range x angle, whatever lies between.
    (product,) = registry.products(safe)
    for row in range(5, ground.shape[0], 40):
        line, pixels = row + found.window.lines[0], np.array(found.window.pixels) - [0, 1]
        ends = [[image[name][row, column] for name in ("latitude", "longitude", "height")] for column in (0, -1)]
        radar = product.required_orbit.at(float(product.grid.time_s(line, pixels[0])))[0]
        sights = geodetic_to_ecef(np.array(ends, float)) - radar
        angle = np.deg2rad(angle_deg(*sights))
        steps = np.diff(product.grid.slant_m(line, np.arange(pixels[0] - 0.5, pixels[1] + 1)))
        length = float(image["area_beta"][row].mean() / steps.mean())
        seen = image["area_gamma"][row].sum() - 0.5 * image["area_gamma"][row, [0, -1]].sum()
        # half a pixel at each end is of the mean of that pixel; 160 pixels
        assert seen == pytest.approx(length * np.linalg.norm(sights, axis=1).mean() * angle, rel=5e-3)
    assert np.nanmedian(10.0 * np.log10(image["noise"])) == pytest.approx(noise_db(safe, found.window), abs=0.5)
    # posts of the DEM come back: height at each pixel's place is the DEM's, bilinear between posts, with the offset
    import rasterio

    with rasterio.open(dem) as file:
        posts, inverse = file.read(1).astype(float), ~file.transform
    rows, columns = np.argwhere(ground)[::997].T
    lon, lat = image["longitude"][rows, columns], image["latitude"][rows, columns]
    x, y = inverse.a * lon + inverse.c - 0.5, inverse.e * lat + inverse.f - 0.5
    corner = np.floor(y).astype(int), np.floor(x).astype(int)
    near = np.stack([posts[corner[0] + i, corner[1] + j] for i in (0, 1) for j in (0, 1)])
    height = image["height"][rows, columns] - 48.6
    assert (height > near.min(axis=0) - 0.01).all()
    assert (height < near.max(axis=0) + 0.01).all()
