"""Corner reflectors in measured data: Sentinel-1 over Samford (CoRAL) and over Slovakia (GECORIS), and ALOS PALSAR.

    python benchmarks/reflectors_measured.py coral
    python benchmarks/reflectors_measured.py gecoris
    python benchmarks/reflectors_measured.py alos

WARPSAR_MEASURED names the folder of the data (docs/measured.md).
"""

from __future__ import annotations

import csv
import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import warpsar
from warpsar.calibration.attitude import Facing, trihedral_rcs_m2, turn_that_loses_deg
from warpsar.calibration.differences import Differences, bad_dates
from warpsar.calibration.engine import engine_rcs_m2
from warpsar.calibration.explain import Explanation, explain
from warpsar.calibration.forecast import forecast
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.point import PointMeasurement, ResponseAxis, interval
from warpsar.calibration.sites import ReflectorSite
from warpsar.formats import gamma, nisar
from warpsar.products.orbit import Orbit
from warpsar.products.product import ImagedPoint, Product
from warpsar.products.zero_doppler import abeam, azimuth_deg, incidence_deg, toward_radar
from warpsar.world.earth import ecef_to_geodetic, geodetic_to_ecef
from warpsar.world.frame import SPEED_OF_LIGHT

F64 = NDArray[np.float64]


def folder() -> Path:
    return Path(os.environ.get("WARPSAR_MEASURED") or Path(__file__).resolve().parents[2] / "shared" / "data")


def db(value: float) -> float:
    return float(10.0 * np.log10(value))


def show(explanation: Explanation) -> None:
    for words in explanation.words:
        print(words)
    for one in explanation.fitted[:8]:
        values = ", ".join(
            f"{v:.3g} ({a:.3g} to {b:.3g})" for v, a, b in zip(one.values, one.low, one.high, strict=True)
        )
        held = "" if one.held_log_likelihood is None else f", later dates {one.held_log_likelihood:.2f}"
        print(f"  {one.cause.name}: {values}; BIC {one.bic:.1f}, scatter {one.scatter_db:.2f} dB{held}")
    for tie in explanation.tied[:8]:
        print(f"  tied: {tie.first} and {tie.second}; {tie.decided_by} ({tie.apart_db:.2f} dB)")
    for bad in explanation.bad_dates:
        print(f"  bad: {bad.site} {bad.date}: {bad.words}; chance of a good date {bad.chance:.1e}")


# ---- CoRAL ----

CORAL_WINDOW, CORAL_OUTER = 5, 9
AUTHORS_PLACE = 110, 87
"""Line and pixel that they take, from 0."""


def authors_method(power: F64, line: int, pixel: int) -> tuple[float, float, float]:
    """Sum over 5 x 5, mean of the ring up to 9 x 9, and target energy T = sum - 25 x mean (Garthwaite, 2017)."""
    half, outer = CORAL_WINDOW // 2, CORAL_OUTER // 2
    inner = power[line - half : line + half + 1, pixel - half : pixel + half + 1]
    whole = power[line - outer : line + outer + 1, pixel - outer : pixel + outer + 1]
    clutter = (whole.sum() - inner.sum()) / (whole.size - inner.size)
    return float(inner.sum()), float(clutter), float(inner.sum() - inner.size * clutter)


