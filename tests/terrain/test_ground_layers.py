"""Layers against closed forms: level ground, a slope, a cone with layover and shadow; and ellipsoidal heights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from product_files import SITE, Band, ground_speed, nearest, place, velocity
from terrain_files import STEP_M, dem, flat, product

import warpsar
from warpsar.errors import InputError
from warpsar.terrain.result import SimulatedProduct
from warpsar.world.earth import LocalEarth, ecef_to_geodetic, geodetic_to_ecef

F64 = np.ndarray


def simulate(folder: Path, heights: F64, **more: object) -> SimulatedProduct:
    safe = product(folder)
    return warpsar.twin(safe, dem(folder, heights), geoid_offset_m=0.0, device="cpu", **more)  # type: ignore[arg-type]


def look_and_flight() -> tuple[F64, F64]:
    """At the site, east, north, up: unit vectors to the radar and along the flight, from the orbit in closed form."""
    time, _ = nearest(SITE)
    here = LocalEarth(*SITE)
    centre = geodetic_to_ecef(np.array(SITE))
    look = here.axes @ (place(time) - centre)
    flight = here.axes @ velocity(time)
    return look / np.linalg.norm(look), flight / np.linalg.norm(flight)


def offsets_m(size: int) -> tuple[F64, F64]:
    """East and north of the posts from the site."""
    at = (np.arange(size) - (size - 1) / 2) * STEP_M
    return np.meshgrid(at, -at)


@pytest.fixture(scope="module")
def level(tmp_path_factory: pytest.TempPathFactory) -> SimulatedProduct:
    return simulate(tmp_path_factory.mktemp("level"), flat())


def test_level_ground_lies_where_the_orbit_puts_it(level: SimulatedProduct) -> None:
    """The site is line 31.5, pixel 127.5 by a minimum of distances: the place there is the site, to 0.01 pixel."""
    row, column = 31 - level.window.lines[0], 127 - level.window.pixels[0]
    around = [
        level.image[name][row : row + 2, column : column + 2].mean() for name in ("latitude", "longitude", "height")
    ]
    off = LocalEarth(*SITE).axes @ (geodetic_to_ecef(np.array(around)) - geodetic_to_ecef(np.array(SITE)))
    assert np.linalg.norm(off) < 0.025  # [m]


def test_level_ground_has_the_ellipsoids_incidence(level: SimulatedProduct) -> None:
    look, _ = look_and_flight()
    expected = np.degrees(np.arccos(look[2]))
    row, column = 31 - level.window.lines[0], 127 - level.window.pixels[0]
    assert level.image["incidence"][row, column] == pytest.approx(expected, abs=0.01)
    inside = np.isfinite(level.image["surfaces"])
    assert inside.sum() > 4000
    np.testing.assert_allclose(level.image["surfaces"][inside], 1.0, atol=1e-4)
    assert not level.image["layover"][inside].any()
    assert level.image["shadow"][inside].max() < 1e-4
    # posts are 20 m apart and heights float32: facets tilt by 1e-6
    off = level.image["incidence"] - level.image["ellipsoid_incidence"]
    assert np.nanmax(np.abs(off)) < 0.01


def test_lit_area_of_level_ground(level: SimulatedProduct) -> None:
    """A pixel of dr by da in the slant plane is da dr / sin(incidence) on level ground (Small 2011, eq. 2)."""
    angle = np.deg2rad(level.image["ellipsoid_incidence"])
    expected = level.image["area_beta"] / np.sin(angle)
    # float32 edges of pixels [m]: 1e-4 of 2.5 m; the ground's curvature: 1e-4
    np.testing.assert_allclose(
        level.image["area_sigma"] / expected, np.where(np.isnan(expected), np.nan, 1.0), rtol=1e-3
    )
    np.testing.assert_allclose(level.image["gamma0"], level.image["sigma0"] / np.cos(angle), rtol=1e-4)
    np.testing.assert_allclose(level.image["sigma0"], level.image["beta0"] * np.sin(angle), rtol=1e-3)


@pytest.mark.parametrize(("east", "north"), [(0.2, 0.1), (-0.3, 0.0)])
def test_lit_area_of_a_slope(tmp_path: Path, east: float, north: float) -> None:
    """With normal n, look L and flight v, a pixel's ground is dr da / |n . (L x v)|, and n . L is the incidence."""
    x, y = offsets_m(61)
    found = simulate(tmp_path, SITE[2] + east * x + north * y)
    look, flight = look_and_flight()
    normal = np.array([-east, -north, 1.0]) / np.sqrt(1.0 + east**2 + north**2)
    row, column = 31 - found.window.lines[0], 127 - found.window.pixels[0]
    ratio = found.image["area_sigma"] / found.image["area_beta"]
    # 1 degree of longitude is not cos(latitude) x 1 degree of latitude on the ellipsoid: slopes are off by 0.3 %
    assert ratio[row, column] == pytest.approx(1.0 / abs(normal @ np.cross(look, flight)), rel=5e-3)
    assert found.image["incidence"][row, column] == pytest.approx(np.degrees(np.arccos(normal @ look)), abs=0.15)
    assert found.image["area_gamma"][row, column] / found.image["area_sigma"][row, column] == pytest.approx(
        normal @ look, rel=5e-3
    )


