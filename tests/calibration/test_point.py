"""Point targets that are made with NumPy: place, cross-section, interval and response."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ncx2

from warpsar.calibration.point import PointSettings, ResponseAxis, interval, measure_point

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
from reflectors_simulated import BANDWIDTH, CENTRE, SEARCH, SPACING_M, chips

pytestmark = pytest.mark.unit


def axes(hamming: float = 1.0) -> tuple[ResponseAxis, ResponseAxis]:
    return ResponseAxis(BANDWIDTH[0], hamming), ResponseAxis(BANDWIDTH[1], hamming)


@pytest.mark.parametrize("hamming", [1.0, 0.75])
def test_a_point_without_clutter(hamming: float) -> None:
    """40 dB and more over clutter: RCS by integral and by peak, place, and the response's width and sidelobes."""
    rng = np.random.default_rng(0)
    chip, rcs, place = chips(rng, 1e7, (hamming, hamming))
    found = measure_point(chip, CENTRE, SEARCH, SPACING_M, axes(hamming))
    assert 10 * np.log10(found.rcs_m2 / rcs) == pytest.approx(0.0, abs=0.03)
    assert 10 * np.log10(found.peak_rcs_m2 / rcs) == pytest.approx(0.0, abs=0.03)
    assert (found.line, found.pixel) == pytest.approx(place, abs=0.01)
    assert found.quality is not None
    # 0.886 of a cell, -13.26 dB; under Hamming 0.75 (a raised cosine on a pedestal) 1.0 of a cell.
    width = {1.0: 0.8859, 0.75: 1.0035}[hamming]
    for axis, band in zip(found.quality, BANDWIDTH, strict=True):
        assert axis.width_m * band == pytest.approx(width, rel=0.01)
    if hamming == 1.0:
        assert found.quality[1].pslr_db == pytest.approx(-13.26, abs=0.2)
        assert found.quality[1].islr_db == pytest.approx(-9.9, abs=0.4)  # sinc^2 up to 10 cells


def test_a_spectrum_that_lies_elsewhere_changes_nothing() -> None:
    """A Doppler centroid of a third of the sampling rate: samples are turned from line to line."""
    rng = np.random.default_rng(1)
    chip, _, place = chips(rng, 1e6, (1.0, 1.0))
    turned = chip * np.exp(1j * 2.1 * np.arange(chip.shape[0]))[:, None]
    plain, found = (measure_point(one, CENTRE, SEARCH, SPACING_M, axes()) for one in (chip, turned))
    assert found.rcs_m2 == pytest.approx(plain.rcs_m2, rel=2e-3)
    assert found.line == pytest.approx(place[0], abs=0.01)
    assert plain.phase_deg is not None
    assert found.phase_deg is not None


def test_the_phase_is_the_points() -> None:
    lines, pixels = (np.arange(64) - 32.0 for _ in range(2))
    cuts = [np.sinc(at * step * band) for at, step, band in zip((lines, pixels), SPACING_M, BANDWIDTH, strict=True)]
    chip = np.exp(1j * np.deg2rad(73.0)) * cuts[0][:, None] * cuts[1] + 1e-4
    found = measure_point(chip, CENTRE, SEARCH, SPACING_M, axes())
    assert found.phase_deg == pytest.approx(73.0, abs=0.2)


@pytest.mark.full
def test_bias_and_coverage_at_20_db() -> None:
    """200 draws: the mean is right within three standard errors, and 90 % intervals hold in 84 to 96 % (3 sigma)."""
    rng = np.random.default_rng(5)
    ratio, covered = [], []
    for _ in range(200):
        chip, rcs, _ = chips(rng, 100.0, (0.75, 0.75))
        found = measure_point(chip, CENTRE, SEARCH, SPACING_M, axes(0.75))
        ratio.append(found.rcs_m2 / rcs)
        covered.append(found.low_m2 <= rcs <= found.high_m2)
        assert found.seen
    assert np.mean(ratio) == pytest.approx(1.0, abs=3 * np.std(ratio) / np.sqrt(200))
    assert 0.84 <= np.mean(covered) <= 0.96


@pytest.mark.full
@pytest.mark.parametrize("detected", [False, True])
def test_places_scatter_as_stated_at_10_db(detected: bool) -> None:
    """150 draws, also those whose peak is clutter's: scatter over the stated error within 0.6 to 1.25 on both axes.

    By the bound of a high SCR alone it is 2.2 and 3.6 here, and 2.3 and 4.2 for detected images.
    """
    rng = np.random.default_rng(3)
    whole = tuple(ResponseAxis(b, 1.0, s if detected else 0.0) for b, s in zip(BANDWIDTH, SPACING_M, strict=True))
    off = []
    for _ in range(150):
        chip, _, place = chips(rng, 10.0, (1.0, 1.0))
        found = measure_point(np.abs(chip) ** 2 if detected else chip, CENTRE, SEARCH, SPACING_M, (whole[0], whole[1]))
        if found.seen:
            ends = zip((found.line, found.pixel), place, SPACING_M, found.position_sd_m, strict=True)
            off.append([(at - true) * step / sd for at, true, step, sd in ends])
    scatter = np.std(off, axis=0)
    assert ((scatter > 0.6) & (scatter < 1.25)).all(), scatter


