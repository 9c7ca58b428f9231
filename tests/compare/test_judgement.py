"""Is anything left beside speckle? False alarms at the declared rate, and no false all-clear."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparisons import comparison
from learning_scenes import TRUTH, cube_scene, measured, noise_free, starting, views_at
from scipy.ndimage import gaussian_filter
from worlds import view

from warpsar.compare import judgement as module
from warpsar.compare.comparison import Comparison
from warpsar.compare.edges import edges_of
from warpsar.compare.judgement import ERROR_RATE, SHARE, judge, level_within
from warpsar.compare.modelled import known_by_rays, ray_variance
from warpsar.evaluation.command import evaluate
from warpsar.runtime.distributed.travel import packed, unpacked
from warpsar.scene.scene import Scene
from warpsar.speckle.law import Law
from warpsar.speckle.own import Patch, own_autocovariance
from warpsar.speckle.residual import residual_autocovariance

SIDE = 40
PIXEL_M = 0.5
ROWS, COLS = np.mgrid[:SIDE, :SIDE]
EDGE = (ROWS > 2) & (ROWS < SIDE - 3) & (COLS > 2) & (COLS < SIDE - 3)
SHADOW = (np.abs(COLS - 20) < 5) & (ROWS > 13) & (ROWS < 26)
MODELLED = np.where(COLS > 20, 0.1, 0.02)


def speckle(random: np.random.Generator, looks: float, sigma: float) -> np.ndarray:
    """The mean of `looks` intensities of circular Gaussian fields, each blurred by `sigma` pixels: gamma, of mean 1."""
    if sigma == 0:
        return random.gamma(looks, 1.0 / looks, (SIDE, SIDE))
    total = np.zeros((SIDE + 20, SIDE + 20))
    for _ in range(int(looks)):
        total += sum(gaussian_filter(random.normal(size=total.shape), sigma, mode="wrap") ** 2 for _ in range(2))
    # the variance of a blurred unit field is the sum of the kernel's squares: twice, over real and imaginary part
    kernel = gaussian_filter(np.eye(1, total.size).reshape(total.shape), sigma, mode="wrap")
    return total[10:-10, 10:-10] / (2.0 * looks * np.sum(kernel**2))


def one(image: np.ndarray, looks: float, name: str = "v0", interior: np.ndarray = EDGE & ~SHADOW) -> Comparison:
    return comparison(image, MODELLED, looks, name=name, interior=interior)


def several(seed: int, looks: float = 16.0, sigma: float = 0.0, views: int = 3) -> list[Comparison]:
    random = np.random.default_rng([seed, int(looks), int(10 * sigma)])
    return [one(MODELLED * speckle(random, looks, sigma), looks, f"v{k}") for k in range(views)]


def with_looks(image: Comparison, looks: float, **more: Any) -> Comparison:
    return replace(image, seen=replace(image.seen, looks=looks, **more))


# ---- false alarms ----


@pytest.mark.full
@pytest.mark.parametrize("sigma", [0.0, 0.7])
@pytest.mark.parametrize("looks", [1.0, 4.0, 16.0])
def test_speckle_alone_is_speckle(looks: float, sigma: float) -> None:
    """At a rate of 0.01, two alarms or more in five scenes come by chance in 0.1 % of all cases."""
    found = [judge(several(seed, looks, sigma)).finding for seed in range(5)]
    assert len(found) - found.count("speckle") <= 1


ROOF = (ROWS > 5) & (ROWS < 25) & (COLS > 22) & (COLS < 37)


@pytest.mark.parametrize(("looks", "sigma"), [(1.0, 0.0), (1.0, 0.7), (16.0, 0.0)])
def test_the_level_of_a_part_is_that_of_speckle(looks: float, sigma: float) -> None:
    """At a rate of 1 in 800 two alarms in 8 come by chance in 0.004 % of all cases. A part that is modelled 6 dB too
    bright stands out, though a scan of the residual hardly sees what is dark at one look."""
    alarms = 0
    for seed in range(8):
        images = several(seed, looks, sigma, views=2)
        found = judge(images)
        level = level_within(images, [ROOF, ROOF], found)
        assert level is not None
        alarms += level.p < SHARE
        if seed < 2:
            bright = [replace(one, simulated=np.where(ROOF, 4.0 * one.simulated, one.simulated)) for one in images]
            wrong = level_within(bright, [ROOF, ROOF], found)
            assert wrong is not None
            assert wrong.p < SHARE
    assert alarms <= 1


def test_no_level_is_told_where_no_pixel_is_even() -> None:
    images = several(0)
    assert level_within(images, [~EDGE] * 3, judge(images)) is None


@pytest.mark.slow
def test_p_values_of_speckle_are_spread_evenly() -> None:
    found = [judge(several(seed)) for seed in range(20)]
    # the share under a half of 20 has a standard deviation of 0.11
    assert np.mean([one.p_window < 0.5 for one in found]) == pytest.approx(0.5, abs=0.35)
    assert np.mean([one.p_level < 0.5 for one in found]) < 0.8


# ---- what rays leave open ----


def test_what_two_sets_of_rays_tell_of_a_pixel() -> None:
    """A corner that both know to 4 % leaves the ground beside it as it is. Power that falls into one pixel or the next
    by chance is known in neither, nor in one between them where both sets happen to have the same."""
    one = np.full((9, 18), 0.02)
    other = one.copy()
    one[4, 4], other[4, 4] = 1e3, 1.04e3
    one[4, 12], other[4, 13] = 0.1, 0.1
    variance = ray_variance(one, other)
    assert variance[4, 4] == pytest.approx((0.04e3) ** 2 / 4.0)
    ground = np.ones(one.shape, bool)
    ground[4, 4] = ground[3:6, 11:15] = False
    assert (variance[ground] < 1e-3 * 0.02**2).all()
    assert variance[3, 12] == pytest.approx(0.02**2 * 2.0 * (0.04 / 0.06) ** 2 / 9.0)
    told = known_by_rays(one, other, 20.0)
    assert told[4, 4]
    assert told[ground].all()
    assert not told[4, 12:14].any()


@pytest.mark.full
def test_power_that_rays_leave_open_is_no_structure() -> None:
    """A line of pixels, as of a wall, whose model is off by a half, up or down: structure, unless its rays say so. Then
    a line that is off by a factor of 20 is structure still."""
    random = np.random.default_rng(3)
    factor = np.ones((SIDE, SIDE))
    factor[30, 5:35] = np.maximum(1.0 + 0.5 * random.normal(size=30), 0.05)
    wall = np.where(factor == 1.0, 0.0, (0.5 * MODELLED) ** 2)
    images = [one(MODELLED * factor * speckle(random, 20.0, 0.0), 20.0, f"v{k}") for k in range(3)]
    assert "structure" in judge(images).findings
    assert judge([replace(image, by_rays=wall) for image in images]).findings == []
    brighter = [replace(image, by_rays=wall) for image in images]
    for image in brighter:
        image.measured[30, 5:35] *= 20.0
    assert "structure" in judge(brighter).findings


# ---- what is there is found ----


@pytest.mark.full
@pytest.mark.parametrize(
    ("side", "decibel", "looks"), [(1, 10.0, 16.0), (3, 5.0, 16.0), (9, -3.0, 16.0), (17, 3.0, 4.0)]
)
def test_a_window_is_found_and_placed(side: int, decibel: float, looks: float) -> None:
    images = several(1, looks)
    row, col = 20, 29
    around = tuple(slice(k - side // 2, k + side // 2 + 1) for k in (row, col))
    images[1].measured[around] *= 10 ** (decibel / 10)
    found = judge(images)
    window = found.window
    assert found.finding == "structure"
    assert found.wrong
    assert (window.view, window.polarization) == ("v1", "HH")
    assert abs(window.row - row) <= max(side // 2, 1)
    assert abs(window.col - col) <= max(side // 2, 1)
    # pixel centres about the reference point, which lies in the middle of the grid
    assert window.range_m == pytest.approx((window.row + 0.5 - SIDE / 2) * PIXEL_M)
    assert window.azimuth_m == pytest.approx((window.col + 0.5 - SIDE / 2) * PIXEL_M)
    if window.rows == window.columns == side:
        # speckle of one pixel of 16 looks is 1.1 dB
        assert window.ratio_db == pytest.approx(decibel, abs=3.0)


@pytest.mark.full
def test_wrong_looks_are_named_and_no_structure() -> None:
    for seed in range(4):
        images = several(seed, looks=4.0)
        found = judge([with_looks(image, 16.0) for image in images])
        assert (found.findings, found.wrong) == (["looks"], True)
        # d grows with the looks that are stated: 4, to the first order of 1 / L
        assert found.deviance == pytest.approx(4.0, rel=0.2)
        assert found.own_deviance == pytest.approx(found.deviance, rel=0.1)
        # nine blocks of 144 pixels in each of three images: 4 % of the looks
        for estimate in found.speckle.looks.values():
            assert estimate.value == pytest.approx(4.0, rel=0.15)
        found = judge([with_looks(image, 2.0) for image in images])
        assert found.findings == ["looks"]
        for estimate in found.speckle.looks.values():
            assert estimate.value == pytest.approx(4.0, rel=0.15)
        assert "looks where 2 are declared" in found.words


@pytest.mark.full
def test_looks_that_were_estimated_are_not_tested_and_it_is_said() -> None:
    images = [with_looks(image, 24.0) for image in several(5, views=12)]
    assert judge(images).findings == ["looks"]
    found = judge([with_looks(image, 24.0, looks_estimated=True) for image in images])
    assert found.finding == "speckle"
    assert "the looks were estimated from the images, so they are not tested" in found.words


@pytest.mark.full
def test_a_tenth_of_the_looks_does_not_matter() -> None:
    """12 images tell looks to 1 %. A tenth is what scenes are granted: many pixels do not condemn them."""
    found = judge([with_looks(image, 16.9) for image in several(0, views=12)])
    assert found.finding == "speckle"


@pytest.mark.full
def test_texture_is_told_from_looks() -> None:
    random = np.random.default_rng(3)
    images = [one(MODELLED * Law(16.0, 6.0).draw(random, (SIDE, SIDE)), 16.0, f"v{k}") for k in range(8)]
    found = judge(images)
    assert found.findings == ["texture"]
    assert found.speckle.texture is not None
    assert found.speckle.texture.low < 6.0 < found.speckle.texture.high
    # with the texture declared nothing is left
    known = [with_looks(image, Law(16.0, 6.0).equivalent_looks, texture=6.0) for image in images]
    found = judge(known)
    assert found.findings == []
    assert found.deviance == pytest.approx(1.0, abs=0.05)


@pytest.mark.full
def test_a_broad_error_of_the_level_is_found() -> None:
    """A slope over the whole image, 1 dB from side to side, is in no window of 17 pixels by itself."""
    slope = 10.0 ** ((COLS - SIDE / 2) / SIDE / 10.0)
    images = several(2, 64.0, views=6)
    for image in images:
        image.measured[:] *= slope
    assert {"level", "structure"} & set(judge(images).findings)


def test_few_pixels_cannot_tell() -> None:
    image = MODELLED * speckle(np.random.default_rng(0), 16.0, 0.0)
    corner = EDGE & (ROWS < 10) & (COLS < 10)
    alone = one(image, 16.0, interior=corner)
    found = judge([replace(alone, usable=corner)])
    assert (found.finding, found.wrong) == ("cannot be told", False)
    assert "49 pixels" in found.words
    # and what is plain is told from few
    assert judge([replace(one(5.0 * image, 16.0, interior=corner), usable=corner)]).wrong


def test_a_deviance_far_from_one_is_never_right() -> None:
    """Texture from pixel to pixel is no window's: the scatter of even ground tells it."""
    random = np.random.default_rng(0)
    images = several(0)
    for image in images:
        image.measured[:] *= random.lognormal(0.0, 0.25, image.measured.shape)
    found = judge(images)
    assert found.deviance > 1.2
    assert found.wrong


