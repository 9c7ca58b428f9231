"""`warpsar learn` from end to end: refusals, what it finds, what no fit may touch, files."""

import csv
import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from click.testing import CliRunner
from learning_scenes import START, TRUTH, bumpy, cube_scene, measured, noise_free, starting, views_at
from scipy.ndimage import minimum_filter
from worlds import SOIL, WAVENUMBER, ground, mesh_of, scene_of, sigma0, view

from warpsar.cli.main import main
from warpsar.effects.registry import get, names
from warpsar.errors import InputError
from warpsar.io.images import read_channel, write_exr, write_tiff
from warpsar.io.ply import write_ply
from warpsar.learning import command as learning
from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.command import LearnOptions, learn
from warpsar.learning.gradcheck import TOLERANCE, _differences, check_gradient
from warpsar.learning.metrics import pooled_metrics
from warpsar.learning.optimise import FitState, begin, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.trust import outside_domains
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.speckle.likelihood import metrics, metrics_of
from warpsar.surface.surface import KEYS, KINDS
from warpsar.world.tables import Material, Sampling

ANGLES = ((20.0, 35.0), (140.0, 50.0))


@pytest.fixture(scope="module")
def clean() -> tuple[Scene, list[dict[str, np.ndarray]]]:
    """The true cube on a plane, a train and a test view each way, and its images without speckle."""
    truth = cube_scene(views_at(*ANGLES))
    truth = replace(truth, views=[*truth.views, view(80.0, 42.0, name="test", role="test")])
    return truth, noise_free(truth)


@pytest.fixture
def cube(clean: tuple[Scene, list[dict[str, np.ndarray]]], tmp_path: Path) -> Scene:
    """The start, with images of 16 looks of the truth."""
    truth, images = clean
    return starting(measured(truth, tmp_path, looks=16.0, images=images))


def true_x() -> np.ndarray:
    return np.array(
        [float(kind.to_coordinate(TRUTH[name][kind.key])) for name in ("ground", "cube") for kind in KINDS[:3]]
    )


def with_material(scene: Scene, name: str, **values: Any) -> Scene:
    changed = Material(**{**scene.materials[name].model_dump(exclude_unset=True), **values})
    return replace(scene, materials={**scene.materials, name: changed})


def save_scene(scene: Scene, folder: Path) -> Path:
    """A scene made in memory as files; materials by OBJ groups."""
    from warpsar.scene.unwrap import write_obj

    folder.mkdir(parents=True, exist_ok=True)
    write_obj(folder / "mesh.obj", scene.mesh)
    replace(scene, mesh_path=(folder / "mesh.obj").resolve()).save(folder / "scene.toml")
    return folder / "scene.toml"


# ---- refusals ----


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"eps_r": 1.0000001}, "eps_r: found a start at 1; .*dead point"),
        ({"eps_r": (1.0000001, -0.5)}, "eps_r: found a start at 1; .*dead point"),
        ({"eps_r": 400.0}, "eps_r: found a start at 400; to be learned it must be from 1.01 to 300"),
        ({"specular_fraction": 0.0, "learn": KEYS}, "specular_fraction: found a start at 0; .*logit is infinite"),
        ({"specular_fraction": 1.0, "learn": KEYS}, "specular_fraction: found a start at 1; .*logit is infinite"),
    ],
)
def test_starts_that_cannot_be_left_are_refused(values: dict[str, Any], message: str, cube: Scene) -> None:
    with pytest.raises(InputError, match=message):
        learn(with_material(cube, "cube", **values), device="cpu")


@pytest.mark.full
def test_a_dead_start_is_no_matter_where_it_is_not_learned(cube: Scene) -> None:
    scene = with_material(cube, "cube", eps_r=1.001, learn=("rms_height_m",))
    learn(scene, device="cpu", options=LearnOptions(starts=1, iterations=2))


def test_nothing_to_learn_is_refused(cube: Scene) -> None:
    for name in ("ground", "cube"):
        cube = with_material(cube, name, learn=())
    with pytest.raises(InputError, match="nothing to learn"):
        learn(cube, device="cpu")


def test_no_train_images_are_refused(cube: Scene) -> None:
    with pytest.raises(InputError, match="none with role train has measured images"):
        learn(replace(cube, views=cube.views[2:]), device="cpu")
    bare = [v.model_copy(update={"images": {}}) for v in cube.views]
    with pytest.raises(InputError, match="none with role train has measured images"):
        learn(replace(cube, views=bare), device="cpu")
    # before rays are chosen by the looks of no image
    with pytest.raises(InputError, match="none with role train has measured images"):
        learn(replace(cube, views=bare, sampling=Sampling()), device="cpu")