def test_the_place_of_a_strong_point_has_the_published_bound() -> None:
    """sqrt(3 / (2 pi^2 SCR)) cells (Bamler and Eineder 2005), and 1.7 / SCR more in variance where it is low."""
    axis = ResponseAxis(0.5)
    for scr in (100.0, 1e3, 1e5):
        bound = 2.0 * np.sqrt(3.0 / (2.0 * np.pi**2 * scr))
        assert axis.peak_sd_m(scr) == pytest.approx(bound * np.sqrt(1.0 + 1.2 / scr), rel=2e-3)


def test_clutter_alone_is_not_seen() -> None:
    """Of 60 draws of speckle without a point at most 3 are called seen (1 % each is allowed: 3 or more has 2 %)."""
    rng = np.random.default_rng(6)
    seen = 0
    for _ in range(60):
        chip, _, _ = chips(rng, 1e-6, (1.0, 1.0))
        found = measure_point(chip, CENTRE, SEARCH, SPACING_M, axes())
        seen += found.seen
        assert found.high_m2 > 0.0
    assert seen <= 3


def test_a_detected_image_has_the_same_cross_section() -> None:
    rng = np.random.default_rng(7)
    whole = tuple(ResponseAxis(b, 1.0, s) for b, s in zip(BANDWIDTH, SPACING_M, strict=True))
    ratio = []
    for _ in range(20):
        chip, rcs, place = chips(rng, 1e5, (1.0, 1.0))
        found = measure_point(np.abs(chip) ** 2, CENTRE, SEARCH, SPACING_M, (whole[0], whole[1]))
        ratio.append(found.rcs_m2 / rcs)
        assert found.phase_deg is None
        assert (found.line, found.pixel) == pytest.approx(place, abs=0.35)
    # Whole pixels about the brightest one: the share is a mean over where in its pixel the point lies.
    assert 10 * np.log10(np.mean(ratio)) == pytest.approx(0.0, abs=0.1)


def test_a_wider_window_holds_a_known_share() -> None:
    """int sinc^2 from -1 to 1 is 0.9028; to 2 it is 0.9499 (tables of Si)."""
    axis = ResponseAxis(0.5)
    assert axis.share(2.0) == pytest.approx(0.9028, abs=1e-4)
    assert axis.share(4.0) == pytest.approx(0.9499, abs=1e-4)
    assert axis.cell_m == pytest.approx(2.0)
    assert axis.peak_m == pytest.approx(2.0)
    at = np.linspace(-400.0, 400.0, 2001)
    assert np.trapezoid(ResponseAxis(0.5, 0.75).power_1_m(at), at) == pytest.approx(1.0, abs=2e-3)


def test_the_interval_has_the_variance_of_its_own_ends() -> None:
    """At either end T the estimate is z standard deviations off, with the variance 2 T q + v that T has."""
    low, high = interval(100.0, 2.0, 50.0, 1.6449)
    for end in (low, high):
        assert abs(100.0 - end) == pytest.approx(1.6449 * np.sqrt(2 * end * 2.0 + 50.0), rel=1e-9)
    least = interval(-np.sqrt(50.0), 2.0, 50.0, 1.6449)[1]
    assert interval(-300.0, 2.0, 50.0, 1.6449) == (0.0, least)
    assert least > 2.0


def test_the_interval_has_the_skew_of_power() -> None:
    """Noncentral chi-squared of m cells and a target of T, in cells: either end leaves 5 % beyond (1 % by Cornish and
    Fisher's first term), where a symmetric one leaves 7 and 3."""
    cells, at = 16.0, 20.0
    beyond = []
    for target, side in ((at, 0), (at, 1)):
        third = 6.0, 2.0 * cells
        end = interval(target, 1.0, cells, 1.6449, third)[side]
        energy = ncx2(2.0 * cells, 2.0 * end)  # twice the energy over a cell's clutter
        chance = energy.cdf(2.0 * (target + cells))
        beyond.append(min(chance, 1.0 - chance))
    assert beyond == pytest.approx([0.05, 0.05], abs=0.005)


def test_settings_are_stated() -> None:
    assert (PointSettings.window_cells, PointSettings.confidence) == (2.0, 0.9)
