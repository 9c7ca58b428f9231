"""Where a product shows a place: against an orbit in closed form, and against the grids that producers publish."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from product_files import DAY, SITE, Band, nearest, place, velocity, write_gamma, write_safe

from warpsar.errors import InputError
from warpsar.formats import gamma, nisar, sentinel1
from warpsar.products.grid import LineGrid
from warpsar.products.ground_range import GroundRange
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.products.zero_doppler import abeam, locate
from warpsar.world.earth import geodetic_to_ecef
from warpsar.world.frame import SPEED_OF_LIGHT

pytestmark = pytest.mark.unit


def orbit(step_s: float, count: int = 16) -> Orbit:
    time = step_s * (np.arange(count) - (count - 1) / 2)
    return Orbit.of("made", time, place(time), velocity(time))


# ---- orbit ----


@pytest.mark.parametrize(("step_s", "allowed_m"), [(10.0, 1e-5), (60.0, 1e-3)])
def test_places_between_state_vectors(step_s: float, allowed_m: float) -> None:
    """Degree 7 through four vectors: f^(8) (h/2)^4 (3h/2)^4 / 8! is 0.3 mm at 60 s; of a cubic 0.3 m."""
    time = np.linspace(-1.5 * step_s, 1.5 * step_s, 301)
    position, speed = orbit(step_s).at(time)
    assert np.abs(position - place(time)).max() < allowed_m
    assert np.abs(speed - velocity(time)).max() < 1e-4


def test_what_is_no_orbit_is_refused() -> None:
    time = np.arange(4.0)
    with pytest.raises(InputError, match="must ascend"):
        Orbit.of("made", time[::-1], place(time), velocity(time))
    with pytest.raises(InputError, match="NaN"):
        Orbit.of("made", time, place(time) * np.nan, velocity(time))
    with pytest.raises(InputError, match="at least 2 of each"):
        Orbit.of("made", time[:1], place(time[:1]), velocity(time[:1]))


# ---- zero Doppler ----


def test_zero_doppler_is_the_closest_approach() -> None:
    """In earth-fixed coordinates: (point - satellite) . velocity = 0 is where the distance has no slope."""
    expected = nearest(SITE)
    time, distance = abeam(orbit(10.0), geodetic_to_ecef(np.array(SITE)), 30.0)
    assert time == pytest.approx(expected[0], abs=1e-8)  # 0.06 mm of flight
    assert distance == pytest.approx(expected[1], abs=1e-4)


def test_a_place_comes_back_from_time_range_and_height() -> None:
    sites = np.array([SITE, (46.4, 12.5, -20.0), (45.7, 13.0, 3000.0)])
    time, distance = abeam(orbit(10.0), geodetic_to_ecef(sites), 0.0)
    found = locate(orbit(10.0), time, distance, sites[:, 2], "right")
    off = np.linalg.norm(geodetic_to_ecef(found) - geodetic_to_ecef(sites), axis=1)
    assert off.max() < 1e-4
    left = locate(orbit(10.0), time[0], distance[0], sites[0, 2], "left")
    assert left[1] < SITE[1] - 5.0  # the other side of the track


def test_a_range_that_meets_no_ground_is_refused() -> None:
    with pytest.raises(InputError, match="no place at that height"):
        locate(orbit(10.0), 0.0, 1e5, 0.0, "right")


def test_ground_range_is_the_inverse_of_slant_range() -> None:
    """Of a sphere: R^2 = r^2 + s^2 - 2 r s cos(g / r); its polynomial here is the series about the near edge."""
    ground = np.linspace(0.0, 250e3, 40)
    earth, far = 6371e3, 7.07e6
    slant = np.sqrt(earth**2 + far**2 - 2 * earth * far * np.cos((ground + 300e3) / earth))
    unit = np.polynomial.Polynomial.fit(ground, slant, 8).convert().coef
    later = unit + np.array([10.0] + [0.0] * 8)
    table = GroundRange(np.array([0.0, 10.0]), np.zeros(2), np.stack([unit, later]))
    np.testing.assert_allclose(table.slant_m(4.0, ground), slant, atol=1e-3)
    np.testing.assert_allclose(table.slant_m(6.0, ground), slant + 10.0, atol=1e-3)  # the nearest in time
    np.testing.assert_allclose(table.ground_m(6.0, table.slant_m(6.0, ground)), ground, atol=1e-5)
    both = np.array([4.0, 6.0, 4.9])[:, None]  # lines by pixels
    window = table.slant_m(both, ground[None, :])
    np.testing.assert_allclose(window, slant + np.array([0.0, 10.0, 0.0])[:, None], atol=1e-3)
    np.testing.assert_allclose(table.ground_m(both, window), np.broadcast_to(ground, window.shape), atol=1e-5)


def test_bursts_have_their_own_times() -> None:
    grid = LineGrid(3 * 100, 50, 0.0, 0.01, 8e5, 2.0, None, (0.0, 0.9, 1.8))
    line = np.array([0.0, 50.0, 99.0, 150.0, 299.0])
    time = grid.time_s(line, 0.0)
    np.testing.assert_allclose(time, [0.0, 0.5, 0.99, 1.4, 2.79])
    np.testing.assert_allclose(grid.line(time[[1, 3]], 8e5), line[[1, 3]])  # far from an edge: one burst has it
    assert grid.line(0.94, 8e5) == pytest.approx(94.0)  # in two bursts: 44.5 lines off one middle, 45.5 off the other


# ---- products that are made ----


def image() -> np.ndarray:
    return (np.random.default_rng(0).normal(size=(256, 256, 2)) @ [1, 1j]).astype(np.complex64)


def opened(kind: str, folder: Path) -> Product:
    if kind == "sentinel1":
        return sentinel1.products(write_safe(folder, image()), None)[0]
    return gamma.products(write_gamma(folder, np.abs(image()) ** 2), None)[0]


@pytest.mark.parametrize("kind", ["sentinel1", "gamma"])
def test_a_made_product_shows_the_site_where_it_was_put(kind: str, tmp_path: Path) -> None:
    product, band = opened(kind, tmp_path), Band()
    point = product.to_image(SITE)
    # A thousandth of a pixel: times in both files end at a microsecond and a nanosecond.
    assert (point.line, point.pixel) == pytest.approx(band.centre, abs=1e-3)
    assert str(product.date(point.time_s))[:10] == DAY
    back = product.to_ground(point.line, point.pixel, SITE[2])
    assert np.linalg.norm(geodetic_to_ecef(back) - geodetic_to_ecef(np.array(SITE))) < 1e-3
    assert product.polarization == "VV"
    assert product.wavelength_m == pytest.approx(SPEED_OF_LIGHT / 5.405e9)


def test_sentinel1_calibration_and_noise(tmp_path: Path) -> None:
    """beta0 = |DN|^2 / A^2; noise = range vector x azimuth vector."""
    product = sentinel1.products(write_safe(tmp_path, image(), beta_lut=200.0, noise=4.0), "VV")[0]
    assert product.gain is not None
    assert product.noise is not None
    assert product.samples is not None
    assert product.gain(10.0, 20.0) == pytest.approx(1 / 200.0**2)
    assert product.noise(10.0, 20.0) == pytest.approx(6.0)
    window = product.samples[10:14, 20:25]
    np.testing.assert_allclose(window / 200.0, image()[10:14, 20:25], atol=0.5 * np.sqrt(2) / 200.0)


@pytest.mark.parametrize("kind", ["sentinel1", "gamma"])
def test_a_product_without_orbit_says_so(kind: str, tmp_path: Path) -> None:
    path = (
        write_safe(tmp_path, image(), orbit=False)
        if kind == "sentinel1"
        else write_gamma(tmp_path, np.abs(image()) ** 2, orbit=False)
    )
    product = (sentinel1 if kind == "sentinel1" else gamma).products(path, None)[0]
    with pytest.raises(InputError, match="no state vectors"):
        product.to_image(SITE)


def test_broken_annotations_end_in_one_message(tmp_path: Path) -> None:
    annotation = next((write_safe(tmp_path, image()) / "annotation").glob("*.xml"))
    text = annotation.read_text()
    for old, new, message in [
        ("<lookBandwidth>48000000.0", "<lookBandwidth>wide", "rangeProcessing/lookBandwidth: found 'wide'"),
        ("<product>", "<!DOCTYPE a><product>", "DOCTYPE"),
        ("</product>", "", "not readable as XML"),
        ("<slantRangeTime>", "<slantTime>", "not readable as XML"),
        (f"<startTime>{DAY}", "<startTime>yesterday!", "found the time"),
    ]:
        annotation.write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match=message):
            sentinel1.products(annotation, None)


def test_a_gamma_image_of_another_size_is_refused(tmp_path: Path) -> None:
    path = write_gamma(tmp_path, np.abs(image()) ** 2)
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(InputError, match="256 x 256 pixels, 262144 bytes"):
        gamma.products(path, None)


# ---- published grids ----


def grid_of(annotation: Path) -> dict[str, np.ndarray]:
    from xml.etree import ElementTree

    points = list(ElementTree.parse(annotation).getroot().iter("geolocationGridPoint"))
    names = ("line", "pixel", "latitude", "longitude", "height", "slantRangeTime", "incidenceAngle")
    found = {name: np.array([float(p.findtext(name)) for p in points]) for name in names}
    found["time"] = np.array(
        [
            (np.datetime64(p.findtext("azimuthTime")) - np.datetime64("2021-12-23")) / np.timedelta64(1, "s")
            for p in points
        ]
    )
    return found


@pytest.mark.measured
def test_sentinel1_meets_its_geolocation_grid(measured_data: Path) -> None:
    """ESA's own grid, of 210 points: another program's geometry. Aim: 0.1 pixel."""
    safe = next((measured_data / "sentinel1_rome").glob("*.SAFE"))
    product = sentinel1.products(safe, None)[0]
    truth = grid_of(next((safe / "annotation").glob("*.xml")))
    places = np.stack([truth[name] for name in ("latitude", "longitude", "height")], axis=-1)
    found = [product.to_image(one) for one in places]
    time, distance = (np.array([getattr(one, name) for one in found]) for name in ("time_s", "slant_range_m"))
    assert np.abs(time - truth["time"]).max() < 1.5e-6  # the grid's times end at a microsecond
    assert np.abs(distance - truth["slantRangeTime"] * SPEED_OF_LIGHT / 2).max() < 2e-3
    line, pixel = (np.array([getattr(one, name) for one in found]) for name in ("line", "pixel"))
    assert np.abs(line - truth["line"]).max() < 0.1
    assert np.abs(pixel - truth["pixel"]).max() < 0.1
    incidence = np.array([one.incidence_deg for one in found])
    # ESA does not say which vertical its angle is from; ours is the ellipsoid's normal.
    assert np.abs(incidence - truth["incidenceAngle"]).max() < 0.04
    back = product.to_ground(truth["line"], truth["pixel"], truth["height"])
    assert np.linalg.norm(geodetic_to_ecef(back) - geodetic_to_ecef(places), axis=1).max() < 1.0  # 0.1 pixel of 10 m


@pytest.mark.measured
def test_nisar_meets_the_grid_of_isce3(measured_data: Path) -> None:
    """ALOS in NISAR's form: ISCE3's grid over heights gives place and incidence of the first line and pixel."""
    import h5py

    path = measured_data / "alos_polcal" / "calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
    product = nisar.products(path, "HH")[0]
    with h5py.File(path) as file:
        grid = file["science/LSAR/RSLC/metadata/geolocationGrid"]
        heights = grid["heightAboveEllipsoid"][()]
        lon, lat, incidence = (grid[name][:, 0, 0] for name in ("coordinateX", "coordinateY", "incidenceAngle"))
    back = product.to_ground(np.zeros(heights.size), np.zeros(heights.size), heights)
    truth = geodetic_to_ecef(np.stack([lat, lon, heights], axis=-1))
    off = np.linalg.norm(geodetic_to_ecef(back) - truth, axis=1)
    assert off.max() < 0.5  # 0.05 pixel of 8.9 m: orbit vectors 60 s apart
    found = [product.to_image(one).incidence_deg for one in np.stack([lat, lon, heights], axis=-1)]
    # ISCE3 takes the angle to the satellite at the same place; float32 in the file.
    assert np.abs(np.array(found) - incidence).max() < 0.02


@pytest.mark.measured
def test_gamma_meets_its_own_centre(measured_data: Path) -> None:
    """The .par's centre latitude and longitude: another program's, at a height that it does not say."""
    for path in sorted((measured_data / "coral_s1").glob("*.mli")):
        product = gamma.products(path, None)[0]
        text = dict(
            line.split(":", 1) for line in path.with_name(f"{path.name}.par").read_text().splitlines() if ":" in line
        )
        number = {key.strip(): value.split()[0] for key, value in text.items() if value.split()}
        centre = float(number["center_latitude"]), float(number["center_longitude"])
        middle = (product.grid.lines - 1) / 2, (product.grid.pixels - 1) / 2
        heights = np.linspace(-100.0, 300.0, 401)
        found = product.to_ground(np.full(401, middle[0]), np.full(401, middle[1]), heights)
        off = np.linalg.norm(
            geodetic_to_ecef(found)
            - geodetic_to_ecef(np.stack([np.full(401, centre[0]), np.full(401, centre[1]), heights], axis=-1)),
            axis=1,
        )
        assert off.min() < 10.0
        at = product.to_image((*centre, float(heights[off.argmin()])))
        # By the law of cosines from the file's own radii. Its incidence_angle, 33.58 degrees, is another place's.
        far, earth, slant = (
            float(number[key]) for key in ("sar_to_earth_center", "earth_radius_below_sensor", "center_range_slc")
        )
        sphere = np.degrees(np.arccos((far**2 - earth**2 - slant**2) / (2.0 * earth * slant)))
        assert at.incidence_deg == pytest.approx(sphere, abs=0.15)
        assert at.incidence_deg - float(number["incidence_angle"]) == pytest.approx(2.4, abs=0.1)
        azimuth_m = product.speed_m_s(at) * product.grid.line_s
        assert azimuth_m == pytest.approx(float(number["azimuth_pixel_spacing"]), rel=2e-3)
