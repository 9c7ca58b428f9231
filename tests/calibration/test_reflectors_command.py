"""`warpsar reflectors` from files to files: products that are made, with reflectors of known cross-section."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from product_files import SITE, Band, ground_near, ground_range, nearest, write_safe
from sicd_files import write_rgzero
from stacks import gamma_image, image, safe_stack

import warpsar
from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.report import predicted_power
from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.formats import sentinel1

HEADER = "id,latitude_deg,longitude_deg,height_m,azimuth_deg,tilt_deg,shape,leg_m\n"
PLACE = ",".join(map(str, SITE))


def sites(folder: Path, *lines: str) -> Path:
    path = folder / "sites.csv"
    path.write_text(HEADER + "\n".join(lines or (f"CR1,{PLACE},262,3.3,triangular,1.0",)) + "\n")
    return path


def test_one_reflector_on_one_date(tmp_path: Path) -> None:
    """36 dBsm, a tenth of a line and two tenths of a pixel off: within three errors of clutter."""
    safe_stack(tmp_path, [36.0], (0.1, 0.2))
    result = warpsar.reflectors(next(tmp_path.glob("*.SAFE")), sites(tmp_path), engine=False)
    (one,) = result.observations
    assert one.status == "measured"
    assert one.point is not None
    assert one.expected is not None
    assert one.offset_m is not None
    assert one.spacing_m is not None
    assert one.difference_sd_db is not None
    assert 10 * np.log10(one.point.rcs_m2) == pytest.approx(36.0, abs=3 * one.difference_sd_db)
    for found, put, sd in zip(
        one.offset_m, (0.1 * one.spacing_m[0], 0.2 * one.spacing_m[1]), one.point.position_sd_m, strict=True
    ):
        assert abs(found - put) < 4 * sd
    assert one.expected.slant_range_m == pytest.approx(nearest(SITE)[1], abs=1e-3)
    facing = Facing(262.0, 3.3)
    predicted = trihedral_rcs_m2("triangular", 1.0, facing, one.expected.toward_radar, 299792458.0 / 5.405e9)
    assert one.predicted_m2 == pytest.approx(float(predicted))
    assert one.difference_db == pytest.approx(10 * np.log10(one.point.rcs_m2 / float(predicted)))
    assert one.noise_db == pytest.approx(10 * np.log10(6.0 / 300.0**2), abs=1e-6)
    assert one.point.quality is not None
    assert one.point.quality[1].width_m == pytest.approx(0.886 * 299792458.0 / 2 / 48e6, rel=0.1)
    assert result.rows()[0]["id"] == "CR1"


@pytest.mark.full
def test_a_stack_in_files(tmp_path: Path) -> None:
    """A step of 6 dB, a date on which it is gone; the engine predicts; CSV, JSON and a page say it."""
    safe_stack(tmp_path, [36.0, 36.0, 36.0, -20.0, 30.0, 30.0, 30.0, 30.0])
    products = sorted(map(str, tmp_path.glob("*.SAFE")))
    table = sites(tmp_path)
    out = tmp_path / "out"
    run = CliRunner().invoke(main, ["reflectors", *products, "--sites", str(table), "-o", str(out), "--device", "cpu"])
    assert run.exit_code == 0, run.output
    with (out / "reflectors.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["measured"] * 3 + ["not seen"] + ["measured"] * 4
    for row, level in zip(rows, [36.0] * 3 + [None] + [30.0] * 4, strict=True):
        if level is not None:
            assert abs(float(row["rcs_dbsm"]) - level) < 1.5
            assert float(row["predicted_dbsm"]) == pytest.approx(float(row["closed_form_dbsm"]), abs=1.0)
    assert float(rows[3]["rcs_high_dbsm"]) < 25.0
    found = json.loads((out / "reflectors.json").read_text())
    causes = {one["cause"]: one for one in found["explanation"]["causes"]}
    best = found["explanation"]["causes"][0]
    assert best["cause"] == "step of CR1"
    fall = best["parameters"]["after [dB]"]["value"] - best["parameters"]["before [dB]"]["value"]
    assert fall == pytest.approx(-6.0, abs=1.0)
    assert causes["step of CR1"]["bic"] < causes["calibration constant"]["bic"] - 10.0
    assert [one["date"] for one in found["explanation"]["bad_dates"]] == ["2024-04-10"]
    page = (out / "report.html").read_text()
    for words in ("In short", "RCS over time", "What the difference means", "Cut-outs", "All values", "2024-04-10"):
        assert words in page


def test_gamma_says_no_radiometry(tmp_path: Path) -> None:
    path = gamma_image(tmp_path, 36.0, 51.4691)
    (one,) = warpsar.reflectors(path, sites(tmp_path), engine=False).observations
    assert one.status == "no calibration"
    assert one.difference_db is None
    (one,) = warpsar.reflectors(path, sites(tmp_path), engine=False, radiometry="sigma0").observations
    assert one.status == "measured"
    assert one.point is not None
    assert 10 * np.log10(one.point.rcs_m2) == pytest.approx(36.0, abs=0.7)


def test_pixels_that_no_radar_makes_are_masked_or_saturated(tmp_path: Path) -> None:
    """Power below zero, nothing but zeros, a hole of NaN, and the largest float."""
    broken = {"negative": "masked", "zero": "masked", "hole": "masked", "huge": "saturated", "good": "measured"}
    statuses = {}
    for name in broken:
        folder = tmp_path / name
        folder.mkdir()
        path = gamma_image(folder, 36.0, 51.4691)
        power = np.fromfile(path, ">f4").reshape(Band().lines, Band().pixels)
        line, pixel = (round(at) for at in Band().centre)
        if name == "negative":
            power = -power
        elif name == "zero":
            power = 0 * power
        elif name == "hole":
            power[line, pixel] = np.nan
        elif name == "huge":
            power[line, pixel] = np.finfo(np.float32).max
        power.astype(">f4").tofile(path)
        (one,) = warpsar.reflectors(path, sites(tmp_path), engine=False, radiometry="sigma0").observations
        statuses[name] = one.status
    assert statuses == broken


def test_what_cannot_be_measured_is_one_line_and_the_others_go_on(tmp_path: Path) -> None:
    """Outside, without orbit, without calibration, masked, saturated: each its status; the good one is measured."""
    good, bare, lost, masked, loud = (tmp_path / name for name in ("good", "bare", "lost", "masked", "loud"))
    for folder in (good, bare, lost, masked, loud):
        folder.mkdir()
    clean = image([(128.3, 127.6, 36.0)], 0)
    holed, bright = clean.copy(), clean.copy()
    holed[120:137, 120:137] = 0
    bright[128, 128] = 40000 / 300.0
    paths = [
        write_safe(good, clean, beta_lut=300.0),
        write_safe(bare, clean, beta_lut=300.0, calibration=False, day="2024-03-06"),
        write_safe(lost, clean, beta_lut=300.0, orbit=False, day="2024-03-07"),
        write_safe(masked, holed, beta_lut=300.0, day="2024-03-08"),
        write_safe(loud, np.clip(bright.real, -109, 109.3) + 1j * bright.imag, beta_lut=300.0, day="2024-03-09"),
    ]
    table = sites(tmp_path, f"CR1,{PLACE},262,3.3,triangular,1.0", "FAR,47.5,12,250,262,3.3,triangular,1.0")
    out = tmp_path / "out"
    words = ["reflectors", *map(str, paths), "--sites", str(table), "-o", str(out), "--closed-form"]
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 0, run.output
    with (out / "reflectors.csv").open() as file:
        rows = list(csv.DictReader(file))
    own = {row["date"][:10]: row["status"] for row in rows if row["id"] == "CR1"}
    assert own == {
        "2024-03-05": "measured",
        "2024-03-06": "no calibration",
        "2024-03-07": "no orbit",
        "2024-03-08": "masked",
        "2024-03-09": "saturated",
    }
    assert [row["status"] for row in rows if row["id"] == "FAR"] == ["outside"] * 2 + ["no orbit"] + ["outside"] * 2
    for word in ("masked", "saturated", "no calibration", "no state vectors", "FAR"):
        assert word in run.output
    said = [line for line in run.output.splitlines() if line.startswith("warning: ")]
    assert len(said) == sum(row["status"] != "measured" for row in rows)  # one line each
    assert (out / "sites_isce3.csv").read_text().count("\n") == 3


def test_products_that_cannot_be_opened_are_named(tmp_path: Path) -> None:
    (good,) = safe_stack(tmp_path, [36.0])
    broken = tmp_path / "broken.SAFE"
    shutil.copytree(good, broken)
    next((broken / "annotation").glob("*.xml")).write_text("<product>")
    result = warpsar.reflectors([good, broken, tmp_path / "gone.h5"], sites(tmp_path), engine=False)
    assert len(result.observations) == 1
    assert "broken.SAFE" in result.refused[0]
    assert "gone.h5: no such file" in result.refused[1]
    with pytest.raises(InputError, match=r"no product can be measured:\n.*not readable as XML"):
        warpsar.reflectors([broken], sites(tmp_path))
    (tmp_path / "empty.SAFE").mkdir()
    with pytest.raises(InputError, match=r"empty.SAFE: found a folder without annotation/; must be a SAFE folder"):
        warpsar.reflectors([tmp_path / "empty.SAFE"], sites(tmp_path))
    plain = tmp_path / "a.npy"
    np.save(plain, np.ones((3, 3)))
    with pytest.raises(InputError, match="says no orbit; must be one of capella, gamma, nisar, sentinel1"):
        warpsar.reflectors([plain], sites(tmp_path))
    inside = good / "measurement" / "a.npy"
    inside.parent.mkdir(exist_ok=True)
    np.save(inside, np.ones((3, 3)))
    with pytest.raises(InputError, match=f"it lies in a SAFE folder, which says it: name {good}$"):
        warpsar.reflectors([inside], sites(tmp_path))


def test_a_file_that_is_cut_off_or_absurd_is_one_line_and_the_others_go_on(tmp_path: Path) -> None:
    (good,) = safe_stack(tmp_path, [36.0])

    def broken(name: str, pattern: str, old: str, new: str) -> Path:
        made = tmp_path / f"{name}.SAFE"
        shutil.copytree(good, made)
        (path,) = made.glob(pattern)
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        return made

    cut = tmp_path / "cut.SAFE"
    shutil.copytree(good, cut)
    (image_file,) = (cut / "measurement").glob("*.tiff")
    image_file.write_bytes(image_file.read_bytes()[:40000])
    annotation, table = "annotation/*.xml", "annotation/calibration/calibration*.xml"
    absurd = [
        broken("line", annotation, "<azimuthTimeInterval>0.002", "<azimuthTimeInterval>0"),
        broken("band", annotation, "<lookBandwidth>400.0", "<lookBandwidth>0"),
        broken("window", annotation, "<windowCoefficient>1.0", "<windowCoefficient>0"),
        broken("beta", table, "300.0 300.0", "0 0"),
    ]
    result = warpsar.reflectors([good, cut, *absurd], sites(tmp_path), engine=False)
    assert [one.status for one in result.observations] == ["measured", "no image"]
    assert "not a readable GeoTIFF" in result.observations[1].reason
    words = ("time between lines [s]: found 0", "bandwidth in azimuth [Hz]: found 0", "window in range", "betaNought")
    assert [word in said for word, said in zip(words, result.refused, strict=True)] == [True] * 4
    searched = tmp_path / "searched.csv"
    searched.write_text(HEADER.strip() + f",search_m\nCR1,{PLACE},262,3.3,triangular,1.0,100\n")
    result = warpsar.reflectors(cut, searched, engine=False)
    assert "no image shows the box that is searched: " in result.refused[0]
    assert "not a readable GeoTIFF" in result.refused[0]


def test_a_reflector_that_no_product_shows_is_named(tmp_path: Path) -> None:
    """A height above the sea: 50 m move it by 31 m in slant range, beyond what is allowed."""
    (good,) = safe_stack(tmp_path, [36.0])
    low = sites(tmp_path, f"CR1,{SITE[0]},{SITE[1]},{SITE[2] + 50.0},262,3.3,triangular,1.0")
    result = warpsar.reflectors(good, low, engine=False)
    assert [one.status for one in result.observations] == ["not seen"]
    assert "a height above the sea instead of the ellipsoid" in result.refused[0]


def test_products_on_another_grid_are_refused_with_the_reason(tmp_path: Path) -> None:
    """A broken SICD, and GAMMA's ground range: one line each, and the others go on."""
    (good,) = safe_stack(tmp_path, [36.0])
    sicd, ground = tmp_path / "a.nitf", gamma_image(tmp_path, 36.0, 51.4691)
    sicd.write_bytes(b"NITF02.10" + bytes(400))
    par = ground.with_name(ground.name + ".par")
    par.write_text(par.read_text().replace("SLANT_RANGE", "GROUND_RANGE"))
    result = warpsar.reflectors([sicd, ground, good], sites(tmp_path), engine=False)
    assert [one.status for one in result.observations] == ["measured"]
    assert "SICD file" in result.refused[0]
    assert "found GROUND_RANGE; must be SLANT_RANGE: the file's polynomials" in result.refused[1]
    assert not any("\n" in words for words in result.refused)


