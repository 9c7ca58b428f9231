"""Reflectors in measured data: what docs/reflectors-checks.md says of them."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import warpsar
from warpsar.calibration.sites import ReflectorSite
from warpsar.formats import gamma, nisar
from warpsar.products.orbit import Orbit
from warpsar.products.zero_doppler import abeam

pytestmark = pytest.mark.measured
F64 = NDArray[np.float64]
AUTHORS_PLACE = 110, 87
"""Line and pixel that CoRAL's authors take, from 0."""


def authors_method(power: F64, line: int, pixel: int) -> tuple[float, float, float]:
    """Sum over 5 x 5, mean of the ring up to 9 x 9, and target energy T = sum - 25 x mean (Garthwaite, 2017)."""
    half, outer = 2, 4
    inner = power[line - half : line + half + 1, pixel - half : pixel + half + 1]
    whole = power[line - outer : line + outer + 1, pixel - outer : pixel + outer + 1]
    clutter = (whole.sum() - inner.sum()) / (whole.size - inner.size)
    return float(inner.sum()), float(clutter), float(inner.sum() - inner.size * clutter)


def orbit_of(fit: dict[str, object], start: float, stop: float) -> Orbit:
    """State vectors at every second from the Chebyshev polynomials of a date."""
    time = np.arange(np.floor(start) - 6.0, np.ceil(stop) + 7.0)
    coefficient = {name: np.array(value["array"]) for name, value in fit.items() if isinstance(value, dict)}

    def at(names: tuple[str, str, str]) -> F64:
        since = time - float(fit["t0"])  # type: ignore[arg-type]
        return np.stack([np.polynomial.chebyshev.chebval(since, coefficient[name]) for name in names], axis=-1)

    return Orbit.of("GECORIS", time, at(("cX", "cY", "cZ")), at(("cVX", "cVY", "cVZ")))


