"""What the data can say: Fisher information against the table of docs/physics.md, words, intervals under speckle."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import benchmark
from learning_scenes import cube_scene, measured, noise_free, speckle, views_at
from worlds import ground, mesh_of, plate, scene_of

from warpsar.learning.command import LearnOptions, learn
from warpsar.learning.identify import describe, identify, of_information, score_products
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.speckle.own import LAGS
from warpsar.speckle.residual import residual_autocovariance
from warpsar.surface.surface import KEYS
from warpsar.world.tables import Material

# The three angles to the normal of a cube's lit faces at relative azimuths 0, 30 and 60 (docs/physics.md), here as
# three views of a plane.
ANGLES = (45.0, 52.2388, 69.2952)
T3 = {"eps_r": 75.0, "rms_height_m": 0.002, "correlation_length_m": 0.001}
T4 = {"eps_r": 6.885, "rms_height_m": 0.020, "correlation_length_m": 0.010}
VALID = {"eps_r": 6.885, "rms_height_m": 0.0005, "correlation_length_m": 0.010}


def plane(folder: Path, material: dict[str, Any], polarizations: tuple[str, ...], *learned: str) -> Scene:
    views = views_at(*((0.0, angle) for angle in ANGLES))
    keys = learned or ("eps_r", "rms_height_m", "correlation_length_m")
    scene = scene_of(
        mesh_of(soil=ground(60.0)), views, shape=(14, 14), polarizations=polarizations, rays_per_pixel=16.0
    )
    scene = replace(scene, materials={"soil": Material(learn=keys, **material)})
    return measured(scene, folder, looks=16.0)


def per_unit_looks(problem: FitProblem) -> np.ndarray:
    """Sum over channels of (d ln sigma)(d ln sigma)^T."""
    slopes = [j.mean(axis=0) for j in problem.jacobian(problem.x0)]
    return sum(np.outer(s, s) for s in slopes)


# Eigenvalues and standard deviations (1000 looks per channel) as docs/physics.md prints them: two or three
# digits, so 5 %; nan where it prints none.
NAN, INF = float("nan"), float("inf")
TABLE = [
    ("T3 SPM HH", T3, 0.0, ("HH",), (23.4, 3.7e-3, 1.2e-6), (7.3, 19, 20)),
    ("T3 SPM HH+VV", T3, 0.0, ("HH", "VV"), (47.1, 0.130, 4.7e-4), (0.089, 1.0, 1.0)),
    ("T3 mix HH", T3, 0.5, ("HH",), (15.6, 7.8e-3, 1.1e-3), (0.55, 0.66, 0.58)),
    ("T3 mix HH+VV", T3, 0.5, ("HH", "VV"), (28.2, 0.177, 0.012), (0.29, 0.060, 0.055)),
    ("T4 SPM HH", T4, 0.0, ("HH",), (50.7, 1.30, 2.3e-4), (1.9, 0.74, 0.18)),
    ("T4 SPM HH+VV", T4, 0.0, ("HH", "VV"), (103, 2.59, 0.467), (0.043, 0.025, 0.010)),
    ("valid SPM HH", VALID, 0.0, ("HH",), (50.7, 1.30, 2.3e-4), (1.9, 0.74, 0.18)),
    ("T4 mix HH", T4, 0.5, ("HH",), (19, 0.82, 0.19), (0.044, 0.051, 0.045)),
    ("T3 mix, tau free, HH+VV", T3, 0.5, ("HH", "VV"), (NAN, NAN, NAN, 2.1e-5), (6.1, 0.93, 0.88, 3.0)),
    ("T3 mix, tau free, HH", T3, 0.5, ("HH",), (16.3, 0.040, 0.0012, 0.0), (INF, INF, INF, INF)),
]


@pytest.mark.parametrize(("name", "material", "tau", "polarizations", "eigenvalues", "sd"), TABLE)
def test_information_is_that_of_the_table(
    name: str, material: dict[str, float], tau: float, polarizations: tuple[str, ...], eigenvalues: Any, sd: Any,
    tmp_path: Path,
) -> None:  # fmt: skip
    learned = KEYS if "free" in name else KEYS[:3]
    scene = plane(tmp_path, {**material, "specular_fraction": tau}, polarizations, *learned)
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    information = per_unit_looks(problem)
    found = of_information(problem.labels, 1000 * information, 1000 * information)
    printed = np.isfinite(eigenvalues)
    np.testing.assert_allclose(
        found.eigenvalues[::-1][printed] / 1000, np.array(eigenvalues)[printed], rtol=0.06, atol=1e-10
    )
    np.testing.assert_allclose(found.sd, sd, rtol=0.06)


# Words for as many looks as these planes have: 16 looks in 100 pixels for each channel.
WORDS = [
    (T3, 0.0, ("HH", "VV"), r"soil: only \(eps_r-1\) to 7\.\d %, h\*l to 2\.\d % determined; h, l alone .*"),
    (T3, 0.0, ("HH",), r"soil: only \(eps_r-1\)\^0\.06\*h\*l\^0\.97 to 0\.[67]\d? % determined; \(eps_r-1\), h, l .*"),
    (T3, 1.0, ("HH",), r"soil: only \(eps_r-1\) to [23]\d %, h/l to [34]\.?\d? % determined; h, l alone .*"),
    (VALID, 0.0, ("HH",), r"soil: only l to 1\d %, \(eps_r-1\)\^0\.38\*h to 2\.?\d? % determined; \(eps_r-1\), h .*"),
    (VALID, 0.0, ("HH", "VV"), r"soil: \(eps_r-1\) to 3\.\d %, h to (2|2\.\d|1\.9) %, l to 0\.\d+ %"),
]  # fmt: skip


@pytest.mark.parametrize(("material", "tau", "polarizations", "words"), WORDS)
def test_words(
    material: dict[str, float], tau: float, polarizations: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    scene = plane(tmp_path, {**material, "specular_fraction": tau}, polarizations)
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    (sentence,) = identify(problem, problem.x0).words
    assert re.fullmatch(words, sentence), sentence


@pytest.mark.parametrize("polarizations", [("HH",), ("HH", "VV")])
def test_geometric_optics_never_tells_h_from_l(polarizations: tuple[str, ...], tmp_path: Path) -> None:
    """The null direction is exactly (0, 1, 1) / sqrt(2); to float32 images, 1e-4 of it."""
    problem = FitProblem(
        plane(tmp_path, {**T3, "specular_fraction": 1.0}, polarizations), devices.resolve_device("cpu")
    )
    found = identify(problem, problem.x0)
    np.testing.assert_allclose(np.abs(found.eigenvectors[:, 0]), [0, 0.5**0.5, 0.5**0.5], atol=2e-4)
    assert found.eigenvectors[1, 0] * found.eigenvectors[2, 0] > 0
    assert found.eigenvalues[0] < 1e-10 * found.eigenvalues[-1]
    assert np.isinf(found.sd[1:]).all()
    assert np.isfinite(found.sd[0])
    assert "h*l" not in found.words[0]


def test_a_plane_at_one_incidence_gives_one_number(tmp_path: Path) -> None:
    """Rule (iv) of physics.md: rank 1; only the combination that makes sigma0 is known, to 1 / sqrt(looks x pixels)."""
    scene = plane(tmp_path, VALID, ("HH",))
    problem = FitProblem(replace(scene, views=scene.views[:1]), devices.resolve_device("cpu"))
    found = identify(problem, problem.x0)
    assert np.isinf(found.sd).all()
    assert np.count_nonzero(found.eigenvalues > 1e-9 * found.eigenvalues[-1]) == 1
    # the step from sigma0 to the combination: its gradient's largest element
    steepest = np.abs(problem.jacobian(problem.x0)[0].mean(axis=0)).max()
    expected = 100 / (steepest * np.sqrt(16 * problem.observations[0].values.size))
    said = float(found.words[0].split(" to ")[1].split(" %")[0])
    assert said == pytest.approx(expected, rel=0.15)  # the residuals' own variance, of 100 pixels: 2 sd


def test_what_no_view_sees_is_not_identifiable(tmp_path: Path) -> None:
    mesh = mesh_of(soil=ground(60.0), cellar=plate((-3, -3, -20.0), (6, 0, 0), (0, 6, 0)))
    views = views_at((0.0, 45.0), (90.0, 60.0))
    scene = scene_of(mesh, views, shape=(14, 14), polarizations=("HH", "VV"), rays_per_pixel=16.0)
    problem = FitProblem(measured(scene, tmp_path), devices.resolve_device("cpu"))
    found = identify(problem, problem.x0)
    assert np.isinf(found.sd[3:]).all()
    assert np.isfinite(found.sd[:3]).all()
    assert found.words[1] == "cellar: not identifiable ((eps_r-1), h, l)"


def test_a_key_of_an_effect_has_its_own_name() -> None:
    """`level` of a noise floor is not the `level` of a material, whose letter is g."""
    words = describe(["soil.level", "noise_floor.level"], np.diag([1e-4, 1e-4]), np.zeros((0, 2)))
    assert words == ["soil: g to 1 %", "noise_floor: level to 1 %"]


def test_unknown_gains_take_away_the_size(tmp_path: Path) -> None:
    """With a gain per image, a lone plane's power in a view says nothing: no parameter is left."""
    scene = plane(tmp_path, VALID, ("HH",))
    free = replace(scene, grid=scene.grid.model_copy(update={"calibrated": False}))
    for loss in ("gamma", "mse", "log"):
        problem = FitProblem(free, devices.resolve_device("cpu"), loss=loss)
        # of the calibrated information only sampling noise is left: angles vary by nothing in a plane wave
        assert np.trace(identify(problem, problem.x0).information) < 1e-6 * np.trace(
            identify(FitProblem(scene, problem.device, loss=loss), problem.x0).information
        )