def test_what_is_asked_is_checked(tmp_path: Path) -> None:
    table = sites(tmp_path)
    for more, message in [
        ({"polarization": "XX"}, "polarization: found 'XX'"),
        ({"radiometry": "nu0"}, "radiometry: found 'nu0'"),
        ({"window_cells": 0.1}, "window_cells: found 0.1"),
        ({"allowance_m": (-1.0, 5.0)}, "allowance_m"),
    ]:
        with pytest.raises(InputError, match=message):
            warpsar.reflectors([], table, **more)
    with pytest.raises(InputError, match="no product given"):
        warpsar.reflectors([], table)


def test_an_open_product_is_taken_and_a_date_before_the_set_up_is_marked(tmp_path: Path) -> None:
    (path,) = safe_stack(tmp_path, [-20.0])
    product = sentinel1.products(path, None)[0]
    table = tmp_path / "sites.csv"
    table.write_text(HEADER.strip() + ",from\n" + f"CR1,{PLACE},262,3.3,triangular,1.0,2024-06-01\n")
    result = warpsar.reflectors(product, table, engine=False)
    (one,) = result.observations
    assert (one.status, one.stands) == ("not seen", False)
    assert np.ptp(predicted_power(one)) == 0.0  # clutter alone
    assert result.explanation.bad_dates == ()
    assert result.geolocation is None