def shift(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> tuple[float, float]:
    """Range shift of the first image against the second [pixels], and their coherence there."""
    a, b = np.fft.fft(first, axis=1), np.fft.fft(second, axis=1)
    cross = (a * b.conj()).sum(axis=0)
    power = np.sqrt((np.abs(a) ** 2).sum(axis=0) * (np.abs(b) ** 2).sum(axis=0))
    frequency, used = np.fft.fftfreq(first.shape[1]), power > 0.3 * np.median(power)
    tried = np.linspace(-1.0, 1.0, 4001)
    ramps = np.exp(2j * np.pi * np.outer(tried, frequency[used]))
    heights = np.abs(ramps @ cross[used])
    return float(tried[heights.argmax()]), float(heights.max() / power[used].sum())


def test_the_reflector_of_coral_is_found_in_place_and_date(measured_data: Path) -> None:
    """Its authors' values come out by their method; the date of its set-up and its place from the images alone."""
    data = measured_data / "coral_s1"
    products = [gamma.products(path, None)[0] for path in sorted(data.glob("*.mli"))]
    stack = np.stack([np.asarray(p.samples[:, :], np.float64) for p in products if p.samples is not None])
    middle = products[-1].to_ground(60.0, 140.0, 40.0)  # 1 km off
    unknown = ReflectorSite("SERF", *middle, (), "triangular", None, search_m=2000.0)
    result = warpsar.reflectors(products, [unknown], radiometry="sigma0")
    (serf,) = result.found
    image = products[-1].to_image(serf.site.geodetic(products[-1].epoch))
    assert (image.line, image.pixel) == pytest.approx((110.0, 87.0), abs=0.7)
    assert (str(serf.after)[:10], str(serf.before)[:10]) == ("2018-08-07", "2018-08-19")
    assert serf.chance < 1e-6
    total, clutter, target = authors_method(stack[2], *AUTHORS_PLACE)
    assert total == pytest.approx(22.778708, rel=1e-6)  # of their own unit test
    assert 10 * np.log10(clutter) == pytest.approx(-11.4717, abs=1e-4)
    assert target == pytest.approx(20.997258, rel=1e-6)
    assert image.incidence_deg == pytest.approx(36.0, abs=0.05)  # the file's 33.58 is elsewhere
    found = result.observations
    assert [one.status for one in found] == ["not seen"] * 2 + ["measured"] * 3
    with (data / "authors_values.csv").open() as file:
        theirs = [float(row["rcs_dbsm"]) for row in csv.DictReader(file)]
    ours = [10 * np.log10(one.point.rcs_m2) for one in found if one.status == "measured" and one.point is not None]
    assert result.explanation.unpredicted is not None
    (fading,) = result.explanation.unpredicted.uneven  # its size is not known, so it is compared with itself
    assert (fading.brightest[0], fading.weakest[0]) == ("2018-08-19", "2018-09-12")
    assert fading.brightest[1] - fading.weakest[1] == pytest.approx(6.1, abs=0.3)
    # 0.26 dB of incidence; windows differ by 0.2 dB of sidelobes and clutter.
    np.testing.assert_allclose(np.array(theirs[2:]) - ours, 0.15, atol=0.3)


@pytest.mark.parametrize(("track", "range_m", "azimuth_m"), [("s1_dsc51", 3.15, -0.84), ("s1_asc175", 3.63, -1.54)])
def test_the_reflector_of_gecoris_lies_where_orbit_and_survey_say(
    measured_data: Path, track: str, range_m: float, azimuth_m: float
) -> None:
    """But for the atmosphere, 3 to 4 m in range, and 1 to 2 m in azimuth, as the data's README says."""
    data = measured_data / "gecoris_lhe"
    point = np.array(json.loads((data / "station.json").read_text())["ascending"]["_xyz"]["array"])
    acquisitions = json.loads((data / f"acquisitions_{track}.json").read_text())
    with (data / f"series_{track}.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["reflector_on"] == "1"]
    off = []
    for row in rows:
        one = acquisitions[row["date"]]
        hours, minutes, seconds = (float(each) for each in row["time_utc"].split(":"))
        around = 3600 * hours + 60 * minutes + seconds
        time, distance = abeam(orbit_of(one["orbitFit"], around, around), point, around)
        line = (float(time) - one["azimuth0time"]) * one["PRF"]
        pixel = (float(distance) / 299792458.0 - one["range0time"]) * one["RSR"]
        steps = float(row["azimuth_px"]) - line, float(row["range_px"]) - pixel
        off.append((steps[0] * one["azimuthSpacing"], steps[1] * one["rangeSpacing"]))
    mean = np.mean(off, axis=0)
    assert mean == pytest.approx((azimuth_m, range_m), abs=0.02)


def test_alos_finds_the_reflector_where_isce3_located_it(measured_data: Path) -> None:
    data = measured_data / "alos_polcal"
    image = data / "calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
    for name in ("", "_NISAR"):  # UAVSAR's and NISAR's table
        table = data / f"Corner_Reflector_Rio_Branco_ALPSRP025826990{name}.csv"
        result = warpsar.reflectors(image, table, engine=False, polarization="HH")
        (one,) = result.observations
        assert one.point is not None
        assert one.expected is not None
        assert (one.point.line, one.point.pixel) == pytest.approx((one.expected.line, one.expected.pixel), abs=0.05)
        assert one.facing is not None
        assert one.facing.azimuth_deg % 360.0 == pytest.approx(270.0)


def test_alos_receives_v_late(measured_data: Path) -> None:
    """VV lies 0.12 pixel beyond HH in clutter, too, far from the reflector; so do HV and VH: it is the data's."""
    image = measured_data / "alos_polcal" / "calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
    found = {
        p.polarization: np.asarray(p.samples[:, :], np.complex128) for p in nisar.products(image, None) if p.samples
    }
    lines, pixels = np.mgrid[:100, :50]
    away = (np.abs(lines - 50) > 15) | (np.abs(pixels - 25) > 8)
    for first, second, expected in (("VV", "HH", 0.121), ("HV", "VH", 0.108)):
        assert shift(found[first] * away, found[second] * away)[0] == pytest.approx(expected, abs=0.02)
