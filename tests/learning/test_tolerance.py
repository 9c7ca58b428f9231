"""Values known to a tolerance: the scene's tables, the prior of a fit, and what pulls against it."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from effect_worlds import refusal
from learning_scenes import START, TRUTH, cube_scene, measured, noise_free, starting, views_at
from test_held_effects import BLUR, declaring
from test_learn import field_scene, save_scene, with_material

from warpsar.errors import InputError
from warpsar.kernels.codes import Scale
from warpsar.kernels.loss import prior_kernel
from warpsar.learning import command as learning
from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.identify import identify, of_information
from warpsar.learning.learn import LearnOptions, learn
from warpsar.learning.optimise import FitState, begin, levenberg_marquardt
from warpsar.learning.prior import DevicePrior, Known, Prior
from warpsar.learning.problem import FitProblem
from warpsar.learning.pull import pulls
from warpsar.learning.results import learned_scene
from warpsar.runtime import devices
from warpsar.runtime.distributed import processes
from warpsar.runtime.distributed.processes import Sharing
from warpsar.scene.file import parse
from warpsar.scene.scene import Scene
from warpsar.world.transform import Transform

OPTIONS = LearnOptions(starts=1, iterations=15)
KNOWN_BLUR = {**BLUR, "tolerance": {"range_fwhm_m": 0.05, "azimuth_fwhm_m": "5 %"}}


@pytest.fixture(scope="module")
def blurred(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Two train views of a cube on a plane, whose images are blurred."""
    truth = cube_scene(views_at((20.0, 40.0), (140.0, 50.0)), polarizations=("HH",))
    truth = replace(truth, effects={"point_spread": dict(BLUR)})
    return starting(measured(truth, tmp_path_factory.mktemp("blurred")))


def problem_of(scene: Scene, **more: Any) -> FitProblem:
    return FitProblem(scene, devices.resolve_device("cpu"), **more)


# ---- tables ----

MOVES = "allowed are parameters of this table that a fit moves"


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        ("noise_floor", {"level": 1.0, "tolerance": 0.1}, "tolerance: found 0.1; allowed is a table; " + MOVES),
        ("noise_floor", {"level": 1.0, "tolerance": {"floor": 0.1}}, f"found 'floor'; {MOVES} (level)"),
        ("noise_floor", {"tolerance": {"level": 0.1}}, f"found 'level'; {MOVES} (it moves none)"),
        (
            "noise_floor",
            {"level": 1.0, "fixed": True, "tolerance": {"level": 0.1}},
            f"effects.noise_floor.tolerance: found 'level'; {MOVES} (it moves none)",
        ),
        ("point_spread", {**BLUR, "tolerance": {"window": 0.1}}, f"'window'; {MOVES} (range_fwhm_m, azimuth_fwhm_m)"),
        (
            "point_spread",
            {**BLUR, "learn": ["range_fwhm_m"], "tolerance": {"azimuth_fwhm_m": 0.1}},
            f"tolerance: found 'azimuth_fwhm_m'; {MOVES} (range_fwhm_m)",
        ),
        (
            "noise_floor",
            {"level": 1.0, "tolerance": {"level": 0.0}},
            "effects.noise_floor.tolerance.level: found 0.0; allowed is one standard deviation: a number above 0",
        ),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": -1}}, "tolerance.level: found -1; allowed is one"),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": True}}, "tolerance.level: found True; allowed is one"),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": float("nan")}}, "level: found nan; allowed is one"),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": float("inf")}}, "level: found inf; allowed is one"),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": "5"}}, "level: found '5'; allowed is one standard"),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": "-5 %"}}, "level: found '-5 %'; allowed is one standard"),
        ("noise_floor", {"level": 1.0, "tolerance": {"level": "0.0 %"}}, "level: found '0.0 %'; allowed is one"),
        (
            "noise_floor",
            {"level": 0.0, "tolerance": {"level": "5 %"}},
            "tolerance.level: found '5 %' of 0; allowed is a number above 0 in the key's unit",
        ),
        (
            "view_gain",
            {"gain_db": {"v0": 1.0, "v1": 0.0}, "tolerance": {"gain_db": "5 %"}},
            "tolerance.gain_db: found '5 %' of v1 0; allowed is a number above 0",
        ),
        (
            "antenna_pattern",
            {"beamwidth_m": float("inf"), "tolerance": {"beamwidth_m": 3.0}},
            "tolerance.beamwidth_m: found a tolerance of the value inf; allowed is one of a finite number",
        ),
        (
            "noise_floor",
            {"level": 1.0, "tolerance": {"level": {"about": 2.0}}},
            "tolerance.level: found {'about': 2.0}; allowed is a table of exactly about and sd",
        ),
        (
            "noise_floor",
            {"level": 1.0, "tolerance": {"level": {"about": -2.0, "sd": 1.0}}},
            "tolerance.level.about: found -2.0; allowed is 0 to 1e+09",
        ),
        (
            "noise_floor",
            {"level": 1.0, "tolerance": {"level": {"about": {"v0": 1.0}, "sd": 1.0}}},
            "tolerance.level.about: found {'v0': 1.0}; allowed is a number",
        ),
        (
            "view_gain",
            {"gain_db": {"v0": 1.0, "v1": 2.0}, "tolerance": {"gain_db": {"about": {"v0": 1.0}, "sd": 1.0}}},
            "tolerance.gain_db.about: found {'v0': 1.0}; allowed is a table of the views v0, v1",
        ),
    ],
)
def test_tables_of_effects_refuse(name: str, table: dict[str, Any], message: str) -> None:
    assert message in refusal(name, table)


