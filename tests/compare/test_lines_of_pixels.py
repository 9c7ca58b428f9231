"""Rows and columns that vary otherwise than the model: ripples, lines, seams; and how often speckle alone does."""

from dataclasses import replace

import numpy as np
import pytest
from comparisons import comparison
from scipy.stats import chi2

from warpsar.compare.comparison import Comparison
from warpsar.compare.judgement import SHARE, WINDOW_DB, judge
from warpsar.compare.profiles import BANDS, TOGETHER, Profiles

SHAPE = (72, 84)
ROWS, COLS = np.mgrid[: SHAPE[0], : SHAPE[1]]
GRANTED = 10.0 ** (WINDOW_DB / 10.0) - 1.0
WHITE = np.array([[1.0]])


def images_of(factor: np.ndarray | float = 1.0, looks: float = 4.0, views: int = 4, seed: int = 0) -> list[Comparison]:
    """White speckle about a level of 0.1, times a factor that the model does not know."""
    random = np.random.default_rng([seed, views])
    return [
        comparison(0.1 * factor * random.gamma(looks, 1.0 / looks, SHAPE), 0.1, looks, name=f"v{k}")
        for k in range(views)
    ]


def ripple_db(depth: float, period: float, along: np.ndarray) -> np.ndarray:
    return 10.0 ** (depth * np.sin(2.0 * np.pi * along / period) / 10.0)


@pytest.mark.full
@pytest.mark.parametrize(("along", "axis"), [(ROWS, "range"), (COLS, "azimuth")])
def test_a_ripple_that_is_in_no_window_is_found_with_its_size(along: np.ndarray, axis: str) -> None:
    """0.45 dB about a period of 14 pixels: 0.32 dB rms."""
    found = judge(images_of(ripple_db(0.45, 14.0, along)))
    assert "structure" in found.findings
    assert found.p_window > SHARE
    assert found.p_profile < 1e-6
    assert (found.profile.image, found.profile.axis) == (TOGETHER, axis)
    # one wave in 24,000 pixels of 4 looks: an error of 1 % of the power, 0.04 dB
    assert found.profile.rms_db == pytest.approx(0.45 / np.sqrt(2.0), abs=0.06)
    assert f"power is off by {found.profile.rms_db:.2g} dB (rms) along {axis} in several images together" in found.words


@pytest.mark.parametrize("along", [ROWS, COLS])
def test_a_ripple_within_blocks_does_not_excuse_itself(along: np.ndarray) -> None:
    """0.94 dB about a period of 8.8 pixels: every block of 12 has it, and it scatters as texture does. Draws that have
    its correlation as speckle's had called it nothing."""
    found = judge(images_of(ripple_db(0.94, 8.8, along), looks=8.0, views=2))
    assert found.finding == "structure"
    assert found.p_profile < 1e-6


def test_a_faint_ripple_is_a_wave() -> None:
    """At one look 0.6 dB lies within the scatter of every row. Its wave holds 24,000 pixels: 10 standard deviations of
    their mean power, 7 beyond what is granted, and one of 100 waves is so by chance in 1e-9 cases."""
    images = images_of(ripple_db(0.6, 10.5, ROWS), looks=1.0)
    found = Profiles(images, WHITE).strongest([one.residual[one.usable] for one in images], GRANTED)
    assert found.surprise > 15.0
    assert found.rms_db == pytest.approx(0.6 / np.sqrt(2.0), abs=0.1)


@pytest.mark.full
def test_a_ripple_of_one_view_is_placed_there() -> None:
    images = images_of()
    two = images[2]
    images[2] = replace(two, seen=replace(two.seen, measured=two.measured * ripple_db(1.2, 20.0, ROWS)))
    found = judge(images)
    assert found.p_profile < SHARE
    assert (found.profile.image, found.profile.axis) == ("v2 HH", "range")


@pytest.mark.full
def test_what_is_granted_is_no_finding() -> None:
    """0.2 dB from band to band, in 64 looks: plain to see, and too little to matter."""
    found = judge(images_of(ripple_db(WINDOW_DB, 14.0, ROWS), looks=64.0))
    assert found.p_profile > SHARE
    assert found.profile.surprise == pytest.approx(0.0, abs=20.0)


def test_an_offset_within_what_is_granted_is_none_on_large_images() -> None:
    """0.19 dB in every pixel of 4 views of 256 x 256 pixels and 16 looks: ten standard deviations of a band."""
    random = np.random.default_rng(0)
    images = [
        comparison(0.1 * 10.0**0.019 * random.gamma(16.0, 1.0 / 16.0, (256, 256)), 0.1, 16.0, name=f"v{k}")
        for k in range(4)
    ]
    residuals = [one.residual[one.usable] for one in images]
    profiles = Profiles(images, WHITE)
    assert profiles.strongest(residuals, GRANTED).surprise < 5.0
    assert profiles.strongest(residuals, 1e-9).surprise > 500.0


