"""95 % intervals by the search of a box: on likelihoods of known profiles, and against images."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import cube_scene, measured, views_at
from numpy.testing import assert_allclose

from warpsar.learning import profiles
from warpsar.learning.identify import identify
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene

S = 0.1


class Likelihood:
    """-ln L = r0^2 / 2 + r1^2 / 2 of two residuals of x, shape (n, 2), with their slopes."""

    def __init__(self, residuals: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]) -> None:
        self.residuals = residuals

    def losses(self, at: np.ndarray) -> np.ndarray:
        return np.asarray(0.5 * np.sum(self.residuals(at)[0] ** 2, axis=1))

    def expanded(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r, slopes = self.residuals(at)
        return self.losses(at), np.einsum("nr,nrq->nq", r, slopes), np.einsum("nrp,nrq->npq", slopes, slopes)


def rows(*columns: Any) -> np.ndarray:
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


def bent(bend: float) -> Likelihood:
    """Along the valley x0 = bend x1^2, x1 is a standard normal."""

    def residuals(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slopes = np.stack([rows(1.0 / S, -2.0 * bend * x[:, 1] / S), rows(0.0 * x[:, 0], 1.0)], axis=1)
        return rows((x[:, 0] - bend * x[:, 1] ** 2) / S, x[:, 1]), slopes

    return Likelihood(residuals)


def two_valleys(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x0 at 3 and at -3 is as likely."""
    slopes = np.stack([rows(2.0 * x[:, 0] / (6.0 * S), 0.0), rows(0.0 * x[:, 0], 1.0)], axis=1)
    return rows((x[:, 0] ** 2 - 9.0) / (6.0 * S), x[:, 1]), slopes


def ends_of(
    likelihood: Likelihood, x: tuple[float, float] = (0.0, 0.0), bound: float = 20.0, wider: float = 1.0
) -> Any:
    curves: Any = likelihood
    box = np.array([[-bound, bound]] * 2)
    return profiles._Search(curves, box, np.full(2, wider), np.array(x)).ends()


def test_a_straight_valley_has_the_ends_of_its_standard_deviations() -> None:
    assert_allclose(ends_of(bent(0.0)), [[-0.196, 0.196], [-1.96, 1.96]], rtol=0.03)  # a root is found to 2 %


def test_a_bent_valley_has_the_ends_of_its_profile() -> None:
    """At x0 above 0 the likeliest x1 has bend x1^2 = x0 - s^2 / 2 bend, where -ln L is x0 / 2 bend - s^2 / 8 bend^2."""
    ends = ends_of(bent(1.0))
    assert ends[0, 0] == pytest.approx(-0.196, rel=0.03)
    assert ends[0, 1] == pytest.approx(1.96**2 + S**2 / 4.0, rel=0.05)  # where a root of 2 % is 4 %
    assert_allclose(ends[1], [-1.96, 1.96], rtol=0.03)


def test_a_second_valley_that_fits_belongs_to_the_interval() -> None:
    """Each is 0.1 wide; between them nothing fits."""
    for x in ((3.0, 0.0), (-3.0, 0.0)):
        ends = ends_of(Likelihood(two_valleys), x)
        assert_allclose(ends[0], [-3.196, 3.196], rtol=3e-3)
        assert_allclose(ends[1], [-1.96, 1.96], rtol=0.03)


def test_an_end_that_nothing_refuses_is_the_bound() -> None:
    ends = ends_of(bent(1.0), bound=1.0)
    assert ends[0, 1] == 1.0
    assert ends[1].tolist() == [-1.0, 1.0]
    assert ends[0, 0] == pytest.approx(-0.196, rel=0.03)


def test_correlated_speckle_widens_the_interval() -> None:
    """Four times the variance of the score: both ends lie twice as far away."""
    assert_allclose(ends_of(bent(0.0), wider=4.0), [[-0.392, 0.392], [-3.92, 3.92]], rtol=0.03)


# ---- against images ----