def coral() -> None:
    data = folder() / "coral_s1"
    products = [gamma.products(path, None)[0] for path in sorted(data.glob("*.mli"))]
    stack = np.stack([np.asarray(p.samples[:, :], np.float64) for p in products if p.samples is not None])
    dates = [str(p.epoch)[:10] for p in products]
    with (data / "authors_values.csv").open() as file:
        theirs = {row["date"]: (float(row["rcs_dbsm"]), float(row["scr_db"])) for row in csv.DictReader(file)}
    last = products[-1]
    height = centre_height(data / f"{Path(last.source).name}.par", last)
    middle = last.to_ground(0.5 * last.grid.lines, 0.5 * last.grid.pixels, height)
    print(f"height {height:.0f} m by the .par's centre; searched 2 km about the image's middle")
    unknown = ReflectorSite("SERF", *middle, (), "triangular", None, search_m=2000.0)
    found = warpsar.reflectors(products, [unknown], radiometry="sigma0", allowance_m=(20.0, 15.0))
    (serf,) = found.found
    print(serf.words)
    print("\n".join(found.explanation.words))
    place = serf.site.geodetic(last.epoch)
    at = last.to_image(place)
    print(f"line {at.line:.2f}, pixel {at.pixel:.2f} of the last image; chance {serf.chance:.1e}")
    keys = dict(
        one.split(":", 1) for one in (data / f"{Path(last.source).name}.par").read_text().splitlines() if ":" in one
    )
    stated = float(keys["incidence_angle"].split()[0])
    true = last.to_image(place).incidence_deg
    wrong = 10.0 * np.log10(np.sin(np.deg2rad(true)) / np.sin(np.deg2rad(stated)))
    print(f"incidence: stated {stated:.2f}, by the orbit {true:.2f} deg: published RCS {wrong:+.2f} dB")
    steps = [float(keys[key].split()[0]) for key in ("range_pixel_spacing", "azimuth_pixel_spacing")]
    for date, power in zip(dates, stack, strict=True):
        _, clutter, target = authors_method(power, *AUTHORS_PLACE)
        area = steps[0] * steps[1] / np.sin(np.deg2rad(stated))
        rcs = max(10.0 * np.log10(target * area), 0.0) if target > 0 else 0.0
        scr = max(10.0 * np.log10(target / clutter), 0.0) if target > 0 else 0.0
        published = theirs[date.replace("-", "")]
        print(f"  {date}: by their method {rcs:.3f} dBsm, {scr:.3f} dB; ", end="")
        print(f"published {published[0]:.3f}, {published[1]:.3f}")
    print("date, status, line, pixel, RCS [dBsm] (90 %), clutter beta0 [dB], SCR [dB]")
    for one in found.observations:
        assert one.point is not None
        rcs, low, high = (db(max(v, 1e-3)) for v in (one.point.rcs_m2, one.point.low_m2, one.point.high_m2))
        place_found = f"{one.point.line:.2f}, {one.point.pixel:.2f}"
        print(
            f"  {str(one.date)[:10]}, {one.status}, {place_found}, {rcs:.2f} ({low:.2f} to "
            f"{high:.2f}), {10 * np.log10(one.point.clutter):.2f}, {db(max(one.point.scr, 1e-3)):.1f}"
        )
    faded(found.observations)


def faded(observations: tuple[ReflectorObservation, ...]) -> None:
    """What the fall after the set-up may be: each cause with the value that it needs."""
    used = [one for one in observations if one.status == "measured" and one.point is not None]
    levels = np.array([10.0 * np.log10(one.point.rcs_m2) for one in used if one.point is not None])
    fall = levels[0] - levels[-1]
    wavelength, needed = 0.05546576, turn_that_loses_deg("triangular", fall)
    leg = (10 ** (levels[0] / 10) * 3 * wavelength**2 / (4 * np.pi)) ** 0.25
    print(f"fall {fall:.1f} dB: a turn of {needed:.0f} deg from boresight, or a loss, or a leg of it bent; tied here")
    print(f"a triangular trihedral on boresight of that RCS has legs of {leg:.2f} m")
    for one in used[1:]:
        assert one.point is not None
        assert used[0].point is not None
        step = one.point.line - used[0].point.line, one.point.pixel - used[0].point.pixel
        print(f"  moved by {step[0]:+.2f} lines, {step[1]:+.2f} pixels against {str(used[0].date)[:10]}")


def centre_height(par: Path, product: Product) -> float:
    """The height at which the image's middle has the centre that the .par states [m]."""
    keys = dict(one.split(":", 1) for one in par.read_text().splitlines() if ":" in one)
    lat, lon = (float(keys[f"center_{name}"].split()[0]) for name in ("latitude", "longitude"))
    heights = np.linspace(-200.0, 500.0, 701)
    middle = [(n - 1) / 2 for n in (product.grid.lines, product.grid.pixels)]
    found = product.to_ground(np.full(701, middle[0]), np.full(701, middle[1]), heights)
    off = np.hypot(found[:, 0] - lat, (found[:, 1] - lon) * np.cos(np.deg2rad(lat)))
    return float(heights[off.argmin()])


# ---- GECORIS ----

TRACKS = {"s1_dsc51": "S1 track 51", "s1_asc175": "S1 track 175"}