# ---- correlated speckle ----


def blurred(random: np.random.Generator, shape: tuple[int, ...], looks: float, width: float = 1.2) -> np.ndarray:
    """Speckle of a Gaussian point-spread function: intensity of a blurred complex field, `looks` of them averaged."""
    from scipy.ndimage import gaussian_filter

    impulse = np.zeros(shape)
    impulse[0, 0] = 1.0
    variance = float((gaussian_filter(impulse, width, mode="wrap") ** 2).sum())
    total = np.zeros(shape)
    for part in random.normal(size=(2 * int(looks), *shape)):
        total += gaussian_filter(part, width, mode="wrap") ** 2
    return total / (2 * int(looks) * variance)


@pytest.mark.parametrize("shape", [(40, 31), (7, 33)])
def test_the_autocovariance_is_the_mean_of_products(shape: tuple[int, int]) -> None:
    """Of all pairs of interior pixels at a lag, one by one. An image may have fewer rows than there are lags."""
    random = np.random.default_rng(4)
    inside = random.random(shape) > 0.2
    image = np.where(inside, blurred(random, shape, 4.0) - 1.0, 0.0)
    seen = SimpleNamespace(measured=np.zeros(shape), interior=inside)
    found = residual_autocovariance([(seen, image[inside])])  # type: ignore[list-item]
    at = np.argwhere(inside)
    for lag in ((0, 0), (1, 0), (0, 1), (1, 1), (-1, 0), (1, -1)):
        there = [
            (p, p + lag) for p in at if (p + lag >= 0).all() and (p + lag < shape).all() and inside[tuple(p + lag)]
        ]
        mean = np.mean([image[tuple(p)] * image[tuple(q)] for p, q in there])
        assert found[LAGS + lag[0], LAGS + lag[1]] == pytest.approx(mean, rel=1e-9)  # near lags are not tapered