@pytest.mark.parametrize(
    ("tolerance", "message"),
    [
        (0.1, "materials.soil.tolerance: found 0.1; must be"),
        ({"eps": 0.1}, "materials.soil.tolerance.eps: found 'eps'; must be 'eps_r'"),
        ({"specular_fraction": 0.1}, "tolerance: found specular_fraction; allowed are values that `learn` names (eps"),
        ({"eps_r": 0}, "materials.soil.tolerance: eps_r: found 0; allowed is one standard deviation"),
        ({"eps_r": "five %"}, "tolerance: eps_r: found 'five %'; allowed is one standard deviation"),
        ({"eps_r": {"about": 0.5, "sd": 1.0}}, "tolerance: eps_r.about: found 0.5; must be a number above 1"),
        ({"rms_height_m": 0.1}, "tolerance: found rms_height_m, which is a field; allowed are values that are one"),
    ],
)
def test_tables_of_materials_refuse(tolerance: Any, message: str) -> None:
    soil = {"layout": "texture", "eps_r": 6.0, "rms_height_m": "h.exr", "correlation_length_m": 0.01}
    scene = {
        "scene": {"mesh": "a.obj"},
        "radar": {"frequency_hz": 9.6e9, "polarizations": ["HH"]},
        "image": {"shape": [8, 8], "spacing_m": [1.0, 1.0]},
        "materials": {"soil": {**soil, "tolerance": tolerance}},
        "views": [{"name": "a", "azimuth_deg": 0.0, "incidence_deg": 40.0}],
    }
    file, problems = parse(scene)
    assert file is None
    assert len(problems) == 1
    assert message in problems[0]


def test_a_saved_scene_keeps_its_tolerances(blurred: Scene, tmp_path: Path) -> None:
    scene = declaring(with_material(blurred, "cube", tolerance={"eps_r": "10 %"}), point_spread=KNOWN_BLUR)
    path = save_scene(scene, tmp_path)
    again = Scene.load(path)
    assert again.effects == scene.effects
    assert again.materials["cube"].tolerance == {"eps_r": "10 %"}
    again.save(tmp_path / "third.toml")
    assert (tmp_path / "third.toml").read_text() == path.read_text()