HEIGHT_M, SLOPE = 300.0, 3.0


@pytest.fixture(scope="module")
def cone(tmp_path_factory: pytest.TempPathFactory) -> SimulatedProduct:
    """A cone of 300 m, steeper (71.6 degrees) than the incidence of some 51, and than its complement."""
    x, y = offsets_m(101)
    heights = SITE[2] + np.maximum(HEIGHT_M - SLOPE * np.hypot(x, y), 0.0)
    return simulate(tmp_path_factory.mktemp("cone"), heights)


def on_ground(found: SimulatedProduct) -> tuple[F64, F64]:
    """Of the map's cells: metres away from the radar, counted from the top, and metres across."""
    look, _ = look_and_flight()
    away = -look[:2] / np.linalg.norm(look[:2])
    rows, columns = found.map["shadow"].shape
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    affine = found.map_place.affine
    lon, lat = affine.c + affine.a * column, affine.f + affine.e * row
    north = (lat - SITE[0]) * 111_150.0
    east = (lon - SITE[1]) * 111_150.0 * np.cos(np.deg2rad(SITE[0]))
    return east * away[0] + north * away[1], east * away[1] - north * away[0]


def test_shadow_of_a_cone(cone: SimulatedProduct) -> None:
    """The top at height H throws its shadow to L = H tan(incidence) behind it; from there two lines touch the foot's
    circle, of radius r: sin(half their angle) = r / L. Every cell of level ground is in shadow where they say so, but
    for those as near to a line as posts are coarse."""
    look, _ = look_and_flight()
    length, radius = HEIGHT_M * np.hypot(look[0], look[1]) / look[2], HEIGHT_M / SLOPE
    angle = np.arcsin(radius / length)
    along, across = on_ground(cone)
    shadow = cone.map["shadow"]
    from_line = (length - along) * np.sin(angle) - np.abs(across) * np.cos(angle)  # [m], positive inside
    outside = np.hypot(along, across) > radius + STEP_M
    behind = along > radius * np.sin(angle)
    known = np.isfinite(shadow) & outside
    assert shadow[known & behind & (from_line > 0.75 * STEP_M)].min() == 1.0
    assert shadow[known & (~behind | (from_line < -0.75 * STEP_M))].max() == 0.0
    assert (shadow[known & behind & (from_line > 0.75 * STEP_M)] == 1.0).sum() > 25


def test_layover_of_a_cone(cone: SimulatedProduct) -> None:
    """The top is as far from the radar as level ground H cot(incidence) before it: all from there to the top is laid
    over. There the pixel shows three surfaces: level ground, the side that is laid over, and, but for the shadow, one
    behind; here that one is dark, so two."""
    look, _ = look_and_flight()
    before = HEIGHT_M * look[2] / np.hypot(look[0], look[1])
    along, across = on_ground(cone)
    near = (np.abs(across) < 0.6 * STEP_M) & np.isfinite(cone.map["layover"])
    at, layover = along[near], cone.map["layover"][near]
    assert before > HEIGHT_M / SLOPE  # the foot lies nearer to the top than the ground that is as far as the top
    inside = (at > -before + 1.5 * STEP_M) & (at < -1.5 * STEP_M)
    assert layover[inside].min() == 1.0
    assert np.nanmax(layover[at < -before - 1.5 * STEP_M]) == 0.0
    row = 31 - cone.window.lines[0]
    # the fold spans from the top's range to the foot's: H cos - r sin, in slant range
    surfaces = cone.image["surfaces"][row : row + 2].mean(axis=0)
    fold = HEIGHT_M * look[2] - (HEIGHT_M / SLOPE) * np.hypot(look[0], look[1])
    assert np.count_nonzero(surfaces > 1.5) * 2.5 == pytest.approx(fold, abs=0.15 * fold)
    assert np.nanmax(surfaces) == pytest.approx(2.0, abs=0.1)