def test_pixels_that_measure_nothing_where_there_is_light() -> None:
    images = several(0)
    silent = np.zeros((SIDE, SIDE), bool)
    silent[8:11, 30:33] = True
    seen = images[0].seen
    hole = {"measured": np.where(silent, 0.0, seen.measured), "silent": silent, "interior": seen.interior & ~silent}
    images[0] = replace(images[0], seen=replace(seen, **hole))
    found = judge(images)
    assert found.finding == "structure"
    assert abs(found.window.row - 9) <= 1
    assert abs(found.window.col - 31) <= 1


def test_power_in_a_shadow_is_found() -> None:
    """A fifth of the median of the lit pixels, in pixels that the model does not light."""
    images = []
    for seed in range(2):
        image = MODELLED * speckle(np.random.default_rng(seed), 16.0, 0.0)
        model = np.where(SHADOW, 0.0, MODELLED)
        measured_image = np.where(SHADOW, 0.2 * np.median(MODELLED[~SHADOW]), image)
        images.append(comparison(measured_image, model, 16.0, name=f"v{seed}", interior=EDGE & ~SHADOW))
    found = judge(images)
    assert found.finding == "structure"
    assert SHADOW[found.window.row, found.window.col]
    assert "power where the model has none" in found.words or found.window.ratio_db > 0
    images = [
        replace(image, seen=replace(image.seen, measured=np.where(SHADOW, 0.0, image.measured))) for image in images
    ]
    assert judge(images).finding == "speckle"