def score_variance(noise: Any, looks: float, seed: int) -> tuple[float, float]:
    """Of sum(residual) over a 60 x 60 image: what `score_products` says, over all that repeats show."""
    random = np.random.default_rng(seed)
    said, sums = [], []
    seen = SimpleNamespace(measured=np.zeros((60, 60)), interior=np.ones((60, 60), bool))
    for _ in range(200):
        residual = ((noise(random, (60, 60), looks) - 1.0) * np.sqrt(looks)).ravel()
        autocovariance = residual_autocovariance([(seen, residual)])  # type: ignore[list-item]
        said.append(score_products(np.ones((3600, 1)), autocovariance, seen)[0, 0])  # type: ignore[arg-type]
        sums.append(residual.sum())
    return float(np.mean(said)), float(np.mean(np.square(sums)))


@pytest.mark.parametrize(("looks", "noise"), [(1.0, speckle), (16.0, speckle), (4.0, blurred)])
def test_the_variance_of_the_score_is_that_of_repeats(looks: float, noise: Any) -> None:
    """200 repeats know a variance to 10 %; three of those. Blurred speckle has 9 times the variance of white one: the
    area under its autocovariance exp(-d^2 / 2 w^2), 2 pi w^2."""
    said, shown = score_variance(noise, looks, seed=int(looks))
    assert said == pytest.approx(shown, rel=0.3)
    white = 3600.0
    assert shown / white == pytest.approx(9.05 if noise is blurred else 1.0, rel=0.3)