def test_shadow_in_the_image(cone: SimulatedProduct) -> None:
    """In slant range nothing lit lies between the foot before the top, at -r sin, and the shadow's end, at L sin.

    Two lines about the top have the mean width of one on each side. Half of them is dark where the shadow is half of
    that wide: so much before its end.
    """
    look, _ = look_and_flight()
    sine, radius = np.hypot(look[0], look[1]), HEIGHT_M / SLOPE
    length = HEIGHT_M * sine / look[2]
    row = 31 - cone.window.lines[0]
    shadow = cone.image["shadow"][row : row + 2].mean(axis=0)
    half_line = 0.5 * ground_speed() * 2.0e-3
    missing = half_line / np.tan(np.arcsin(radius / length))
    expected = (length - missing + radius) * sine
    assert np.count_nonzero(shadow > 0.5) * 2.5 == pytest.approx(expected, abs=10.0)  # four pixels; posts are 20 m


def test_what_is_lit_keeps_its_area(cone: SimulatedProduct) -> None:
    """Ground that the radar sees has one projection onto the plane across the look, whatever lies on it: the sum of
    area_gamma is that of level ground, where cone and shadow lie inside."""
    look, _ = look_and_flight()
    image = cone.image
    row = slice(4, -4)
    ground = np.isfinite(image["surfaces"][row])
    whole = ground.all(axis=1)
    seen = image["area_gamma"][row][whole].sum(axis=1)
    # each line's ground begins and ends at the same slant ranges, level at both ends
    beta = image["area_beta"][row][whole].sum(axis=1)
    expected = beta * look[2] / np.hypot(look[0], look[1])
    np.testing.assert_allclose(seen, expected, rtol=0.02)
    assert whole.sum() > 20


def test_a_longer_side_of_pixels_the_other_way(tmp_path: Path) -> None:
    """Rows that run north give the same layers as rows that run south."""
    x, y = offsets_m(41)
    heights = SITE[2] + 0.2 * x + 0.1 * y
    north_up = simulate(tmp_path, heights)
    import rasterio

    with rasterio.open(tmp_path / "dem.tif") as file:
        profile, affine = file.profile, file.transform
    profile["transform"] = type(affine)(affine.a, 0.0, affine.c, 0.0, -affine.e, affine.f + 41 * affine.e)
    path = tmp_path / "turned.tif"
    with rasterio.open(path, "w", **profile) as file:
        file.write(heights[::-1].astype(np.float32), 1)
    safe = next(tmp_path.glob("*.SAFE"))
    other = warpsar.twin(safe, path, geoid_offset_m=0.0, device="cpu")
    for name in ("area_sigma", "incidence", "longitude"):
        np.testing.assert_allclose(other.image[name], north_up.image[name], rtol=2e-4, err_msg=name)


# ---- heights ----


def test_heights_are_never_guessed(tmp_path: Path) -> None:
    safe = product(tmp_path)
    with pytest.raises(InputError, match="does not say what its heights are above; state --geoid-offset"):
        warpsar.twin(safe, dem(tmp_path, flat(9)))
    with pytest.raises(InputError, match=r"EGM96 height, and PROJ lacks its grid us_nga_egm96_15\.tif"):
        warpsar.twin(safe, dem(tmp_path, flat(9), crs="EPSG:4326+5773"))
    with pytest.raises(InputError, match="--geoid-offset: found 5000 m"):
        warpsar.twin(safe, dem(tmp_path, flat(9)), geoid_offset_m=5000.0)


def test_an_offset_lifts_the_ground(tmp_path: Path, level: SimulatedProduct) -> None:
    """Ground 48 m below, with 48 m added, is the same ground."""
    lifted = warpsar.twin(product(tmp_path), dem(tmp_path, flat(61, SITE[2] - 48.0)), geoid_offset_m=48.0, device="cpu")
    np.testing.assert_allclose(lifted.image["height"], level.image["height"], atol=1e-3)
    assert lifted.elevation.datum.words == "+48 m were added to all heights, as stated"


def test_heights_above_the_ellipsoid_need_no_offset(tmp_path: Path, level: SimulatedProduct) -> None:
    found = warpsar.twin(product(tmp_path), dem(tmp_path, flat(), crs="EPSG:4979"), device="cpu")
    np.testing.assert_allclose(found.image["height"], level.image["height"], atol=1e-3)