@pytest.mark.full
def test_large_images_are_judged_by_tiles_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles of 20 pixels stand for ten images; the chances are those of all pixels."""
    monkeypatch.setattr(module, "SAMPLE", 2000)
    monkeypatch.setattr(module, "TILE", 20)
    found = [judge(several(seed, views=10)).finding for seed in range(5)]
    assert found.count("speckle") >= 4
    images = several(0, views=10)
    images[7].measured[20:23, 29:32] *= 3.0
    found = judge(images)
    assert (found.finding, found.window.view) == ("structure", "v7")


# ---- edges ----


def blocks(seed: int, off_px: tuple[float, float], looks: float = 16.0, views: int = 3) -> list[Comparison]:
    """Bright squares on dim ground, exact areas; the measured ones lie off by (rows, columns) of a pixel."""
    random = np.random.default_rng(seed)
    fine = 20

    def image(moved: tuple[float, float]) -> np.ndarray:
        plane = np.full((64 * fine, 64 * fine), 0.02)
        for row in range(8, 56, 16):
            for col in range(8, 56, 16):
                plane[row * fine : (row + 7) * fine + 7, col * fine + 5 : (col + 9) * fine] = 0.2
        plane = np.roll(plane, [round(fine * one) for one in moved], (0, 1))
        return plane.reshape(64, fine, 64, fine).mean(axis=(1, 3))

    model = image((0.0, 0.0))
    steps = [(0.25, 0.0), (0.0, 0.25)]
    slopes = np.stack([2.0 * (image(step) - image((-step[0], -step[1]))) for step in steps])
    found = []
    for k in range(views):
        measured_image = image(off_px) * random.gamma(looks, 1.0 / looks, model.shape)
        found.append(comparison(measured_image, model, looks, name=f"v{k}", slopes=slopes))
    return found


def test_edges_that_are_right_agree_to_a_hundredth_of_a_pixel() -> None:
    found = judge(blocks(0, (0.0, 0.0)))
    assert found.findings == []
    assert found.edges.judged
    # 3 x 1,000 pixels of an edge of a factor of ten tell 0.02 pixels of 0.5 m
    assert found.edges.most_m < 0.02
    assert "edges agree to" in found.words


@pytest.mark.full
def test_less_than_a_tenth_of_a_pixel_does_not_matter() -> None:
    for seed in range(3):
        assert judge(blocks(seed, (0.05, 0.05))).findings == []


@pytest.mark.full
@pytest.mark.parametrize("off_px", [(0.3, 0.0), (0.0, 0.3), (0.0, -0.5), (1.0, 0.0)])
def test_edges_that_lie_off_are_found_by_their_distance(off_px: tuple[float, float]) -> None:
    images = blocks(1, off_px)
    found = judge(images)
    assert "edges" in found.findings
    displacement = np.hypot(*off_px) * PIXEL_M / np.sqrt(2.0)
    # each edge shows what lies across it: half of the square, for squares; and slopes end where a pixel is full
    assert 0.3 * displacement < found.edges.displacement_m < 1.7 * displacement
    # one view of three
    mixed = [images[0], *blocks(2, (0.0, 0.0))[1:]]
    found = judge(mixed)
    assert [one.image for one in found.edges.off(0.01)] == ["v0 HH"]
    assert "v0 HH" in found.words


@pytest.mark.full
def test_a_stated_accuracy_is_variance() -> None:
    """0.3 pixels off, and the mesh is known to 0.15 pixels: two standard deviations. To 0.03 it is a finding."""
    images = blocks(1, (0.3, 0.0))
    for accuracy_px, off in ((0.15, False), (0.03, True)):
        reach = 3.0 * accuracy_px
        found = judge([replace(image, reach_px=(reach, reach)) for image in images])
        assert ("edges" in found.findings) == off
        assert found.wrong == off


def test_a_blur_is_edges_that_do_not_agree() -> None:
    images = blocks(3, (0.0, 0.0))
    soft = [gaussian_filter(image.simulated, 0.8) / image.simulated for image in images]
    for image, factor in zip(images, soft, strict=True):
        image.measured[:] *= factor
    assert "edges" in judge(images).findings


def test_images_without_edges_say_that_edges_were_not_judged() -> None:
    found = judge([replace(image, slopes=np.zeros((2, SIDE, SIDE))) for image in several(0)])
    assert not found.edges.judged
    assert "edges were not judged: no edge shows beside speckle" in found.words
    (one, *_) = found.edges.content()["images"]  # nothing was measured, so no number stands for it
    assert (one["judged"], one["displacement_m"], one["most_m"], one["p"]) == (False, None, None, None)
    flat = [comparison(speckle(np.random.default_rng(0), 16.0, 0.0), 1.0, 16.0)]
    assert not edges_of(flat).judged


def test_false_alarms_of_edges() -> None:
    """A model that is right: none of 40, where one in 400 is allowed."""
    found = [edges_of(blocks(seed, (0.0, 0.0), looks=looks)).off(0.0025) for looks in (1.0, 16.0) for seed in range(20)]
    assert not any(found)


def test_a_judgement_travels_between_processes() -> None:
    for images in (blocks(1, (0.3, 0.0)), [with_looks(image, 4.0) for image in several(0)]):
        found = judge(images)
        assert unpacked(packed(found)) == found


# ---- the correlation of speckle ----


def patches(images: list[Comparison]) -> list[Patch]:
    return [Patch(image.interior, image.measured / image.simulated, image.seen.law) for image in images]


@pytest.mark.parametrize("looks", [1.0, 16.0])
def test_own_correlation_is_that_of_the_fields(looks: float) -> None:
    """The intensity's correlation is that of the field squared: exp(-d^2 / (2 sigma^2)) of a Gaussian blur."""
    sigma = 1.0
    correlation, variance = own_autocovariance(patches(several(0, looks, sigma, views=12)))
    assert variance == pytest.approx(1.0, abs=0.25)
    for lag in ((0, 1), (1, 0), (1, 1)):
        expected = np.exp(-(lag[0] ** 2 + lag[1] ** 2) / (2 * sigma**2))
        assert correlation[6 + lag[0], 6 + lag[1]] == pytest.approx(expected, abs=0.12)
        assert correlation[6 - lag[0], 6 - lag[1]] == correlation[6 + lag[0], 6 + lag[1]]