def test_polarizations_of_a_view_are_not_summed() -> None:
    """They may share their speckle: two that are equal are as surprising as one."""
    images = images_of(ripple_db(0.3, 14.0, ROWS), views=1)
    twice = [images[0], replace(images[0], seen=replace(images[0].seen, polarization="VV"))]
    one, both = (
        Profiles(some, WHITE).strongest([i.residual[i.usable] for i in some], 1e-9) for some in (images, twice)
    )
    assert both.surprise == pytest.approx(one.surprise)


def test_images_of_edges_alone_have_no_level() -> None:
    slopes = np.full((2, *SHAPE), 5.0)
    image = comparison(0.1 * np.random.default_rng(0).gamma(4.0, 0.25, SHAPE), 0.1, 4.0, slopes=slopes)
    found = judge([image])
    assert not image.even.any()
    assert (found.p_level, found.finding) == (1.0, "cannot be told")
    assert found.content()["deviance_error"] is None


@pytest.mark.slow
def test_speckle_alone_is_seldom_a_profile() -> None:
    """Of 12, at most one falls under 2 %: two or more would come by chance in 2.5 % of all cases."""
    chances = [judge(images_of(seed=seed, views=2)).p_profile for seed in range(12)]
    assert sum(one < 0.02 for one in chances) <= 1


def test_a_smear_is_a_line() -> None:
    """Two rows of 40 pixels, 3.8 dB too bright, at one look: 9 standard deviations in a line, 3 in a square of 9."""
    factor = np.ones(SHAPE)
    factor[30:32, 20:60] = 2.4
    found = judge(images_of(factor, looks=1.0, views=1))
    assert found.p_window < SHARE
    assert (found.window.rows, found.window.columns) == (3, 33)
    assert abs(found.window.row - 30.5) <= 1.5


def test_bands_cuts_and_waves_are_sums_of_pixels_away_from_edges() -> None:
    """By hand: two images, and both together; pixels that are not even count nowhere."""
    images = images_of(views=2)
    rng = np.random.default_rng(3)
    residuals = [rng.standard_normal(int(one.usable.sum())) for one in images]
    expected = 0.0
    for group in ([0], [1], [0, 1]):
        for axis in (0, 1):
            sums, counts = np.zeros(SHAPE[axis]), np.zeros(SHAPE[axis])
            for k in group:
                full = np.zeros(SHAPE)
                full[images[k].usable] = residuals[k]
                sums += full.sum(axis=1 - axis)
                counts += (full != 0).sum(axis=1 - axis)
            for width in BANDS:
                starts = np.arange(0, SHAPE[axis], width)
                totals, pixels = np.add.reduceat(sums, starts), np.add.reduceat(counts, starts)
                squares = (totals**2 / (2.0 * np.maximum(pixels, 1.0)))[pixels >= 30]
                expected = max(expected, -chi2.logsf(squares.sum(), squares.size))
            cuts = []
            for cut in range(1, SHAPE[axis]):
                one, other = counts[:cut].sum(), counts[cut:].sum()
                if min(one, other) >= 30:
                    step = sums[:cut].sum() / one - sums[cut:].sum() / other
                    cuts.append(step**2 / (2.0 / one + 2.0 / other))
            expected = max(expected, -chi2.logsf(max(cuts), 1) - np.log(len(cuts)))
            used = np.flatnonzero(counts)
            line, span = np.arange(SHAPE[axis]), used[-1] - used[0] + 1
            waves = []
            for cycles in np.arange(1.0, span / 6.0 + 0.01, 0.5):
                for degrees in (0.0, 45.0, 90.0, 135.0):
                    wave = np.cos(2.0 * np.pi * cycles * line / span + np.radians(degrees))
                    wave -= np.average(wave, weights=counts)
                    waves.append((wave @ sums) ** 2 / (2.0 * (wave**2 @ counts)))
            expected = max(expected, -chi2.logsf(max(waves), 1) - np.log(len(waves)))
    profiles = Profiles(images, np.array([[2.0]]))
    assert profiles.largest([one[:, None] for one in residuals])[0] == pytest.approx(expected, rel=1e-5)
    assert profiles.strongest(residuals, 1e-9).surprise == pytest.approx(expected, rel=1e-5)
    assert profiles.strongest(residuals, GRANTED).surprise < expected


def test_lines_that_are_lost_and_a_seam_are_surprising() -> None:
    """At two looks: every ninth column at half its power, and one half of every image 0.9 dB brighter. Draws of speckle
    alone have a surprise of 5 in one of a hundred."""
    lost, seam = np.ones(SHAPE), np.full(SHAPE, 10.0**-0.045)
    lost[:, 4::9] = 0.5
    seam[:, SHAPE[1] // 2 :] = 10.0**0.045
    for factor in (lost, seam):
        images = images_of(factor, looks=2.0)
        found = Profiles(images, WHITE).strongest([one.residual[one.usable] for one in images], GRANTED)
        assert found.surprise > 20.0
        assert found.axis == "azimuth"
    assert found.rms_db == pytest.approx(0.9, abs=0.2)