# ---- the prior ----


def test_a_prior_is_gaussian_in_the_value(blurred: Scene) -> None:
    """Its numbers by hand: each coordinate's value, less what is known, over one standard deviation."""
    scene = with_material(blurred, "cube", tolerance={"eps_r": 2.0, "rms_height_m": "10 %"})
    scene = with_material(scene, "ground", specular_fraction=0.2, learn=("specular_fraction",))
    scene = with_material(scene, "ground", tolerance={"specular_fraction": 0.05})
    scene = declaring(scene, point_spread=KNOWN_BLUR, view_gain={"gain_db": {"v0": 1.0}, "tolerance": {"gain_db": 0.5}})
    problem = problem_of(scene)
    assert [one.label for one in problem.prior.known] == [
        "ground.specular_fraction",
        "cube.eps_r",
        "cube.rms_height_m",
        "point_spread.range_fwhm_m",
        "point_spread.azimuth_fwhm_m",
        "view_gain.gain_db[v0]",
    ]
    assert problem.prior.value(problem.x0) == pytest.approx(0.0, abs=1e-12)
    values = {"specular_fraction": 0.3, "eps_r": 12.0, "rms_height_m": 0.0009, "correlation_length_m": 0.009}
    logs = [np.log(0.3 / 0.7), np.log(11.0), np.log(0.0009), np.log(0.009), np.log(1.2), np.log(0.7), 0.4]
    # gains move in steps of 3 dB
    expected = [0.1 / 0.05, -3.0 / 2.0, 0.0002 / 0.00007, 0.3 / 0.05, 0.0, (1.2 - 1.0) / 0.5]
    assert START["cube"]["eps_r"] == 15.0
    x = np.array(logs)
    assert problem.labels[1:4] == [f"cube.{key}" for key in list(values)[1:]]
    assert problem.prior.deviations(x) == pytest.approx(expected, abs=1e-9)
    assert problem.prior.value(x) == pytest.approx(0.5 * np.sum(np.square(expected)))


def test_its_gradient_is_that_of_differences(blurred: Scene) -> None:
    scene = with_material(blurred, "cube", tolerance={"eps_r": 2.0, "rms_height_m": "10 %"})
    scene = with_material(
        scene,
        "ground",
        specular_fraction=0.2,
        learn=("eps_r", "specular_fraction"),
        tolerance={"specular_fraction": 0.05},
    )
    shift = {"up_m": 0.1, "tolerance": {"up_m": 1}}
    problem = problem_of(declaring(scene, point_spread=KNOWN_BLUR, registration=shift))
    x = problem.x0 + np.random.default_rng(3).normal(0.0, 0.3, problem.x0.size)
    step = 1e-6
    numeric = [
        (problem.prior.value(x + step * way) - problem.prior.value(x - step * way)) / (2.0 * step)
        for way in np.eye(x.size)
    ]
    # central differences of float64: truncation of step^2, rounding of 1e-16 / step
    assert problem.prior.gradient(x) == pytest.approx(np.array(numeric), rel=1e-6, abs=1e-6)
    # at what is known the curvature is the information, whatever the coordinates
    second = [
        (problem.prior.gradient(problem.x0 + step * way) - problem.prior.gradient(problem.x0 - step * way)) / (2 * step)
        for way in np.eye(x.size)
    ]
    assert problem.prior.information(problem.x0) == pytest.approx(np.array(second), rel=1e-5, abs=1e-5)


def test_the_fit_adds_it_to_loss_and_gradient_once(blurred: Scene) -> None:
    known = declaring(with_material(blurred, "cube", tolerance={"eps_r": 1.0}), point_spread=KNOWN_BLUR)
    free = declaring(blurred, point_spread=BLUR)
    one, other = problem_of(known), problem_of(free)
    x = one.x0 + 0.2
    (with_it, slopes), (without, plain) = one.gradient(x), other.gradient(x)
    assert with_it - without == pytest.approx(one.prior.value(x), rel=1e-9)
    assert slopes - plain == pytest.approx(one.prior.gradient(x), rel=1e-9, abs=1e-9)
    assert one.loss_at(x) - other.loss_at(x) == pytest.approx(one.prior.value(x), rel=1e-9)
    one.modelled(x), other.modelled(x)
    assert one.penalty(x) - other.penalty(x) == pytest.approx(one.prior.value(x))