def test_a_reflector_near_the_edge(tmp_path: Path) -> None:
    (path,) = safe_stack(tmp_path, [36.0])
    product = sentinel1.products(path, None)[0]
    edge = product.to_ground(2.0, 100.0, 250.0)
    line = f"E,{edge[0]:.9f},{edge[1]:.9f},250,,,,"
    (one,) = warpsar.reflectors(product, sites(tmp_path, line), engine=False).observations
    assert one.status == "too near the edge"


def test_a_reflector_in_a_sicd(tmp_path: Path) -> None:
    """36 dBsm; numbers are beta0's over 4, which the header's factor says."""
    path = write_rgzero(tmp_path, image([(*Band().centre, 36.0)], 0) / 2.0, beta_factor=4.0)
    table = tmp_path / "sites.csv"
    table.write_text(f"id,latitude_deg,longitude_deg,height_m\nCR1,{SITE[0]},{SITE[1]},{SITE[2]}\n")
    (one,) = warpsar.reflectors(path, table, engine=False).observations
    assert one.status == "measured", one.reason
    assert one.point is not None
    assert one.difference_sd_db is None or one.difference_sd_db < 0.5
    assert 10 * np.log10(one.point.rcs_m2) == pytest.approx(36.0, abs=0.7)
    assert (one.point.line, one.point.pixel) == pytest.approx(Band().centre, abs=0.15)
    assert one.noise_db == pytest.approx(10 * np.log10(0.01 * 4.0), abs=1e-6)