def scene_with(folder: Path, learn: dict[str, tuple[str, ...]], **effects: Any) -> Scene:
    """A cube on a plane; four views of 36 x 36 pixels, HH and VV, 16 looks."""
    scene = cube_scene(views_at((0.0, 35.0), (25.0, 45.0), (50.0, 55.0)))
    materials = {name: one.model_copy(update={"learn": learn.get(name, ())}) for name, one in scene.materials.items()}
    return measured(replace(scene, materials=materials, effects=effects), folder)


KEYS = ("eps_r", "rms_height_m", "correlation_length_m")
BLUR = {"point_spread": {"range_fwhm_m": 0.6, "azimuth_fwhm_m": 0.6, "fixed": True}}


@pytest.mark.parametrize("effects", [{}, BLUR], ids=["sharp", "blurred"])
def test_a_surface_costs_what_its_image_says(effects: dict[str, Any], tmp_path: Path) -> None:
    """-ln L of surfaces far from the fit, by their curves and by their images.

    Where -ln L rises by up to 100 the two agree to a tenth: sigma0 is expanded in the kinds, and pixels that two
    materials share are taken one material at a time.
    """
    problem = FitProblem(scene_with(tmp_path, {"cube": KEYS}, **effects), devices.resolve_device("cpu"))
    x = problem.x0
    (curves,) = profiles._curves(problem, x)
    here = problem.value(problem.modelled(x))
    random = np.random.default_rng(3)
    at = x + random.standard_normal((12, 3)) * np.linspace(0.01, 0.12, 12)[:, None]
    by_image = np.array([problem.value(problem.modelled(one)) - here for one in at])
    by_curve = curves.losses(at)
    assert np.ptp(by_image) > 5.0
    assert_allclose(by_curve, by_image, rtol=0.1, atol=0.1)


def test_curves_know_what_the_fit_knows(tmp_path: Path) -> None:
    """At the fit, curvature by the curves of a material is the Fisher information beside all else that is fitted."""
    learn = {"ground": KEYS, "cube": KEYS}
    scene = scene_with(tmp_path, learn, noise_floor={"level": 1e-3})
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    x = problem.x0
    whole = identify(problem, x).information
    for curves in profiles._curves(problem, x):
        mine = curves.elements
        both = np.concatenate([mine, curves.others])
        rest = np.setdiff1d(np.arange(x.size), both)
        across = whole[np.ix_(both, rest)]
        beside = whole[np.ix_(both, both)] - across @ np.linalg.inv(whole[np.ix_(rest, rest)]) @ across.T
        curvature = curves.expanded(np.concatenate([x[mine], np.zeros(curves.others.size)])[None])[2][0]
        scale = np.sqrt(np.diag(beside))
        assert_allclose(curvature / np.outer(scale, scale), beside / np.outer(scale, scale), atol=0.02)


def test_numbers_of_effects_have_standard_deviations(tmp_path: Path) -> None:
    problem = FitProblem(
        scene_with(tmp_path, {"cube": KEYS[1:2]}, noise_floor={"level": 1e-3}), devices.resolve_device("cpu")
    )
    x = problem.x0
    found = profiles.with_profiles(problem, x, identify(problem, x))
    assert found.ends is not None
    assert found.by_profile is not None
    assert found.by_profile.tolist() == [True, False]
    assert_allclose(found.ends[1], x[1] + np.array([-1.96, 1.96]) * found.sd[1])
    assert np.ptp(found.ends[0]) == pytest.approx(2 * 1.96 * found.sd[0], rel=0.05)  # one number has one valley


def test_what_the_images_do_not_see_is_not_told(tmp_path: Path) -> None:
    """Of one polarization in one incidence, a permittivity may be anything: both ends are open."""
    scene = replace(cube_scene(views_at((0.0, 40.0)), polarizations=("HH",)), effects={})
    free = {
        name: one.model_copy(update={"learn": KEYS if name == "ground" else ()})
        for name, one in scene.materials.items()
    }
    problem = FitProblem(measured(replace(scene, materials=free), tmp_path), devices.resolve_device("cpu"))
    x = problem.x0
    ends = profiles.with_profiles(problem, x, identify(problem, x)).ends
    assert ends is not None
    assert ends[0].tolist() == [-np.inf, np.inf]
    assert np.isfinite(ends[2]).all()
    assert ends[2, 1] < -3.0  # a surface that is much longer sends nothing back