def test_structure_is_not_taken_for_correlated_speckle() -> None:
    """Half of every image 3 dB too bright: the speckle stays white, and its variance 1. The plain autocovariance of
    the same residuals would excuse windows 28 times as strong."""
    images = several(0, views=6)
    for image in images:
        image.measured[:, 20:] *= 2.0
    correlation, variance = own_autocovariance(patches(images))
    assert correlation.sum() < 2.0
    assert variance == pytest.approx(1.0, abs=0.2)
    residuals = [(i.seen, 4.0 * (i.measured / i.simulated - 1.0)[i.interior]) for i in images]
    assert residual_autocovariance(residuals).sum() > 28**2


# ---- whole scenes ----


@pytest.fixture(scope="module")
def clean() -> tuple[Scene, list[dict[str, np.ndarray]]]:
    truth = cube_scene([*views_at((20.0, 35.0), (140.0, 50.0)), view(80.0, 42.0, name="judge", role="test")])
    return truth, noise_free(truth)


def test_a_right_scene_is_speckle(clean: Any, tmp_path: Path) -> None:
    truth, images = clean
    found = evaluate(measured(truth, tmp_path, images=images), device="cpu").verdicts
    assert {role: one.finding for role, one in found.items()} == {"train": "speckle", "test": "speckle"}