def test_a_reflector_in_a_grd(tmp_path: Path) -> None:
    """Detected, in ground range, with calibration and noise: a pixel is shorter on the slant plane."""
    band = Band(range_hz=30e6, azimuth_hz=240.0)
    slope = np.polynomial.polynomial.polyder(ground_range(ground_near(band), band)[0])
    slant_m = band.step_m * float(np.polynomial.polynomial.polyval(band.centre[1] * band.step_m, slope))
    assert slant_m == pytest.approx(band.step_m * np.sin(np.deg2rad(51.47)), rel=0.01)
    made = image([(*band.centre, 36.0)], 0, replace(band, step_m=slant_m))
    path = write_safe(tmp_path, made, band, beta_lut=300.0, ground=True)
    (one,) = warpsar.reflectors(path, sites(tmp_path), engine=False).observations
    assert one.status == "measured", one.reason
    assert one.point is not None
    assert one.expected is not None
    assert (one.expected.line, one.expected.pixel) == pytest.approx(band.centre, abs=1e-3)
    assert (one.point.line, one.point.pixel) == pytest.approx(band.centre, abs=0.3)
    assert one.spacing_m is not None
    assert one.spacing_m[1] == pytest.approx(slant_m, rel=1e-3)
    assert one.difference_sd_db is not None
    assert 10 * np.log10(one.point.rcs_m2) == pytest.approx(36.0, abs=3 * one.difference_sd_db)
    assert one.noise_db == pytest.approx(10 * np.log10(6.0 / 300.0**2), abs=1e-6)