@pytest.mark.full
def test_correlated_speckle_widens_the_intervals(tmp_path: Path) -> None:
    """By the root of the area that one independent sample takes, 3 for this blur; white speckle by nothing."""
    truth = cube_scene(views_at((20.0, 35.0), (140.0, 50.0)), shape=60)
    images = noise_free(truth)
    ratios = {}
    for name, noise in (("white", speckle), ("blurred", blurred)):
        scene = measured(truth, tmp_path, looks=4.0, noise=noise, images=images)
        found = learn(scene, device="cpu", options=LearnOptions(starts=1))
        assert found.identified is not None
        information = found.identified.information
        ratios[name] = found.identified.sd / np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(ratios["white"], 1.0, rtol=0.15)
    # the edges of the cube's faces cut the neighbourhoods, so somewhat below 3
    assert (ratios["blurred"] > 2.0).all()
    assert (ratios["blurred"] < 3.6).all()


# ---- coverage ----


@pytest.mark.slow
@pytest.mark.parametrize("case", ["hh_vv", "hh_incidences"])
@pytest.mark.parametrize("loss", ["gamma", "log", "mse"])
def test_intervals_hold_the_truth(case: str, loss: str) -> None:
    """30 repeats of benchmarks/learn_coverage.py, six parameters each. The three of one material err together, so
    the pool is worth at least the two materials, 60 draws: a true 95 % shows 83 % or less once in 2000 such runs. 200
    draws and more for the upper end would be needed, so none is held but 100 %."""
    coverage = benchmark("learn_coverage")
    found = coverage.coverage(case, 30, device="cpu", loss=loss, seed=1)
    assert found["intervals"] > 120
    assert found["held_percent"] > 85.0


@pytest.mark.slow
def test_intervals_hold_the_truth_under_correlated_speckle() -> None:
    """Speckle of a point-spread function: without the residuals' own covariance 95 % intervals would hold half."""
    coverage = benchmark("learn_coverage")
    found = coverage.coverage("hh_vv", 30, device="cpu", seed=2, speckle=coverage.blurred)
    assert found["held_percent"] > 82.0


def test_values_that_sum_to_zero_are_known_by_their_differences() -> None:
    """Of three gains the data see two differences: each deviation is that of gain less mean, whatever is rounded."""
    labels = [f"view_gain.gain_db[v{i}]" for i in range(3)]
    differences = np.eye(3) - 1.0 / 3.0
    mean = np.full((1, 3), 1.0 / np.sqrt(3.0))
    for left in (0.0, 1e-13, 1e-7):  # what rounding leaves of the information on the mean
        found = of_information(labels, 100.0 * differences + left * mean.T @ mean, 100.0 * differences, mean)
        assert found.sd == pytest.approx(np.sqrt(np.diag(differences) / 100.0), rel=1e-6)
    assert not np.isfinite(of_information(labels, 100.0 * differences, 100.0 * differences).sd).any()
