"""`warpsar diagnose` of models of which something is known to a tolerance."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from test_diagnose import SLOPE, Ran, saved, scene_with
from test_held_effects import BLUR, declaring

from warpsar.cli.main import main
from warpsar.diagnosis.command import UNEXPLAINED
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import Fitted, fit_model
from warpsar.diagnosis.scores.partly_known import PartlyKnown
from warpsar.diagnosis.scores.score import TangentProjection
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage

KNOWN = {"range_fwhm_m": 0.03, "azimuth_fwhm_m": "5 %"}


def test_what_is_partly_known_is_a_ridge() -> None:
    """Residuals, templates and their covariance against the normal equations, written out."""
    random = np.random.default_rng(0)
    tangent, looks = random.standard_normal((200, 4)), random.uniform(1.0, 4.0, 200)
    slopes = np.zeros((2, 3))  # of three elements of x; the fourth column of the tangent is a gain
    slopes[0, 0], slopes[1, 2] = 30.0, 2.0
    residual = np.array([0.7, -1.1])
    projection = TangentProjection(tangent, looks, PartlyKnown(slopes, residual))
    a, d = looks[:, None] * tangent, np.hstack([slopes, np.zeros((2, 1))])
    inverse = np.linalg.inv(a.T @ a + d.T @ d)
    columns = random.standard_normal((200, 5))
    ridge = np.eye(200) - a @ inverse @ a.T
    np.testing.assert_allclose(projection(columns), ridge @ columns, atol=1e-10)
    left, under = projection(columns), projection.left_under(columns)
    np.testing.assert_allclose(left.T @ left + under.T @ under, columns.T @ ridge @ columns, atol=1e-9)
    errors = random.standard_normal(200)
    step = inverse @ (a.T @ errors + d.T @ residual)  # of the fit that takes both into account
    np.testing.assert_allclose(projection(errors, projection.known.residual), errors - a @ step, atol=1e-10)


def test_scores_of_draws_have_the_covariance_that_is_stated() -> None:
    """4000 draws of pixels and of what is known: a variance is known to a fortieth."""
    random = np.random.default_rng(1)
    tangent = random.standard_normal((60, 2))
    known = PartlyKnown(np.array([[12.0, 0.0]]), np.zeros(1))
    projection = TangentProjection(tangent, np.ones(60), known)
    template = tangent[:, 0] + 0.3 * random.standard_normal(60)  # what the known parameter could imitate
    template /= np.linalg.norm(template)
    draws, free = random.standard_normal((60, 4000)), TangentProjection(tangent, np.ones(60))
    scores = template @ projection(draws, known.drawn(random, 4000))
    left, under = projection(template[:, None]), projection.left_under(template[:, None])
    stated = float((left.T @ left + under.T @ under)[0, 0])
    assert scores.var() == pytest.approx(stated, rel=0.1)
    # 12 of a norm of some 8: two thirds of the template's energy are kept, of which a free parameter leaves a tenth
    assert stated > 5.0 * float(np.sum(free(template) ** 2))


def test_models_told_to_other_ranks_and_checkpoints_are_known_about_the_same(tmp_path: Path) -> None:
    scene = scene_with({"point_spread": BLUR}, tmp_path)
    scene = declaring(scene, point_spread={**BLUR, "range_fwhm_m": 0.6, "tolerance": KNOWN})
    device = devices.resolve_device("cpu")
    setup = FitSetup(device, Rays(Stage.of(scene, device), 64.0 / scene.grid.pixel_area_m2, 0), {})
    base = fit_model(setup, scene, 0, 0)
    further = fit_model(setup, base.scene, 0, 0)
    for given, fitted in ((scene, base), (base.scene, further)):
        heard = Fitted.of(setup, given, json.loads(json.dumps(fitted.content())))
        assert heard.scene.effects == fitted.scene.effects
        assert heard.scene.effects["point_spread"]["tolerance"]["range_fwhm_m"] == {"about": 0.6, "sd": 0.03}
        for problem in (heard.problem, fitted.problem):
            assert [(one.about, one.sd) for one in problem.prior.known] == [(0.6, 0.03), (0.7, pytest.approx(0.035))]
    # it does not creep: the second fit is the first one, with the tolerance where it was
    wide = base.scene.effects["point_spread"]["range_fwhm_m"]
    assert wide > 0.63
    assert further.scene.effects["point_spread"]["range_fwhm_m"] == pytest.approx(wide, abs=0.003)
    assert base.log_likelihood == pytest.approx(
        -base.problem.value(base.problem.modelled(base.x)) - base.problem.prior.value(base.x)
    )


def diagnosed(scene: Scene, folder: Path, status: int = 0) -> Ran:
    scene = saved(scene, folder)
    words = ["diagnose", str(folder / "scene.toml"), "-o", str(folder / "out"), "--device", "cpu", "--draws", "400"]
    done = CliRunner().invoke(main, [*words, "--starts", "0", "--most-effects", "2"])
    assert done.exit_code == status, done.output
    content = json.loads((folder / "out" / "diagnosis.json").read_text())
    print(*(one["after"]["words"] for one in content["tolerances"].values()), sep="\n")
    return Ran(scene, folder / "out", content, done.stdout, done.stderr)


@pytest.mark.full
def test_a_blur_that_is_known_about_rightly_keeps_its_tolerance(tmp_path: Path) -> None:
    scene = scene_with({"eps_gradient": SLOPE, "point_spread": BLUR}, tmp_path)
    about = {**BLUR, "range_fwhm_m": 0.92, "tolerance": KNOWN}
    ran = diagnosed(declaring(scene, point_spread=about), tmp_path)
    assert ran.content["verdict"] == ["eps_gradient"]
    assert ran.content["leaves_tolerance"] == []
    for label, one in ran.content["tolerances"].items():
        for each in one.values():
            assert not each["alarm"], label
            assert abs(each["pull"]) < 3.0
        assert one["after"]["posterior_sd"] < one["after"]["prior_sd"]
    found = ran.content["tolerances"]["point_spread.range_fwhm_m"]["after"]
    assert (found["prior"], found["prior_sd"]) == (0.92, 0.03)
    assert found["posterior"] == pytest.approx(BLUR["range_fwhm_m"], abs=3.0 * found["posterior_sd"])
    kept = Scene.load(ran.out / "scene.toml").effects["point_spread"]
    assert kept["tolerance"] == {key: {"about": about[key], "sd": sd} for key, sd in KNOWN.items()}
    assert kept["range_fwhm_m"] == pytest.approx(found["posterior"])
    assert "tolerance" not in Scene.load(ran.out / "scene.toml").effects["eps_gradient"]
    assert found["words"] in ran.stderr
    assert "known to a tolerance" in (ran.out / "report.html").read_text()


@pytest.mark.slow
def test_a_blur_that_is_known_wrongly_is_an_alarm(tmp_path: Path) -> None:
    """The scene knows 0.45 +- 0.02 m where the images have 0.9 m: no all-clear, and nothing that stands in for it is
    named. The console, the JSON and the report say which value it is. The last fit, with edges, comes near the truth.
    """
    scene = scene_with({"point_spread": BLUR}, tmp_path)
    wrong = {**BLUR, "range_fwhm_m": 0.45, "tolerance": {"range_fwhm_m": 0.02}}
    ran = diagnosed(declaring(scene, point_spread=wrong), tmp_path, UNEXPLAINED)
    assert ran.content["leaves_tolerance"] == ["point_spread.range_fwhm_m"]
    assert "point_spread.range_fwhm_m leaves its tolerance" in ran.content["reasons"]
    assert ran.content["verdict"] == []
    found = ran.content["tolerances"]["point_spread.range_fwhm_m"]["after"]
    assert found["alarm"]
    assert found["tension"] > 3.0
    assert found["posterior"] == pytest.approx(BLUR["range_fwhm_m"], rel=0.15)
    said = "point_spread.range_fwhm_m leaves its tolerance: known as 0.45 +- 0.02 m"
    assert said in ran.stderr
    assert said.replace("+- ", "±\u00a0") in (ran.out / "report.html").read_text()
