"""Is anything left beside speckle? False alarms at the declared rate, and no false all-clear."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import TRUTH, cube_scene, measured, noise_free, starting, views_at
from scipy.ndimage import gaussian_filter
from worlds import ground, mesh_of, scene_of, view

from warpsar.evaluation.command import evaluate
from warpsar.learning import verdict as module
from warpsar.learning.identify import residual_autocovariance
from warpsar.learning.observation import Observation
from warpsar.learning.verdict import Verdict, verdict
from warpsar.scene.scene import Scene
from warpsar.speckle.own import Patch, own_autocovariance

SIDE = 40
PIXEL_M = 0.5
ROWS, COLS = np.mgrid[:SIDE, :SIDE]
EDGE = (ROWS > 2) & (ROWS < SIDE - 3) & (COLS > 2) & (COLS < SIDE - 3)
SHADOW = (np.abs(COLS - 20) < 5) & (ROWS > 13) & (ROWS < 26)
MODELLED = np.where(COLS > 20, 0.1, 0.02)

Pair = tuple[Observation, np.ndarray]


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


def pair(image: np.ndarray, looks: float, name: str = "v0", interior: np.ndarray = EDGE & ~SHADOW) -> Pair:
    nowhere = np.zeros_like(interior)
    seen = Observation(view(0, 40, name=name), "HH", image, interior, nowhere, nowhere, looks, False)
    return seen, MODELLED.copy()


def pairs(seed: int, looks: float = 16.0, sigma: float = 0.0, views: int = 3) -> list[Pair]:
    random = np.random.default_rng([seed, int(looks), int(10 * sigma)])
    return [pair(MODELLED * speckle(random, looks, sigma), looks, f"v{k}") for k in range(views)]


@pytest.fixture(scope="module")
def plane() -> Scene:
    """Its grid says where a pixel lies."""
    return scene_of(mesh_of(ground=ground(10.0)), view(0, 40), shape=(SIDE, SIDE))


# ---- false alarms ----


@pytest.mark.parametrize("sigma", [0.0, 0.7])
@pytest.mark.parametrize("looks", [1.0, 4.0, 16.0])
def test_speckle_alone_is_speckle(looks: float, sigma: float, plane: Scene) -> None:
    """At a rate of 0.01, two alarms or more in five scenes come by chance in 0.1 % of all cases."""
    found = [verdict(plane, pairs(seed, looks, sigma)).finding for seed in range(5)]
    assert len(found) - found.count("speckle") <= 1


def test_p_values_of_speckle_are_spread_evenly(plane: Scene) -> None:
    found = [verdict(plane, pairs(seed)) for seed in range(20)]
    # the share under a half of 20 has a standard deviation of 0.11
    assert np.mean([one.p_structure < 0.5 for one in found]) == pytest.approx(0.5, abs=0.35)
    assert np.mean([one.p_level < 0.5 for one in found]) < 0.8


# ---- what is there is found ----


@pytest.mark.parametrize(
    ("side", "decibel", "looks"), [(1, 10.0, 16.0), (3, 5.0, 16.0), (9, -3.0, 16.0), (17, 3.0, 4.0)]
)
def test_a_window_is_found_and_placed(side: int, decibel: float, looks: float, plane: Scene) -> None:
    images = pairs(1, looks)
    row, col = 20, 29
    around = tuple(slice(k - side // 2, k + side // 2 + 1) for k in (row, col))
    images[1][0].measured[around] *= 10 ** (decibel / 10)
    found = verdict(plane, images)
    window = found.window
    assert found.finding == "structure"
    assert found.wrong
    assert (window.view, window.polarization) == ("v1", "HH")
    assert abs(window.row - row) <= max(side // 2, 1)
    assert abs(window.col - col) <= max(side // 2, 1)
    # pixel centres about the reference point, which lies in the middle of the grid
    assert window.range_m == pytest.approx((window.row + 0.5 - SIDE / 2) * PIXEL_M)
    assert window.azimuth_m == pytest.approx((window.col + 0.5 - SIDE / 2) * PIXEL_M)
    if window.pixels == side:
        # speckle of one pixel of 16 looks is 1.1 dB
        assert window.ratio_db == pytest.approx(decibel, abs=3.0)


def test_wrong_looks_are_a_level_and_no_structure(plane: Scene) -> None:
    for seed in range(4):
        images = pairs(seed, looks=4.0)
        many = [(replace(seen, looks=16.0), mu) for seen, mu in images]
        found = verdict(plane, many)
        assert (found.finding, found.wrong) == ("level", True)
        # d grows with the looks that are stated: 4, to the first order of 1 / L
        assert found.deviance == pytest.approx(4.0, rel=0.2)
        few = [(replace(seen, looks=2.0), mu) for seen, mu in images]
        found = verdict(plane, few)
        # less is left than speckle: this speaks against the looks, not against the model
        assert (found.finding, found.wrong) == ("level", False)


def test_looks_that_were_estimated_may_be_off(plane: Scene) -> None:
    images = [(replace(seen, looks=17.5), mu) for seen, mu in pairs(0, views=40)]
    assert verdict(plane, images).finding == "level"
    images = [(replace(seen, looks_estimated=True), mu) for seen, mu in images]
    assert verdict(plane, images).finding == "speckle"


def test_few_pixels_cannot_tell(plane: Scene) -> None:
    image = MODELLED * speckle(np.random.default_rng(0), 16.0, 0.0)
    corner = EDGE & (ROWS < 10) & (COLS < 10)
    found = verdict(plane, [pair(image, 16.0, interior=corner)])
    assert (found.finding, found.wrong) == ("cannot be told", False)
    assert "49 pixels" in found.words
    # and what is plain is told from few
    found = verdict(plane, [pair(5.0 * image, 16.0, interior=corner)])
    assert found.wrong


def test_a_deviance_far_from_one_is_never_right(plane: Scene) -> None:
    """Texture from pixel to pixel is no window's: the level tells it."""
    random = np.random.default_rng(0)
    images = [(seen, mu * random.lognormal(0.0, 0.15, mu.shape)) for seen, mu in pairs(0)]
    found = verdict(plane, images)
    assert found.deviance > 1.2
    assert found.wrong