def orbit_of(fit: dict[str, object], start: float, stop: float) -> Orbit:
    """State vectors at every second from the Chebyshev polynomials of a date."""
    time = np.arange(np.floor(start) - 6.0, np.ceil(stop) + 7.0)
    coefficient = {name: np.array(value["array"]) for name, value in fit.items() if isinstance(value, dict)}

    def at(names: tuple[str, str, str]) -> F64:
        since = time - float(fit["t0"])  # type: ignore[arg-type]
        return np.stack([np.polynomial.chebyshev.chebval(since, coefficient[name]) for name in names], axis=-1)

    return Orbit.of("GECORIS", time, at(("cX", "cY", "cZ")), at(("cVX", "cVY", "cVZ")))


WINDOWS = {"s1_dsc51": (42.79e6, 0.75, 314.0, 0.75), "s1_asc175": (48.30e6, 0.73, 313.0, 0.75)}
"""Bands [Hz] and Hamming coefficients of range and azimuth in IW3 and IW2, as Sentinel-1's annotations have them
(sentinel1_rome, swathProcParamsList)."""


def point_area(track: str, line_m: float, lines_per_s: float) -> float:
    """What a peak's power must be multiplied by: the response's energy over its peak [m2]."""
    range_hz, range_hamming, azimuth_hz, azimuth_hamming = WINDOWS[track]
    along = ResponseAxis(2.0 * range_hz / SPEED_OF_LIGHT, range_hamming)
    return along.peak_m * ResponseAxis(azimuth_hz / (line_m * lines_per_s), azimuth_hamming).peak_m


def gecoris_area(theta: float, omega: float, *, square: bool) -> float:
    """The effective area of a square trihedral of leg 1 by GECORIS' polygons; `square`: with axes that are square.

    There n2 is (-sin w cos t, -cos w cos t, sin t), square to n1 and n3 at w = 45 degrees alone.
    """
    aperture = np.array([[1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 1, 1], [0, 1, 0], [1, 1, 0]], float)
    s, c = np.sin(omega), np.cos(omega)
    first, second = (c, s) if square else (s, c)
    axes = np.array([[-s, c, 0.0], [-first * np.cos(theta), -second * np.cos(theta), np.sin(theta)]])
    from shapely.geometry import Polygon

    flat = aperture @ axes.T
    return float(Polygon(flat).intersection(Polygon(-flat)).area)


def gecoris() -> None:
    data = folder() / "gecoris_lhe"
    station = json.loads((data / "station.json").read_text())
    place = ecef_to_geodetic(np.array(station["ascending"]["_xyz"]["array"]))
    leg = station["geometry"]["a0"]
    site = ReflectorSite("LHE-KU-1", *place, (Facing(90.0, 0.0, True), Facing(270.0, 0.0, True)), "square", leg)
    observations: list[ReflectorObservation] = []
    for track, platform in TRACKS.items():
        observations += track_of(data, track, platform, site)
    explanation = explain(observations)
    show(explanation)
    early = sorted({one.date for one in observations})
    print(f"{len(early)} dates from {str(early[0])[:10]} to {str(early[-1])[:10]}")
    bad_later(Differences.of(observations))
    border = early[int(np.ceil(2 / 3 * len(early)))].astype("datetime64[D]").astype("datetime64[us]")
    held = forecast(observations, border, explain([one for one in observations if one.date < border]))
    print("\n".join(held.words))


def bad_later(data: Differences) -> None:
    """What is called bad in the later half of the dates: as they are, and with one value changed at a time."""
    late = data.part(data.years >= np.median(data.years))
    print(f"later half: {len(bad_dates(late)[0])} of {len(late)} values called bad")
    for off in (-1.5, -2.0, -3.0, 3.0):
        found = others = 0
        for i in range(len(late)):
            value, sd = late.value.copy(), late.sd.copy()
            value[i] += off
            sd[i] *= 10.0 ** (-off / 20.0)
            good = bad_dates(replace(late, value=value, sd=sd))[1]
            found += not good[i]
            others += int((~good).sum()) - (not good[i])
        print(f"  one value {off:+.1f} dB: found {100 * found / len(late):.0f} %, others called bad {others}")