@pytest.mark.full
def test_later_dates_are_held_back(tmp_path: Path) -> None:
    """Eight dates of 36 dBsm, of which the last, of 30, decides nothing; its value lies outside what was foretold."""
    safe_stack(tmp_path, [36.0] * 7 + [30.0])
    products = sorted(map(str, tmp_path.glob("*.SAFE")))
    out = tmp_path / "out"
    words = ["reflectors", *products, "--sites", str(sites(tmp_path)), "-o", str(out), "--closed-form", "--hold-back"]
    for wrong, said in (("soon", "must be a date"), ("2020-01-01", "must be after 2024-03-05")):
        run = CliRunner().invoke(main, [*words, wrong])
        assert (run.exit_code, said in run.output, out.exists()) == (2, True, False)
    run = CliRunner().invoke(main, [*words, "2024-05-10"])
    assert run.exit_code == 0, run.output
    found = json.loads((out / "reflectors.json").read_text())
    assert found["held_back"]["since"] == "2024-05-10"
    assert [one["inside"] for one in found["held_back"]["values"]] == [True, False]
    assert found["explanation"]["values"] == 6
    assert found["explanation"]["bad_dates"] == []
    assert "Held back: dates from 2024-05-10 on" in (out / "report.html").read_text()


def test_two_reflectors_in_one_window_are_not_told_apart(tmp_path: Path) -> None:
    """Three pixels apart, 2.4 cells: neither has an RCS; 12 pixels apart both look at the brighter one's peak."""
    line, pixel = Band().centre
    path = write_safe(tmp_path, image([(line, pixel, 36.0), (line, pixel + 5, 33.0)], 9), beta_lut=300.0)
    product = sentinel1.products(path, None)[0]

    def statuses(pixels: float, allowance: float) -> list[tuple[str, str]]:
        other = product.to_ground(line, pixel + pixels, SITE[2])
        near = f"CR2,{other[0]:.9f},{other[1]:.9f},{SITE[2]},,,,"
        table = sites(tmp_path, f"CR1,{PLACE},262,3.3,triangular,1.0", near)
        found = warpsar.reflectors(product, table, engine=False, allowance_m=(15.0, allowance)).observations
        return [(one.status, one.reason) for one in found]

    first, second = statuses(3.0, 5.0)
    assert first[0] == second[0] == "not apart"
    assert "CR2 is expected 0.0 cells away in azimuth and 2.4 in slant range" in first[1]
    first, second = statuses(5.0, 15.0)
    assert (first[0], second[0]) == ("measured", "not apart")
    assert "its brightest point is CR1's" in second[1]
    assert [status for status, _ in statuses(5.0, 5.0)] == ["measured", "measured"]
    # ISCE3's table has a device of two attitudes twice
    assert [status for status, _ in statuses(0.0, 5.0)] == ["measured", "measured"]


def test_a_product_that_is_named_twice_is_one(tmp_path: Path) -> None:
    (path,) = safe_stack(tmp_path, [36.0])
    result = warpsar.reflectors([path, path / "manifest.safe"], sites(tmp_path), engine=False)
    assert len(result.observations) == 1
    assert "named twice" in result.refused[0]


def test_a_reflector_that_faces_away_is_named(tmp_path: Path) -> None:
    """Its azimuth counted from another direction: measured, not predicted, and one line says why."""
    (path,) = safe_stack(tmp_path, [36.0])
    result = warpsar.reflectors(path, sites(tmp_path, f"CR1,{PLACE},82,3.3,triangular,1.0"), engine=False)
    assert result.observations[0].predicted_m2 in (None, 0.0)
    (said,) = [words for words in result.explanation.words if "CR1" in words]
    assert "the radar stands at 2" in said
    assert "azimuth 82" in said