def test_a_grid_of_proj_lifts_the_ground(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A grid of 48.6 m everywhere, under the name that PROJ looks for: heights above EGM96 are lifted by that."""
    import pyproj
    import rasterio
    from rasterio.transform import from_origin

    before = pyproj.datadir.get_data_dir()
    grid = tmp_path / "us_nga_egm96_15.tif"
    tags = {"TYPE": "VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL", "area_of_use": "World"}
    with rasterio.open(
        grid, "w", driver="GTiff", width=81, height=41, count=1, dtype="float32", crs="EPSG:4326",
        transform=from_origin(2.0, 51.0, 0.25, 0.25),
    ) as file:  # fmt: skip
        file.write(np.full((41, 81), 48.6, np.float32), 1)
        file.update_tags(**tags)
        file.set_band_description(1, "geoid_undulation")
        file.set_band_unit(1, "metre")
    try:
        pyproj.datadir.append_data_dir(str(tmp_path))
        found = warpsar.twin(product(tmp_path), dem(tmp_path, flat(61, 201.4), crs="EPSG:4326+5773"), device="cpu")
    finally:
        pyproj.datadir.set_data_dir(before)
    assert np.nanmean(found.image["height"]) == pytest.approx(250.0, abs=1e-3)
    assert "EGM96" in found.elevation.datum.words


def test_bad_input_at_the_door(tmp_path: Path) -> None:
    safe = product(tmp_path)
    good = dem(tmp_path, flat(9))
    with pytest.raises(InputError, match="heights from 32767"):
        warpsar.twin(safe, dem(tmp_path, flat(9, 32767.0), name="high.tif"), geoid_offset_m=0.0)
    with pytest.raises(InputError, match=r"--crop: found .* holds none of it"):
        warpsar.twin(safe, good, geoid_offset_m=0.0, crop=(40.0, 10.0, 41.0, 11.0))
    with pytest.raises(InputError, match="west below east"):
        warpsar.twin(safe, good, geoid_offset_m=0.0, crop=(13.0, 46.0, 12.0, 47.0))
    with pytest.raises(InputError, match=r"--surface: found 'gras'.*grass"):
        warpsar.twin(safe, good, geoid_offset_m=0.0, surface="gras")
    other = tmp_path / "no_orbit"
    other.mkdir()
    with pytest.raises(InputError, match="no state vectors"):
        warpsar.twin(product(other, orbit=False), good, geoid_offset_m=0.0)


def test_far_ground_is_refused(tmp_path: Path) -> None:
    import rasterio

    path = dem(tmp_path, flat(9))
    with rasterio.open(path, "r+") as file:
        a, b, c, d, e, f = tuple(file.transform)[:6]
        file.transform = type(file.transform)(a, b, c + 3.0, d, e, f)
    with pytest.raises(InputError, match="shows no place of"):
        warpsar.twin(product(tmp_path), path, geoid_offset_m=0.0)


def test_places_come_back(level: SimulatedProduct) -> None:
    """Each pixel's place, sent through the orbit by a minimum of distances, is that pixel: 20 of them."""
    inside = np.argwhere(np.isfinite(level.image["height"]))
    chosen = inside[np.linspace(0, len(inside) - 1, 20).astype(int)]
    start, near = Band(lines=64, pixels=256, centre=(31.5, 127.5)).start()
    for row, column in chosen:
        where = tuple(float(level.image[name][row, column]) for name in ("latitude", "longitude", "height"))
        time, distance = nearest(where)  # type: ignore[arg-type]
        assert (time - start) / 2.0e-3 == pytest.approx(row + level.window.lines[0], abs=0.005)
        assert (distance - near) / 2.5 == pytest.approx(column + level.window.pixels[0], abs=0.005)
    assert ecef_to_geodetic(geodetic_to_ecef(np.array(SITE)))[0] == pytest.approx(SITE[0])


def test_bursts_show_what_an_image_without_them_shows(tmp_path: Path) -> None:
    """Two bursts of 40 lines, of which 16 lie on the same ground: each has all layers of its own lines' times."""
    from warpsar.formats import sentinel1

    east, north = offsets_m(61)
    model = dem(tmp_path, SITE[2] + np.maximum(120.0 - 0.9 * np.hypot(east, north), 0.0))
    (plain,) = sentinel1.products(product(tmp_path), None)
    plain = replace(plain, samples=None)
    starts = plain.grid.first_line_s, plain.grid.first_line_s + 24 * plain.grid.line_s
    bursts = replace(plain, grid=replace(plain.grid, lines=80, burst_start_s=starts))
    whole, cut = (warpsar.twin(one, model, geoid_offset_m=0.0, device="cpu") for one in (plain, bursts))
    assert (whole.window.lines, cut.window.lines) == ((0, 64), (0, 80))
    assert whole.window.pixels == cut.window.pixels
    for name in ("beta0", "area_gamma", "shadow", "layover", "incidence", "height", "longitude"):
        there = np.concatenate([whole.image[name][:40], whole.image[name][24:]])
        np.testing.assert_allclose(cut.image[name], there, rtol=1e-4, atol=2e-3, err_msg=name)