@pytest.mark.parametrize("key", ["eps", "noise_floor", "max_bounces", "looks", ""])
def test_a_key_that_has_no_derivative_cannot_be_learned(key: str) -> None:
    with pytest.raises(InputError, match="eps_r"):
        Material(**SOIL, learn=(key,))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"total_variation": {"eps": 1.0}}, "--tv: found eps=1.0; allowed is one of eps_r, rms_height_m"),
        ({"total_variation": {"eps_r": -1.0}}, "--tv: found eps_r=-1.0"),
        ({"total_variation": {"eps_r": math.nan}}, "--tv: found eps_r=nan"),
        ({"total_variation": {"eps_r": math.inf}}, "--tv: found eps_r=inf"),
        ({"loss": "l2"}, "--loss: found 'l2'; allowed are gamma, mse, log"),
        ({"optimiser": "sgd"}, "--optimiser: found 'sgd'; allowed are auto, lm, adam"),
    ],
)
def test_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        LearnOptions(**options)


def test_options_that_would_do_nothing_are_refused(cube: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--tv: found eps_r, of which no field .*none: no field is learned"):
        learn(cube, device="cpu", options=LearnOptions(total_variation={"eps_r": 1.0}))
    with pytest.raises(InputError, match="--optimiser: found lm, and a field to learn"):
        learn(field_scene(tmp_path), device="cpu", options=LearnOptions(optimiser="lm"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tv", "eps=3"], "found eps=3.0"),
        (["--tv", "eps_r"], "allowed is KEY=WEIGHT"),
        (["--tv", "eps_r=much"], "allowed is KEY=WEIGHT"),
        (["--loss", "l2"], "found 'l2'"),
        (["--starts", "0"], "0 is not in the range"),
    ],
)
def test_the_command_refuses_with_exit_2(arguments: list[str], message: str, cube: Scene, tmp_path: Path) -> None:
    scene = save_scene(cube, tmp_path / "scene")
    result = CliRunner().invoke(main, ["learn", str(scene), "-o", str(tmp_path / "out"), "--device", "cpu", *arguments])
    assert result.exit_code == 2
    assert message in result.output
    assert result.stdout == ""
    assert not (tmp_path / "out" / "learn.json").exists()


def test_the_scene_file_is_never_overwritten(cube: Scene, tmp_path: Path) -> None:
    scene = save_scene(cube, tmp_path / "scene")
    before = scene.read_bytes()
    result = CliRunner().invoke(main, ["learn", str(scene), "-o", str(scene.parent), "--device", "cpu"])
    assert result.exit_code == 2
    assert "would be replaced" in result.output
    assert scene.read_bytes() == before


# ---- what no fit may touch ----


@pytest.mark.full
def test_test_views_change_nothing_to_the_bit(cube: Scene, tmp_path: Path) -> None:
    options = LearnOptions(starts=2)
    one = learn(cube, device="cpu", options=options)
    for polarization, path in cube.views[2].images.items():
        write_tiff(path, 7.0 * read_channel(path, polarization)[::-1])
    other = learn(cube, device="cpu", options=options)
    none = learn(replace(cube, views=cube.views[:2]), device="cpu", options=options)
    assert one.test is not None
    assert other.test is not None
    assert none.test is None
    assert one.test["deviance"] < 1.1 < other.test["deviance"]
    for found in (other, none):
        np.testing.assert_array_equal(found.x, one.x)
        assert [row["loss"] for row in found.history] == [row["loss"] for row in one.history]
        assert found.density.rays_per_m2 == one.density.rays_per_m2


@pytest.mark.full
def test_materials_not_to_be_learned_stay_to_the_bit(cube: Scene, tmp_path: Path) -> None:
    scene = with_material(cube, "ground", learn=("rms_height_m",))
    found = learn(scene, device="cpu", options=LearnOptions(starts=1), folder=tmp_path)
    assert found.scene.materials["ground"].eps_r == START["ground"]["eps_r"]
    assert found.scene.materials["ground"].correlation_length_m == START["ground"]["correlation_length_m"]
    assert found.scene.materials["ground"].rms_height_m != START["ground"]["rms_height_m"]


# ---- what it finds ----


@pytest.mark.full
@pytest.mark.parametrize("loss", ["gamma", "log", "mse"])
def test_the_truth_lies_in_the_intervals(loss: str, cube: Scene) -> None:
    """Four standard deviations: 6 parameters fall outside in one run in 2600."""
    found = learn(cube, device="cpu", options=LearnOptions(loss=loss))
    assert found.identified is not None
    assert (np.abs(found.x - true_x()) < 4 * found.identified.sd).all()
    assert found.gradient_check.passed
    assert found.stopped == "plateau"
    assert found.test is not None
    # 2300 test pixels at 16 looks: the deviance's own standard deviation is 0.03
    assert found.test["deviance"] == pytest.approx(1.0, abs=0.1)
    assert pooled_metrics(found.problem, found.problem.x0)["deviance"] > 1.5


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("kind", KINDS, ids=KEYS)
def test_an_interval_of_what_is_hardly_known_is_wide(kind: Any) -> None:
    """With an unknown gain the deviation of eps_r may be thousands of log units: no float64 holds the end."""
    low, high = kind.interval((0.5 - 2e4, 0.5 + 2e4))
    assert low <= kind.low
    assert high >= kind.high
    low, high = kind.interval((0.3, 0.7))
    assert low < float(kind.from_coordinate(0.5)) < high
    assert kind.interval((-np.inf, 0.7)) == (None, pytest.approx(high))


@pytest.mark.full
@pytest.mark.parametrize("loss", ["gamma", "log", "mse"])
def test_unknown_gains_are_found(loss: str, cube: Scene) -> None:
    """Each image made brighter by its own factor; with h fixed on the ground, the factors can be told."""
    scene = with_material(cube, "ground", **TRUTH["ground"], learn=())
    factors = {}
    for one in scene.views:
        for i, (polarization, path) in enumerate(one.images.items()):
            factors[f"{one.name} {polarization}"] = 2.0 + i
            write_tiff(path, (2.0 + i) * read_channel(path, polarization))
    scene = replace(scene, grid=scene.grid.model_copy(update={"calibrated": False}))
    found = learn(scene, device="cpu", options=LearnOptions(loss=loss))
    problem = found.problem
    gains = problem.gains(problem.modelled(found.x))
    for seen, gain in zip(problem.observations, gains, strict=True):
        assert gain == pytest.approx(factors[f"{seen.view.name} {seen.polarization}"], rel=0.05)
    assert found.identified is not None
    assert (np.abs(found.x - true_x()[3:]) < 4 * found.identified.sd).all()


@pytest.mark.full
def test_adam_and_lm_reach_the_same_minimum(cube: Scene) -> None:
    """LM in tens of iterations. Adam stops on a plateau, which in a narrow valley is a little early: within half a
    log-likelihood, a standard deviation, of the minimum."""
    lm = learn(cube, device="cpu", options=LearnOptions(starts=1))
    adam = learn(cube, device="cpu", options=LearnOptions(optimiser="adam", iterations=3000, rate=0.02))
    assert len(lm.history) < 40
    assert len(adam.history) > 100
    assert lm.identified is not None
    assert lm.loss < adam.loss + 0.05
    assert adam.loss < lm.loss + 0.5
    assert (np.abs(adam.x - lm.x) < 1.0 * lm.identified.sd).all()


@pytest.mark.full
def test_a_start_at_the_minimum_stays_there(cube: Scene) -> None:
    """A run on a learned scene: every derivative is 0, and the gradient check must not take that for a defect."""
    first = learn(cube, device="cpu", options=LearnOptions(starts=1))
    again = learn(first.scene, device="cpu", options=LearnOptions(starts=1))
    assert first.identified is not None
    assert again.gradient_check.passed
    assert len(again.history) <= 3
    assert again.loss <= first.loss + 2e-3
    assert (np.abs(again.x - first.x) < 0.1 * first.identified.sd).all()


@pytest.mark.parametrize(("width", "place"), [(1.0, 0.3), (0.01, 0.005), (0.008, 0.008)])
def test_the_gradient_checks_steps_follow_the_loss(width: float, place: float) -> None:
    """ln(w^2 + (t - p)^2), as the loss of a dark pixel beside a bright point goes with a blur's width: slope
    -2 p / (w^2 + p^2) at 0, whatever is expected of it."""

    def loss(t: float) -> float:
        return float(np.log(width**2 + (t - place) ** 2))

    truth = -2.0 * place / (width**2 + place**2)
    for expected in (truth, 0.0):
        slope, _ = _differences(loss, loss(0.0), expected)
        assert slope == pytest.approx(truth, rel=TOLERANCE)


@pytest.mark.full
def test_the_gradient_check_sees_a_wrong_gradient(cube: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """One derivative of six 5 % off, at the start and at the minimum."""
    at_minimum = learn(cube, device="cpu", options=LearnOptions(starts=1)).x
    problem = FitProblem(cube, devices.resolve_device("cpu"))
    assert check_gradient(problem, problem.x0).worst < 2e-3
    assert check_gradient(problem, at_minimum).worst < 2e-3
    true_gradient = problem.gradient

    def wrong(x: np.ndarray) -> tuple[float, np.ndarray]:
        loss, gradient = true_gradient(x)
        return loss, gradient * [1, 1, 1.05, 1, 1, 1]

    monkeypatch.setattr(problem, "gradient", wrong)
    assert not check_gradient(problem, problem.x0).passed
    assert not check_gradient(problem, at_minimum).passed
    monkeypatch.setattr(FitProblem, "gradient", lambda self, x: wrong(x))
    with pytest.raises(Exception, match="gradient check failed"):
        learn(cube, device="cpu")


def plane_of_one_length(folder: Path, length: float) -> Scene:
    """A plane of which only l is to be learned, from one view: sigma0 rises to l = 1 / (k sin theta) and falls."""
    scene = scene_of(
        mesh_of(soil=ground(60.0)), views_at((0.0, 45.0), (0.0, 30.0)), shape=(16, 16), rays_per_pixel=16.0,
        materials={"soil": {"eps_r": 6.0, "rms_height_m": 0.0008, "correlation_length_m": length}},
    )  # fmt: skip
    seen = measured(scene, folder, looks=16.0)
    return replace(
        seen, materials={"soil": seen.materials["soil"].model_copy(update={"learn": ("correlation_length_m",)})}
    )


def test_further_starts_find_the_lower_minimum(tmp_path: Path) -> None:
    """Both sides of the maximum fit one angle; two angles tell them apart, yet leave a minimum on each side.

    The loss along l, drawn from the closed form, says where they are: the start's own is the worse one.
    """
    scene = plane_of_one_length(tmp_path, 0.0035)
    scene = replace(
        scene, materials={"soil": scene.materials["soil"].model_copy(update={"correlation_length_m": 0.014})}
    )
    angles = np.deg2rad([45.0, 30.0])
    truth = sigma0(angles, 6.0, 0.0008, 0.0035)
    lengths = np.exp(np.linspace(np.log(0.001), np.log(0.03), 2000))
    ratio = truth[:, None] / sigma0(angles[:, None], 6.0, 0.0008, lengths)
    curve = (ratio - 1 - np.log(ratio)).sum(axis=0)
    minima = np.flatnonzero((curve[1:-1] < curve[:-2]) & (curve[1:-1] < curve[2:])) + 1
    assert len(minima) == 2
    good, bad = lengths[minima]
    stuck = learn(scene, device="cpu", options=LearnOptions(starts=1))
    assert np.exp(stuck.x[0]) == pytest.approx(bad, rel=0.03)
    free = learn(scene, device="cpu", options=LearnOptions(starts=12))
    assert np.exp(free.x[0]) == pytest.approx(good, rel=0.03)
    assert free.loss < stuck.loss - 10
    assert {row["start"] for row in free.history} == set(range(12))


def test_lit_area_outside_the_domains(tmp_path: Path) -> None:
    """Of a plane seen at 40 degrees, all of it alike: kh, kl and the incidence angle decide, each condition once."""
    cases = [  # kh, kl; share outside SPM, and outside KA
        ((0.1, 1.0), (0.0, 1.0)),  # kh small for KA
        ((0.31, 5.0), (1.0, 1.0)),
        ((0.29, 1.3), (1.0, 1.0)),  # too steep for SPM
        ((2.2, 7.0), (1.0, 0.0)),
        ((2.2, 5.9), (1.0, 1.0)),  # kl
        ((2.2, 6.1), (1.0, 1.0)),  # kl^2 = 37.2, under 2.76 x 2 pi x 2.2 = 38.2
        ((2.0, 20.0), (1.0, 1.0)),  # kh cos(40) = 1.53, under 1.58
    ]
    scene = measured(scene_of(mesh_of(soil=ground(8.0)), [view(0.0, 40.0, name="v0")], shape=(10, 10)), tmp_path)
    for (kh, kl), expected in cases:
        numbers = {"rms_height_m": kh / WAVENUMBER, "correlation_length_m": kl / WAVENUMBER, "specular_fraction": 0.5}
        problem = FitProblem(with_material(scene, "soil", **numbers), devices.resolve_device("cpu"))
        found = outside_domains(problem, problem.x0)["soil"]
        assert (found["spm"], found["ka"]) == expected, (kh, kl)


@pytest.mark.full
def test_validity_as_a_soft_constraint(cube: Scene) -> None:
    """A cube far rougher than small perturbation allows: reported, and drawn back into the domain on request."""
    truth = {**TRUTH, "cube": {"eps_r": 10.0, "rms_height_m": 0.003, "correlation_length_m": 0.006}}
    folder = next(iter(cube.views[0].images.values())).parent
    scene = starting(
        measured(
            starting(replace(cube, views=[v.model_copy(update={"images": {}}) for v in cube.views]), truth), folder
        )
    )
    free = learn(scene, device="cpu", options=LearnOptions(starts=1))
    assert free.domains["cube"]["spm"] == pytest.approx(1.0)
    assert free.domains["ground"]["spm"] == pytest.approx(0.0)
    held = learn(scene, device="cpu", options=LearnOptions(starts=1, validity=1e7, iterations=200))
    k = held.problem.views[0].render.hits.geometry.wavenumber
    h, length = np.exp(held.x[4:6])
    assert k * h < 0.31
    assert np.sqrt(2) * h / length < 0.31
    assert held.train["deviance"] > free.train["deviance"]


# ---- fields ----


def field_scene(folder: Path, layout: str = "texture") -> Scene:
    """Tilted facets whose h is a field of two halves, 16 looks from four sides; the fit starts from one number."""
    mesh = bumpy(size=12.0, cells=6, depth=0.5)
    rough = np.where(np.linspace(0, 1, 7) < 0.5, 0.0006, 0.0012)
    mesh = replace(mesh, vertex_scalars={"h": np.repeat(rough, 7), "start": np.full(49, 0.0009)})
    views = views_at((0.0, 40.0), (90.0, 45.0), (180.0, 35.0), (270.0, 50.0))
    scene = scene_of(mesh, views, shape=(28, 28), polarizations=("HH", "VV"))
    material = dict(SOIL, correlation_length_m=0.008, layout=layout, learn=("rms_height_m",))
    maps = {"h": "h", "start": "start"}
    if layout == "texture":
        for name, values in (
            ("h", np.tile(np.repeat([0.0006, 0.0012], 3), (4, 1))),
            ("start", np.full((4, 6), 0.0009)),
        ):
            maps[name] = str(folder / f"{name}.exr")
            write_exr(maps[name], {name: values})
    truth = replace(scene, materials={"soil": Material(**{**material, "rms_height_m": maps["h"]})})
    seen = measured(truth, folder)
    return replace(seen, materials={"soil": Material(**{**material, "rms_height_m": maps["start"]})})


@pytest.mark.full
@pytest.mark.parametrize("layout", ["texture", "vertex"])
def test_a_field_is_learned_and_loads_again(layout: str, tmp_path: Path) -> None:
    """Both halves come back to 10 % in the median; the saved scene, loaded, simulates to the fit's own image."""
    scene = field_scene(tmp_path, layout)
    write_ply(tmp_path / "mesh.ply", scene.mesh.vertices, scene.mesh.faces, scene.mesh.vertex_scalars)
    if layout == "texture":
        from warpsar.scene.unwrap import write_obj

        write_obj(tmp_path / "mesh.obj", scene.mesh)
    else:
        material = {"default": scene.materials["soil"]}
        scene = replace(scene, mesh=replace(scene.mesh, materials=("default",)), materials=material)
    replace(scene, mesh_path=(tmp_path / f"mesh.{'obj' if layout == 'texture' else 'ply'}").resolve()).save(
        tmp_path / "scene.toml"
    )
    options = LearnOptions(iterations=150, total_variation={"rms_height_m": 1.0})
    content = learning.run(tmp_path / "scene.toml", tmp_path / "out", device="cpu", options=options)
    (field,) = content["fields"].values()
    assert field["seen"] > 0.9 * field["nodes"]
    learned = Scene.load(tmp_path / "out" / "scene.toml")
    name = learned.mesh.materials[0]
    values = learned.field(name, "rms_height_m")
    left, right = (values[:, :3], values[:, 3:]) if layout == "texture" else (values[:21], values[28:])
    assert np.median(left) == pytest.approx(0.0006, rel=0.1)
    assert np.median(right) == pytest.approx(0.0012, rel=0.1)
    # the same rays give the fit's image: EXR holds float32, PLY float64
    loaded = simulate(learned, device="cpu")
    problem = FitProblem(learned, devices.resolve_device("cpu"))
    for made, one in zip(loaded, problem.views, strict=True):
        for seen in one.observations:
            deviance = 2 * seen.looks * np.mean(
                seen.values / made.beta0[seen.polarization][seen.interior]
                - 1 - np.log(seen.values / made.beta0[seen.polarization][seen.interior])
            )  # fmt: skip
            assert deviance < 1.35  # 1.02 is the floor; the halves' edge is blurred by the interpolation
    assert content["train"]["deviance"] < 1.2


def test_the_same_rays_give_the_fits_image(tmp_path: Path) -> None:
    scene = field_scene(tmp_path)
    found = learn(scene, device="cpu", options=LearnOptions(iterations=20), folder=tmp_path)
    fitted = found.problem.modelled(found.x)
    images = {(one.name, p): image for one in simulate(found.scene, device="cpu") for p, image in one.beta0.items()}
    for seen, mu in zip(found.problem.observations, fitted, strict=True):
        np.testing.assert_allclose(images[seen.view.name, seen.polarization][seen.interior], mu, rtol=2e-6)


# ---- effects ----


@pytest.mark.full
def test_a_declared_effect_is_learned_with_the_surface(clean: Any, tmp_path: Path) -> None:
    truth, images = clean
    level = 0.02 * float(np.median(images[0]["HH"][images[0]["HH"] > 0]))
    lifted = [{p: image + level for p, image in one.items()} for one in images]
    scene = starting(measured(truth, tmp_path, images=lifted))
    scene = replace(scene, effects={"noise_floor": {"level": 5 * level}})
    found = learn(scene, device="cpu", options=LearnOptions(starts=1))
    assert found.scene.effects["noise_floor"]["level"] == pytest.approx(level, rel=0.05)
    assert found.test is not None
    assert found.test["deviance"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.full
def test_a_gain_per_view_is_learned_and_a_test_views_own_is_not(clean: Any, tmp_path: Path) -> None:
    """Only differences from the mean over the scene's views act, the test view's stated 0 dB among them."""
    truth, images = clean
    gains = {"v0": 1.5, "v1": -1.5, "test": 0.0}
    louder = [
        {p: image * 10 ** (gains[one.name] / 10) for p, image in clean_images.items()}
        for one, clean_images in zip(truth.views, images, strict=True)
    ]
    scene = measured(truth, tmp_path, images=louder)
    for name in ("ground", "cube"):
        scene = with_material(scene, name, learn=("correlation_length_m",))
    scene = replace(scene, effects={"view_gain": {"gain_db": dict.fromkeys(gains, 0.0)}})
    found = learn(scene, device="cpu", options=LearnOptions(starts=1))
    said = found.scene.effects["view_gain"]["gain_db"]
    assert said["test"] == 0.0
    mean = sum(said.values()) / 3
    # 900 pixels x 2 polarizations x 16 looks know a gain to 0.03 dB; four of those, and the shared mean
    assert said["v0"] - mean == pytest.approx(1.5, abs=0.15)
    assert said["v1"] - mean == pytest.approx(-1.5, abs=0.15)
    assert found.test is not None
    assert found.test["deviance"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("name", names())
def test_what_is_discrete_in_an_effect_cannot_be_learned(name: str) -> None:
    effect = get(name)
    for setting in effect.settings:
        with pytest.raises(InputError, match=f"{setting.name}: is discrete and cannot be learned"):
            effect.parameter(setting.name)
    assert not {s.name for s in effect.settings} & {p.name for p in effect.parameters}


def test_a_discrete_setting_is_no_coordinate_of_the_fit(cube: Scene) -> None:
    table = {"strength": 0.1, "max_bounces": 2}
    problem = FitProblem(replace(cube, effects={"multibounce": table}), devices.resolve_device("cpu"))
    assert [label for label in problem.labels if "multibounce" in label] == ["multibounce.strength"]


# ---- rays ----


@pytest.mark.full
def test_rays_are_chosen_by_the_looks(cube: Scene) -> None:
    """Without [sampling]: looks x relative variance of a lit pixel under 0.01, by two seeds of `simulate`."""
    found = learn(replace(cube, sampling=Sampling()), device="cpu", options=LearnOptions(starts=1, iterations=1))
    density = found.density
    assert density.chosen
    assert density.noise < 0.01
    chosen = replace(cube, sampling=Sampling(rays_per_m2=density.rays_per_m2, seed=5))
    for made in simulate(chosen, device="cpu", variance=True):
        for polarization, image in made.beta0.items():
            inner = minimum_filter(image > 0, 3)
            relative = made.sampling_variance[polarization][inner] / image[inner].astype(float) ** 2
            assert 16.0 * relative.mean() < 0.015  # another draw, and another view's share


# ---- files ----


@pytest.mark.full
def test_what_lies_in_the_folder(cube: Scene, tmp_path: Path) -> None:
    scene = save_scene(cube, tmp_path / "scene")
    out = tmp_path / "out"
    words = [sys.executable, "-m", "warpsar", "learn", scene, "-o", out, "--device", "cpu", "--starts", "2"]
    result = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True)
    lines = result.stdout.splitlines()
    assert lines[-1].startswith("train deviance ")  # below all messages: the last line of the console
    assert any("gradient check" in line for line in lines[:-1])
    assert {p.name for p in out.iterdir()} == {
        *("scene.toml", "history.csv", "learn.json", "convergence.png", "report.html")
    }
    residuals = 1 + sum(len(one.images) for one in cube.views)  # the first screen has one
    assert (out / "report.html").read_text().count('alt="residual after"') == residuals
    content = json.loads((out / "learn.json").read_text())
    learned = Scene.load(out / "scene.toml")
    rows = list(csv.DictReader((out / "history.csv").open()))
    assert [int(row["iteration"]) for row in rows] == list(range(1, len(rows) + 1))
    assert {row["start"] for row in rows} == {"0", "1"}
    assert min(float(row["loss"]) for row in rows) == pytest.approx(content["loss"])
    for name, keys in TRUTH.items():
        for key in keys:
            entry = content["materials"][name][key]
            assert getattr(learned.materials[name], key) == pytest.approx(entry["value"], rel=1e-12)
            low, high = entry["interval_95"]
            assert low < entry["value"] < high
            kind = next(k for k in KINDS if k.key == key)
            width = float(kind.to_coordinate(high) - kind.to_coordinate(low))
            # the valley is nearly straight here: an end of the profile is found within 5 % of the root
            assert width == pytest.approx(2 * 1.96 * entry["sd_log"], rel=0.15)
    assert content["identifiability"]["words"][0].startswith("ground: ")
    assert set(content["outside_domain"]) == {"ground", "cube"}
    assert content["pixels"]["v0 HH"]["used"] + content["pixels"]["v0 HH"]["left_out"] == 36 * 36
    simulated = CliRunner().invoke(main, ["simulate", str(out / "scene.toml"), "-o", str(tmp_path / "again")])
    assert simulated.exit_code == 0


# ---- one LM step at the edge ----


def test_lm_leaves_what_a_bound_holds(cube: Scene) -> None:
    """The best eps_r lies above its bound of 300 when the images are brightened: it ends there, the rest is fitted."""
    for one in cube.views:
        for polarization, path in one.images.items():
            write_tiff(path, 30.0 * read_channel(path, polarization))
    for name in ("ground", "cube"):
        values = TRUTH[name]
        cube = with_material(cube, name, **{**values, "eps_r": 50.0}, learn=("eps_r", "correlation_length_m"))
    problem = FitProblem(cube, devices.resolve_device("cpu"))
    state = begin(problem, 0, 0)
    while not state.arrived and state.iteration < 60:
        state = levenberg_marquardt(problem, state)
    low, high = problem.bounds
    assert state.iteration < 60
    assert (state.x >= low).all()
    assert (state.x <= high).all()
    assert (state.x[[0, 2]] == high[[0, 2]]).any()
    _, gradient = problem.gradient(state.x)
    held = (state.x >= high) & (gradient < 0) | (state.x <= low) & (gradient > 0)
    loss = problem.value(problem.modelled(state.x))
    for element in np.flatnonzero(~held):  # what is free is at its minimum: the loss rises on either side
        for step in (-1e-2, -1e-3, 1e-3, 1e-2):
            beside = state.x.copy()
            beside[element] += step
            # 0.05 of 1e5: what float32 images leave of such a loss
            assert problem.value(problem.modelled(beside)) > loss - 0.05


def test_metrics_from_sums_are_those_of_the_pixels(tmp_path: Path) -> None:
    """The kernel that makes the sums, and what is made of them, against NumPy on the pixels: both in float64."""
    from warpsar.kernels.metrics import PARTIALS, SUMS

    problem = FitProblem(field_scene(tmp_path), devices.resolve_device("cpu"))
    for x in (problem.x0, problem.x0 + 0.3):
        modelled = problem.modelled(x)
        sums: Any = wp.zeros((len(modelled), int(PARTIALS), int(SUMS)), dtype=wp.float64, device="cpu")
        for number, one in enumerate(problem.views):
            one.add_moments([sums[2 * number], sums[2 * number + 1]])
        for seen, mu, moments in zip(problem.observations, modelled, sums.numpy().sum(axis=1), strict=True):
            assert seen.count == seen.values.size
            found = metrics_of(moments, seen.count, seen.law)
            for key, value in metrics(seen.values, mu, seen.law).items():
                assert found[key] == pytest.approx(value, rel=1e-12), key


# ---- CUDA ----


@pytest.mark.cuda
def test_the_captured_graph_is_adam(tmp_path: Path) -> None:
    """Adam on the CPU and the captured graph on CUDA: the same path, to float32 sums in another order. Adam divides by
    the gradient's own size, so nodes whose gradient is next to nothing go their own ways, a step of 0.05 at a time;
    most have gone the same way to a fifth of a step."""
    scene = field_scene(tmp_path)
    ends, losses = [], []
    for alias, way, steps in (("cpu", Adam, 40), ("cuda", GraphAdam, 40 // GraphAdam.STRIDE)):
        problem = FitProblem(scene, devices.resolve_device(alias), total_variation={"rms_height_m": 1.0})
        state = begin(problem, 0, 0)
        descent = way(problem, state, 0.05)
        for _ in range(steps):
            state = descent.step(state)
        ends.append(np.asarray(state.x))
        losses.append(state.loss)
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert np.median(np.abs(ends[1] - ends[0])) < 1e-2
    assert np.median(np.abs(ends[0] - problem.x0)) > 0.1  # it went somewhere


@pytest.mark.cuda
def test_what_the_device_keeps_is_the_best_of_its_looks(tmp_path: Path) -> None:
    """Beside what the host would keep. The nodes are set beside the minimum now and then, so that the best is not the
    last; the loss of what is kept is made on the host."""
    problem = FitProblem(field_scene(tmp_path), devices.resolve_device("cuda"))
    state = begin(problem, 0, 0)
    descent = GraphAdam(problem, state, 0.05)
    losses, kept = [], []
    for number in range(7):
        if number in (3, 5):
            problem.shared_nodes.assign(problem.nodes(problem.x0 + 1.0).astype(np.float32))
        state = descent.step(state)
        losses.append(state.loss)
        kept.append(np.asarray(state.best_x))
        assert state.best_loss == min(losses)
    best = int(np.argmin(losses))
    assert best == 2
    for later in kept[best:]:  # nothing that came after has changed it
        np.testing.assert_array_equal(later, kept[best])
    assert np.abs(kept[1] - kept[2]).max() > 1e-3
    # float32 images in float64 sums, of 5,600 pixels: of another order on the host
    assert problem.value(problem.modelled(kept[best])) == pytest.approx(losses[best], rel=1e-6)
    found, expected = (pooled_metrics(problem, x) for x in (state.best_x, kept[best]))
    for key, value in expected.items():
        assert found[key] == pytest.approx(value, rel=1e-9), key


@pytest.mark.cuda
def test_a_checkpoint_of_the_device_goes_on_from_there(tmp_path: Path) -> None:
    """Arrays as a checkpoint holds them, into another problem: to the bit what they were, and where they lead the same
    but for the order of atomic sums."""
    scene, where = field_scene(tmp_path), devices.resolve_device("cuda")
    problem = FitProblem(scene, where)
    state = begin(problem, 0, 0)
    descent = GraphAdam(problem, state, 0.02)
    for _ in range(3):
        state = descent.step(state)
    stored = {name: array.copy() for name, array in state.arrays().items()}
    whole = descent.step(descent.step(state))
    other = FitProblem(scene, where)
    resumed = FitState.from_arrays(stored)
    second = GraphAdam(other, resumed, 0.02)
    np.testing.assert_array_equal(second.nodes.numpy()[other.learned], stored["x"])
    for key, array in (("first_moment", second.first), ("second_moment", second.second)):
        np.testing.assert_array_equal(array.numpy(), stored[key])
        assert np.count_nonzero(stored[key])
    resumed = second.step(second.step(resumed))
    assert resumed.iteration == whole.iteration == 50
    assert resumed.loss == pytest.approx(whole.loss, rel=1e-6)
    np.testing.assert_allclose(np.asarray(resumed.x), np.asarray(whole.x), atol=1e-3)  # of 20 steps of 0.01


@pytest.mark.cuda
def test_lm_on_cuda(cube: Scene) -> None:
    cpu = learn(cube, device="cpu", options=LearnOptions(starts=1))
    cuda = learn(cube, device="cuda", options=LearnOptions(starts=1))
    assert cpu.identified is not None
    assert (np.abs(cuda.x - cpu.x) < 0.05 * cpu.identified.sd).all()


@pytest.mark.slow
def test_surfaces_of_another_renderers_images_lie_in_their_intervals(independent_cases: Path, tmp_path: Path) -> None:
    content = learning.run(independent_cases / "none" / "scene.toml", tmp_path, device="cpu")
    assert 0.97 < content["train"]["deviance"] < 1.03
    assert 0.97 < content["test"]["deviance"] < 1.03
    outside = 0
    for name, values in json.loads((independent_cases / "none" / "truth.json").read_text())["materials"].items():
        for key, true in zip(KEYS[:3], values[:3], strict=True):
            told = content["materials"][name][key]
            low, high = told["interval_95"]
            outside += told["sd_log"] < 0.5 and not low <= true <= high
    # 95 % each: of the 11 that are identifiable, three or more outside in one case of 60
    assert outside <= 2