@pytest.mark.full
def test_bright_pixels_buy_no_all_clear(clean: Any, tmp_path: Path) -> None:
    """Wrong permittivity of the ground, and a few bright pixels that inflate the sample's error: the deviance lies
    within three of those errors of 1, and the residual is solid red all the same."""
    truth, images = clean
    bright = [{pol: image.copy() for pol, image in one.items()} for one in images]
    for one in bright:
        for image in one.values():
            image[18, 4:6] *= 60.0
    scene = measured(truth, tmp_path, images=bright)
    wrong = {**TRUTH, "ground": {**TRUTH["ground"], "eps_r": 4.6}}
    found = evaluate(starting(scene, wrong), device="cpu")
    assert found.train is not None
    assert found.train["deviance"] > 1.3
    assert abs(found.train["deviance"] - 1.0) < 3.0 * found.train["deviance_error"]
    for one in found.verdicts.values():
        assert one.finding == "structure"
    # and without the bright pixels
    scene = measured(truth, tmp_path, images=images)
    for one in evaluate(starting(scene, wrong), device="cpu").verdicts.values():
        assert one.finding == "structure"
        assert one.window.rows * one.window.columns >= 25
        assert one.window.ratio_db > 0


def test_the_words_say_what_was_found() -> None:
    images = several(1)
    images[1].measured[18:23, 27:32] *= 2.0
    found = judge(images)
    for word in ("structure", "v1 HH", "at range", "dB", "deviance"):
        assert word in found.words
    content = found.content()
    assert content["finding"] == "structure"
    assert content["error_rate"] == ERROR_RATE
    assert content["window"]["view"] == "v1"