class Alike(Sharing):
    """As if another rank held the same views: every sum is twice this rank's."""

    def sum(self, array: Any) -> np.ndarray:
        return 2.0 * super().sum(array)


def test_processes_count_it_once(blurred: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_here", Alike())
    known = declaring(with_material(blurred, "cube", tolerance={"eps_r": 1.0}), point_spread=KNOWN_BLUR)
    problem, free = problem_of(known, shared=True), problem_of(declaring(blurred, point_spread=BLUR))
    x = problem.x0 + 0.2
    (loss, slopes), (images, plain) = problem.gradient(x), free.gradient(x)
    assert loss == pytest.approx(2.0 * images + problem.prior.value(x), rel=1e-9)
    assert slopes == pytest.approx(2.0 * plain + problem.prior.gradient(x), rel=1e-9, abs=1e-9)
    assert problem.penalty(x) == pytest.approx(problem.prior.value(x))
    twice, once = identify(problem, x).information, identify(free, x).information
    assert twice == pytest.approx(2.0 * once + problem.prior.information(x), rel=1e-9, abs=1e-9)


def test_on_the_device_it_is_the_same(blurred: Scene) -> None:
    """The kernel that CUDA graphs replay, here on the CPU, against the host's; only the first rank counts it."""
    blurred = replace(blurred, effects={})
    known = with_material(blurred, "cube", tolerance={"eps_r": 1.0, "correlation_length_m": "5 %"})
    known = with_material(
        known, "ground", specular_fraction=0.2, learn=("specular_fraction",), tolerance={"specular_fraction": "5 %"}
    )
    problem = problem_of(known)
    x = problem.x0 + np.linspace(-0.4, 0.4, problem.x0.size)
    for first in (True, False):
        on_device = DevicePrior(problem.prior, problem, problem.device, counts=first)
        nodes: wp.array = wp.array(problem.float_nodes(x), dtype=float, requires_grad=True, device=problem.device)
        nodes.grad.zero_()
        on_device.run(nodes)
        value, gradient = float(on_device.loss.numpy().sum()), nodes.grad.numpy()[problem.learned]
        expected = problem.prior.gradient(x)[: problem.learned.size]
        # the nodes are float32
        assert value == pytest.approx(problem.prior.value(x) * first, rel=1e-5)
        assert gradient == pytest.approx(expected * first, rel=1e-5)


@pytest.mark.parametrize("scale", ["linear", "log", "contrast", "logit"])
def test_on_the_device_it_is_that_of_every_coordinate(scale: Any) -> None:
    transform, x = Transform(scale), 0.3
    nodes: wp.array = wp.array([x], dtype=float, device="cpu")
    gradient, loss = wp.zeros(1, dtype=float, device="cpu"), wp.zeros(1, dtype=wp.float64, device="cpu")
    known = [wp.array([value], dtype=kind, device="cpu") for value, kind in ((0, int), (Scale[scale.upper()], int))]
    known += [wp.array([value], dtype=wp.float64, device="cpu") for value in (0.2, 0.05)]
    wp.launch(prior_kernel, 1, inputs=[*known, nodes], outputs=[gradient, loss], device="cpu")
    deviation = (transform.from_coordinate(x) - 0.2) / 0.05
    # the node is float32
    assert float(loss.numpy()[0]) == pytest.approx(0.5 * deviation**2, rel=1e-6)
    assert float(gradient.numpy()[0]) == pytest.approx(deviation * transform.slope(x) / 0.05, rel=1e-6)


@pytest.mark.parametrize("loss", ["gamma", "log", "mse"])
def test_only_likelihoods_take_it(loss: str, blurred: Scene) -> None:
    known = declaring(blurred, point_spread=KNOWN_BLUR)
    if loss != "mse":
        assert problem_of(known, loss=loss).prior.known
        return
    with pytest.raises(InputError, match=r"--loss: found mse, and .* knows point_spread.range_fwhm_m to a tolerance"):
        problem_of(known, loss=loss)


# ---- what is found ----


class Line:
    """Numbers y = a x + speckle of unit variance, as much of a fit problem as a `Pull` needs; x is one number."""

    def __init__(self, about: float, sd: float) -> None:
        known = Known("line.a", 0, about, sd, "1", lambda x: x, lambda x: 1.0)
        self.prior, self.zero_sum_means = Prior([known], 1), np.zeros((0, 1))
        self.bounds = np.array([-1e3]), np.array([1e3])


@pytest.mark.parametrize(("about", "sd"), [(1.0, 0.1), (2.0, 0.3), (2.2, 5.0)])
def test_a_line_is_that_of_the_closed_form(about: float, sd: float) -> None:
    """Gaussian times Gaussian: precision adds up, means are weighted by it, and the data alone are found again."""
    abscissae = np.linspace(0.0, 3.0, 20)
    y = 2.0 * abscissae + np.random.default_rng(1).normal(size=20)
    data, data_sd = (abscissae @ y) / (abscissae @ abscissae), 1.0 / np.sqrt(abscissae @ abscissae)
    posterior_sd = 1.0 / np.sqrt(1.0 / data_sd**2 + 1.0 / sd**2)
    posterior = posterior_sd**2 * (data / data_sd**2 + about / sd**2)
    line: Any = Line(about, sd)
    x = np.array([posterior])
    # the posterior is where loss and prior are flat together
    gradient = -abscissae @ (y - posterior * abscissae) + line.prior.gradient(x)
    assert gradient == pytest.approx(0.0, abs=1e-9)
    information = np.array([[1.0 / data_sd**2]]) + line.prior.information(x)
    (found,) = pulls(line, x, of_information(["line.a"], information, information))
    assert found.posterior_sd == pytest.approx(posterior_sd)
    assert found.pull == pytest.approx((posterior - about) / sd)
    assert (found.data, found.data_sd) == (pytest.approx(data), pytest.approx(data_sd))
    assert found.tension == pytest.approx((data - about) / np.hypot(sd, data_sd))
    assert found.alarm == (abs(found.tension or 0.0) > 3.0) == (about == 1.0)


def test_the_images_alone_are_the_information_less_the_own() -> None:
    """Of five numbers, each `data_sd` is that of the whole matrix inverted without its own prior; one is not seen."""
    random = np.random.default_rng(2)
    root = random.normal(size=(5, 5))
    root[3] = 0.0
    of_data, scatter = root @ root.T, random.normal(size=(5, 5))
    scatter = of_data + scatter @ scatter.T * np.outer(np.diag(of_data) > 0, np.diag(of_data) > 0)
    sds = np.array([0.1, 1.0, 3.0, 0.5, 10.0])
    line: Any = Line(0.0, 1.0)
    known = [Known(f"n{k}.a", k, 0.0, sd, "1", lambda x: x, lambda x: 1.0) for k, sd in enumerate(sds)]
    line.prior, line.zero_sum_means = Prior(known, 5), np.zeros((0, 5))
    line.bounds = np.full(5, -9e9), np.full(5, 9e9)
    information, products = (one + np.diag(1.0 / sds**2) for one in (of_data, scatter))
    found = pulls(line, np.ones(5), of_information([one.label for one in known], information, products))
    for k, (pull, sd) in enumerate(zip(found, sds, strict=True)):
        if k == 3:
            assert pull.data_sd is None
            continue
        own = np.zeros((5, 5))
        own[k, k] = 1.0 / sd**2
        inverse = np.linalg.inv(information - own)
        assert pull.data_sd == pytest.approx(np.sqrt((inverse @ (products - own) @ inverse)[k, k]), rel=1e-9)


def test_levenberg_marquardt_arrives_where_nothing_pulls_any_more(blurred: Scene) -> None:
    """At the end a step promises less than a hundredth in log-likelihood, though the images pull at what is known."""
    wrong = {**BLUR, "range_fwhm_m": 0.7, "tolerance": {"range_fwhm_m": 0.02}}
    problem = problem_of(declaring(with_material(blurred, "cube", tolerance={"eps_r": "2 %"}), point_spread=wrong))
    state: FitState = begin(problem, 0, 0)
    while not state.arrived and state.iteration < 30:
        state = levenberg_marquardt(problem, state)
    assert state.arrived
    x = np.asarray(state.best_x)
    free = problem_of(declaring(blurred, point_spread=BLUR))
    total, images = problem.gradient(x)[1], free.gradient(x)[1]
    information = identify(problem, x).information
    inverse = np.linalg.pinv(information, rcond=1e-9, hermitian=True)  # HH alone does not see all of the ground
    assert 0.5 * total @ inverse @ total < 1e-2
    blur = problem.labels.index("point_spread.range_fwhm_m")
    assert abs(images[blur]) > np.sqrt(information[blur, blur])


@pytest.mark.full
def test_a_wrong_tolerance_is_an_alarm(blurred: Scene, tmp_path: Path) -> None:
    """The blur is 0.9 m wide in range; who knows it as 0.6 +- 0.02 is told, and what he should have known."""
    wrong = {**BLUR, "range_fwhm_m": 0.6, "tolerance": {"range_fwhm_m": 0.02, "azimuth_fwhm_m": "10 %"}}
    path = save_scene(declaring(blurred, point_spread=wrong), tmp_path)
    content = learning.run(path, tmp_path / "out", device="cpu", options=OPTIONS)
    found = json.loads((tmp_path / "out" / "learn.json").read_text())["tolerances"]
    pulled, kept = found["point_spread.range_fwhm_m"], found["point_spread.azimuth_fwhm_m"]
    assert content["leaves_tolerance"] == ["point_spread.range_fwhm_m"]
    assert (pulled["alarm"], kept["alarm"]) == (True, False)
    assert (pulled["prior"], pulled["prior_sd"], pulled["unit"]) == (0.6, 0.02, "m")
    assert kept["prior_sd"] == pytest.approx(0.07)
    assert pulled["pull"] == pytest.approx((pulled["posterior"] - 0.6) / 0.02)
    assert pulled["tension"] > 3.0
    assert not content["intervals_hold"]
    assert any("range_fwhm_m leaves its tolerance: known as 0.6 +- 0.02 m" in reason for reason in content["reasons"])
    # the scene that comes out is still known about 0.6: fitted again it stays where it is
    again = Scene.load(tmp_path / "out" / "scene.toml")
    assert again.effects["point_spread"]["tolerance"]["range_fwhm_m"] == {"about": 0.6, "sd": 0.02}
    refitted = learn(again, device="cpu", options=OPTIONS)
    value = refitted.scene.effects["point_spread"]["range_fwhm_m"]
    assert value == pytest.approx(again.effects["point_spread"]["range_fwhm_m"], abs=0.1 * pulled["posterior_sd"])
    tables = tomllib.loads((tmp_path / "out" / "scene.toml").read_text())
    assert tables["effects"]["point_spread"]["tolerance"]["azimuth_fwhm_m"] == {"about": 0.7, "sd": "10 %"}


@pytest.mark.full
def test_a_right_tolerance_narrows_the_interval_and_is_no_alarm(blurred: Scene) -> None:
    right = with_material(blurred, "cube", eps_r=10.3, tolerance={"eps_r": 0.5})
    found = learn(declaring(right, point_spread=KNOWN_BLUR), device="cpu", options=OPTIONS)
    free = learn(declaring(blurred, point_spread=BLUR), device="cpu", options=OPTIONS)
    assert not any(one.alarm for one in found.pulls)
    assert not free.pulls
    assert found.identified is not None
    assert free.identified is not None
    at = found.labels.index("cube.eps_r")
    assert found.identified.sd[at] < min(free.identified.sd[at], 0.5 / 9.0)
    # the images alone, to first order at the posterior, say what a fit without a tolerance finds
    eps, blur, _ = found.pulls
    assert blur.data == pytest.approx(free.scene.effects["point_spread"]["range_fwhm_m"], abs=0.5 * (blur.data_sd or 0))
    assert eps.data_sd is not None
    assert eps.data_sd > 0.5


def test_learned_scenes_and_problems_of_few_views_keep_what_is_known(blurred: Scene) -> None:
    scene = declaring(
        with_material(blurred, "cube", eps_r=(15.0, -1.0), tolerance={"eps_r": "20 %"}),
        view_gain={"gain_db": {"v0": 1.0, "v1": 0.5}, "tolerance": {"gain_db": 0.4}},
    )
    problem = problem_of(scene)
    moved = learned_scene(problem, problem.x0 + 0.3)
    assert moved.materials["cube"].tolerance == {"eps_r": {"about": 15.0, "sd": "20 %"}}
    assert moved.effects["view_gain"]["tolerance"] == {"gain_db": {"about": {"v0": 1.0, "v1": 0.5}, "sd": 0.4}}
    for views, labels in ((None, ["[v0]", "[v1]"]), (["v1"], ["[v1]"])):
        again = problem_of(moved, views=views).prior
        assert [one.label for one in again.known] == ["cube.eps_r", *(f"view_gain.gain_db{label}" for label in labels)]
        assert [one.about for one in again.known] == [15.0, 1.0, 0.5][: 1 + len(labels)] or views == ["v1"]
    assert [one.about for one in problem_of(moved, views=["v1"]).prior.known] == [15.0, 0.5]


@pytest.mark.full
def test_a_number_beside_a_field_is_known_too(tmp_path: Path) -> None:
    """Adam, which has no information matrix: the pull alone is told. Without data eps_r would go back to 9."""
    scene = field_scene(tmp_path)
    tolerance = {"eps_r": {"about": 9.0, "sd": 0.1}}
    soil = scene.materials["soil"].model_copy(update={"learn": ("eps_r", "rms_height_m"), "tolerance": tolerance})
    scene = replace(scene, materials={"soil": soil})
    found = learn(scene, device="cpu", options=LearnOptions(iterations=30))
    (pull,) = found.pulls
    assert (pull.label, pull.prior, pull.prior_sd) == ("soil.eps_r", 9.0, 0.1)
    assert (pull.posterior_sd, pull.data, pull.tension) == (None, None, None)
    assert pull.posterior == pytest.approx(found.scene.materials["soil"].eps_r)
    assert pull.pull == pytest.approx((pull.posterior - 9.0) / 0.1)
    assert pull.alarm  # the images have 6
    assert any("soil.eps_r leaves its tolerance" in reason for reason in found.doubts)


@pytest.mark.cuda
def test_the_captured_graph_knows_it(tmp_path: Path) -> None:
    """Adam on the CPU and the captured graph on CUDA, as in test_learn.py; 16 looks against 9 +- 0.05 of an eps_r."""
    scene = field_scene(tmp_path)
    tolerance = {"eps_r": {"about": 9.0, "sd": 0.05}}
    soil = scene.materials["soil"].model_copy(update={"learn": ("eps_r", "rms_height_m"), "tolerance": tolerance})
    scene = replace(scene, materials={"soil": soil})
    ends, losses = [], []
    for alias, way, steps in (("cpu", Adam, 40), ("cuda", GraphAdam, 40 // GraphAdam.STRIDE)):
        problem = FitProblem(scene, devices.resolve_device(alias))
        state = begin(problem, 0, 0)
        descent = way(problem, state, 0.02)
        for _ in range(steps):
            state = descent.step(state)
        ends.append(np.asarray(state.x))
        losses.append(state.loss)
    known = problem.prior.known[0].at
    assert problem.prior.value(ends[0]) > 10.0  # it has a part in the loss, and has moved eps_r
    assert ends[0][known] > problem.x0[known] + 0.05
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert ends[1][known] == pytest.approx(ends[0][known], abs=1e-2)


@pytest.mark.cuda
def test_lm_on_cuda_knows_it(blurred: Scene) -> None:
    wrong = {**BLUR, "range_fwhm_m": 0.7, "tolerance": {"range_fwhm_m": 0.02}}
    scene = declaring(with_material(blurred, "cube", tolerance={"eps_r": 1.0}), point_spread=wrong)
    cpu, cuda = (learn(scene, device=alias, options=OPTIONS) for alias in ("cpu", "cuda"))
    for one, other in zip(cpu.pulls, cuda.pulls, strict=True):
        assert other.posterior == pytest.approx(one.posterior, abs=0.1 * (one.posterior_sd or 0.0))


@pytest.mark.slow
def test_intervals_hold_with_a_right_prior(tmp_path: Path) -> None:
    """20 repeats, each with speckle of its own and a tolerance drawn about the truth: 19 of 20 intervals at 95 %.

    The six parameters of a repeat are those of two materials, which err together: 40 draws, of which a true 95 % shows
    33 or less once in 1500 such runs.
    """
    truth = cube_scene(views_at((20.0, 35.0), (140.0, 50.0)), polarizations=("HH", "VV"))
    images = noise_free(truth)
    held, alarms, tensions = [], 0, []
    for seed in range(20):
        folder = tmp_path / str(seed)
        folder.mkdir()
        scene = starting(measured(truth, folder, looks=16.0, seed=seed, images=images))
        known = TRUTH["cube"]["eps_r"] + 1.0 * np.random.default_rng([7, seed]).normal()
        scene = with_material(scene, "cube", eps_r=known, tolerance={"eps_r": 1.0})
        found = learn(scene, device="cpu", options=LearnOptions(starts=1))
        assert found.identified is not None
        for label, at, sd in zip(found.labels, found.x, found.identified.sd, strict=True):
            name, key = label.split(".")
            kind = next(b.kind for b in found.problem.surface.blocks if b.kind.key == key)
            if sd < 0.5:
                held.append(abs(at - float(kind.to_coordinate(TRUTH[name][key]))) < 1.96 * sd)
        alarms += any(one.alarm for one in found.pulls)
        tensions += [one.tension for one in found.pulls]
    print(f"held {np.mean(held):.3f} of {len(held)}, alarms {alarms}, tensions sd {np.std(tensions):.2f}")
    assert np.mean(held) > 0.83
    assert alarms <= 1


@pytest.mark.unit
def test_a_prior_of_a_million_nodes_takes_no_square_of_them() -> None:
    """A field has as many elements as texels; nothing is known of most. Their square would be 8 TB."""
    size = 10**6
    known = Known("soil.eps_r", 7, 5.0, 2.0, "1", lambda x: 4.0 + x, lambda x: 1.0)
    prior = Prior((known,), size, slice(size - 2, size))
    x = np.zeros(size)
    x[7], x[-2:] = 2.0, (0.5, -1.0)
    assert prior.value(x) == pytest.approx(0.5 * (0.5**2 + 0.5**2 + 1.0))
    gradient = prior.gradient(x)
    assert {int(k): float(gradient[k]) for k in np.flatnonzero(gradient)} == {
        7: pytest.approx(0.25),
        size - 2: 0.5,
        size - 1: -1.0,
    }