def track_of(data: Path, track: str, platform: str, site: ReflectorSite) -> list[ReflectorObservation]:
    """The values of a track as observations: the RCS is the authors', position and prediction are ours."""
    acquisitions = json.loads((data / f"acquisitions_{track}.json").read_text())
    with (data / f"series_{track}.csv").open() as file:
        rows = list(csv.DictReader(file))
    clutter = float(np.mean([10 ** (float(r["rcs_dbsm"]) / 10) for r in rows if r["reflector_on"] == "0"]))
    made: list[ReflectorObservation] = []
    offsets, slow = [], []
    engine = raised = 0.0
    leg = site.leg_m or 1.0
    for row in rows:
        one = acquisitions[row["date"]]
        hours, minutes, seconds = (float(each) for each in row["time_utc"].split(":"))
        around = 3600 * hours + 60 * minutes + seconds
        orbit = orbit_of(one["orbitFit"], around, around)
        point = geodetic_to_ecef(site.geodetic(np.datetime64("2020-01-01")))
        time, distance = abeam(orbit, point, around)
        look = toward_radar(orbit, ecef_to_geodetic(point), float(time))
        line, pixel = (
            (float(time) - one["azimuth0time"]) * one["PRF"],
            (float(distance) / SPEED_OF_LIGHT - one["range0time"]) * one["RSR"],
        )
        facing = site.facing(look)
        assert facing is not None
        area = float(trihedral_rcs_m2("square", leg, facing, look, one["wavelength"]))
        if not engine:
            first, frequency = (azimuth_deg(look), incidence_deg(look)), SPEED_OF_LIGHT / one["wavelength"]
            engine = float(engine_rcs_m2("square", leg, facing, [first], frequency, "VV")[0])
            at_first = area
        if row["reflector_on"] == "0":
            continue
        slow.append(abs(float(distance) - float(row["range_m"])))
        ours = point_area(track, one["azimuthSpacing"], one["PRF"])
        raised = ours / (one["rangeResolution"] * one["azimuthResolution"])
        raw, cell = 10 ** (float(row["rcs_dbsm"]) / 10) * raised, clutter * raised
        low, high = interval(raw - cell, cell, cell**2, 1.6449)
        measured = PointMeasurement(
            line=float(row["azimuth_px"]),
            pixel=float(row["range_px"]),
            position_sd_m=(1.0, 0.1),
            rcs_m2=raw - cell,
            low_m2=low,
            high_m2=high,
            peak_rcs_m2=raw,
            scr=raw / cell,
            clutter=cell,
            clutter_cells=float("nan"),
            window_share=1.0,
            phase_deg=float(np.degrees(np.arctan2(float(row["slc_im"]), float(row["slc_re"])))),
            quality=None,
            seen=True,
        )
        spacing = one["azimuthSpacing"], one["rangeSpacing"]
        offsets.append(((measured.line - line) * spacing[0], (measured.pixel - pixel) * spacing[1]))
        made.append(
            ReflectorObservation(
                site=site,
                source=track,
                platform=platform,
                polarization="VV",
                date=np.datetime64(f"{row['date'][:4]}-{row['date'][4:6]}-{row['date'][6:]}T{row['time_utc']}", "us"),
                status="measured",
                expected=ImagedPoint(float(time), float(distance), line, pixel, look),
                spacing_m=spacing,
                point=measured,
                facing=facing,
                closed_form_m2=area,
                engine_m2=engine,
            )
        )
    off = np.array(offsets)
    level = np.array([db(one.point.rcs_m2) for one in made if one.point is not None])
    azimuth, incidence = first
    theta, omega = np.deg2rad([90.0 - incidence, 45.0 + azimuth - (90.0 if azimuth < 180 else 270.0)])
    scale = 4 * np.pi * leg**4 / one["wavelength"] ** 2
    theirs = [db(scale * gecoris_area(theta, omega, square=square) ** 2) for square in (False, True)]
    print(f"{track}: look azimuth {azimuth:.2f}, incidence {incidence:.2f} deg; {len(made)} dates with the reflector")
    print(f"  slant range: ours less theirs at most {max(slow):.3f} m")
    for k, name in enumerate(("azimuth", "slant range")):
        print(f"  found - expected, no corrections: {name} {off[:, k].mean():+.2f} +- {off[:, k].std():.2f} m")
    print(f"  clutter before it stood: {db(clutter):.2f} dBsm; SCR {level.mean() - db(clutter):.1f} dB")
    predicted = f"closed form {db(at_first):.2f}, engine {db(engine):.2f}"
    print(f"  measured {level.mean():.2f} +- {level.std():.2f} dBsm; {predicted}")
    print(f"  GECORIS' formula: {theirs[0]:.2f} dBsm; with axes that are square {theirs[1]:.2f}")
    print(f"  published RCS raised by {db(raised):+.2f} dB: the area of a peak under the Hamming windows")
    return made