def test_pixels_that_measure_nothing_where_there_is_light(plane: Scene) -> None:
    images = pairs(0)
    seen, mu = images[0]
    silent = np.zeros_like(seen.interior)
    silent[8:11, 30:33] = True
    measured_image = np.where(silent, 0.0, seen.measured)
    hole = {"measured": measured_image, "silent": silent, "interior": seen.interior & ~silent}
    images[0] = (replace(seen, **hole), mu)
    found = verdict(plane, images)
    assert found.finding == "structure"
    assert (found.window.row, found.window.col) == (9, 31)


def test_large_images_are_judged_by_tiles_of_them(plane: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tiles of 20 pixels stand for ten images; the chances are those of all pixels."""
    monkeypatch.setattr(module, "SAMPLE", 2000)
    monkeypatch.setattr(module, "TILE", 20)
    found = [verdict(plane, pairs(seed, views=10)).finding for seed in range(5)]
    assert found.count("speckle") >= 4
    images = pairs(0, views=10)
    images[7][0].measured[20:23, 29:32] *= 3.0
    found = verdict(plane, images)
    assert (found.finding, found.window.view) == ("structure", "v7")


# ---- the correlation of speckle ----


def patches(images: list[Pair]) -> list[Patch]:
    return [Patch(seen.interior, seen.measured / mu, seen.looks) for seen, mu in images]


@pytest.mark.parametrize("looks", [1.0, 16.0])
def test_own_correlation_is_that_of_the_fields(looks: float) -> None:
    """The intensity's correlation is that of the field squared: exp(-d^2 / (2 sigma^2)) of a Gaussian blur."""
    sigma = 1.0
    correlation, variance = own_autocovariance(patches(pairs(0, looks, sigma, views=12)))
    assert variance == pytest.approx(1.0, abs=0.25)
    for lag in ((0, 1), (1, 0), (1, 1)):
        expected = np.exp(-(lag[0] ** 2 + lag[1] ** 2) / (2 * sigma**2))
        assert correlation[6 + lag[0], 6 + lag[1]] == pytest.approx(expected, abs=0.12)
        assert correlation[6 - lag[0], 6 - lag[1]] == correlation[6 + lag[0], 6 + lag[1]]


def test_structure_is_not_taken_for_correlated_speckle() -> None:
    """Half of every image 3 dB too bright: the speckle stays white, and its variance 1. The plain autocovariance of
    the same residuals would excuse windows 28 times as strong."""
    images = pairs(0, views=6)
    for seen, _ in images:
        seen.measured[:, 20:] *= 2.0
    correlation, variance = own_autocovariance(patches(images))
    assert correlation.sum() < 2.0
    assert variance == pytest.approx(1.0, abs=0.2)
    residuals = [(seen, 4.0 * (seen.measured / mu - 1.0)[seen.interior]) for seen, mu in images]
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
        assert one.window.pixels >= 5
        assert one.window.ratio_db > 0


def test_the_words_say_what_was_found(plane: Scene) -> None:
    images = pairs(1)
    images[1][0].measured[18:23, 27:32] *= 2.0
    found: Verdict = verdict(plane, images)
    for word in ("structure", "v1 HH", "at range", "dB", "deviance"):
        assert word in found.words
    content = found.content()
    assert content["finding"] == "structure"
    assert content["error_rate"] == 0.01
    assert content["window"]["view"] == "v1"