# ---- ALOS ----


def alos() -> None:
    data = folder() / "alos_polcal"
    path = data / "calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
    found = warpsar.reflectors(
        path, data / "Corner_Reflector_Rio_Branco_ALPSRP025826990_NISAR.csv", allowance_m=(20.0, 20.0)
    )
    for one in found.observations:
        assert one.point is not None
        assert one.expected is not None
        quality = one.point.quality
        assert quality is not None
        print(f"{one.polarization}: expected line {one.expected.line:.2f}, pixel {one.expected.pixel:.2f}; ", end="")
        print(
            f"found {one.point.line:.2f}, {one.point.pixel:.2f}; incidence {one.expected.incidence_deg:.2f}, ", end=""
        )
        print(f"look azimuth {one.expected.azimuth_deg:.1f} deg")
        low, middle, high = (db(v) for v in (one.point.low_m2, one.point.rcs_m2, one.point.high_m2))
        print(f"  {middle:.2f} dB ({low:.2f} to {high:.2f}), SCR {db(one.point.scr):.1f} dB, ", end="")
        print(f"IRW {quality[0].width_m:.2f} x {quality[1].width_m:.2f} m")
        if one.facing is not None and one.predicted_m2 and one.closed_form_m2:
            off = one.facing.off_boresight_deg(one.expected.toward_radar)
            print(f"  off boresight {off:.1f} deg; closed form {db(one.closed_form_m2):.2f} dBsm, ", end="")
            print(f"engine {db(one.predicted_m2):.2f}")
    first = {p.polarization: p for p in nisar.products(path, None)}
    pixels = {pol: np.asarray(p.samples[:, :], np.complex128) for pol, p in first.items() if p.samples is not None}
    lines, columns = np.mgrid[:100, :50]
    away = (np.abs(lines - 50) > 15) | (np.abs(columns - 25) > 8)
    channels(pixels, away)
    over = np.vdot(pixels["VH"][away], pixels["HV"][away])
    ratio = np.sqrt((np.abs(pixels["HV"][away]) ** 2).mean() / (np.abs(pixels["VH"][away]) ** 2).mean()) * np.exp(
        1j * np.angle(over)
    )
    product = pixels["VV"][50, 25] / pixels["HH"][50, 25]
    transmit = np.sqrt(product / ratio)
    if transmit.real < 0:
        transmit = -transmit
    receive = product / transmit
    for name, value, published in (("transmit", transmit, (1.015, 20.287)), ("receive", receive, (0.725, -3.174))):
        print(f"{name}: {abs(value):.3f} at {np.degrees(np.angle(value)):+.2f} deg; ", end="")
        print(f"published {published[0]} at {published[1]:+.2f}")
    show(found.explanation)


def channels(pixels: dict[str, NDArray[np.complex128]], away: NDArray[np.bool_]) -> None:
    """How far channels lie apart in range, by the phase of their cross-spectrum: at the reflector, and in clutter."""
    shifts: dict[str, list[float]] = {}
    for first, second in (("VV", "HH"), ("HV", "VH")):
        for where, mask in (("reflector", ~away), ("clutter", away)):
            moved, alike = shift(pixels[first] * mask, pixels[second] * mask)
            shifts.setdefault(f"{first} {second}", []).append(moved)
            print(f"  {first} less {second}, {where}: {moved:+.3f} pixel in range (coherence {alike:.2f})")
        parts = [slice(k, k + 20) for k in (0, 20, 60, 80)]
        single = [shift(pixels[first][part], pixels[second][part])[0] for part in parts]
        print(f"    four parts of the clutter: {np.mean(single):+.3f} +- {np.std(single, ddof=1) / 2:.3f}")
    both, cross = shifts["VV HH"][1], shifts["HV VH"][1]
    print(f"  V receives {0.5 * (both + cross):+.3f} pixel late, V transmits {0.5 * (both - cross):+.3f}")


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


if __name__ == "__main__":
    {"coral": coral, "gecoris": gecoris, "alos": alos}[sys.argv[1]]()
