"""Diagnosis beside learned fields: its prior, steps and projection against dense linear algebra and differences, and
small scenes from end to end."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import benchmark
from learning_scenes import bumpy, measured
from test_fields import scene_with_fields
from worlds import mesh_of, plate, scene_of, view

import warpsar
from warpsar.cli.main import main
from warpsar.diagnosis.field_content import identify_beside
from warpsar.diagnosis.found import Candidate, DiagnoseOptions
from warpsar.diagnosis.geometry.registry import names as geometry_names
from warpsar.diagnosis.models import movable
from warpsar.diagnosis.models.field_prior import has_fields, with_roughness
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.refit import Fitted, fit_model
from warpsar.diagnosis.result import diagnose
from warpsar.diagnosis.scores.partly_known import PartlyKnown
from warpsar.diagnosis.scores.score import REACH
from warpsar.diagnosis.turn.field_projection import FREED, FieldProjection, bar_those_alone, known_of, sparse_tangent
from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.learning import pose
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import FieldPrior, Roughness
from warpsar.learning.sparse_quadratic import SOLVED, SparseQuadratic, solved, whole_jacobian
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.pixels import Pixels
from warpsar.world.tables import Grid, Material, Sampling

CPU = devices.resolve_device("cpu")
QUICK = DiagnoseOptions(draws=400, starts=0, most_effects=2)
VIEWS = ((10, 38, "train"), (100, 46, "train"), (195, 52, "train"), (280, 42, "train"), (55, 48, "test"))
SOIL = {"eps_r": 6.0, "rms_height_m": 0.0012, "correlation_length_m": 0.010}
BLUR = {"point_spread": {"range_fwhm_m": 0.9, "azimuth_fwhm_m": 0.7}}


def rough_problem(scene: Scene, **more: Any) -> FitProblem:
    """A fit with a prior whose precisions differ from pair to pair."""
    rough = Roughness.of(FitProblem(scene, CPU), 1.0)
    precision = np.random.default_rng(2).uniform(2.0, 20.0, rough.precision.size)
    return FitProblem(scene, CPU, roughness=replace(rough, precision=precision), **more)


def away(problem: FitProblem) -> np.ndarray:
    """An x beside the start, inside the bounds."""
    return np.asarray(problem.x0 + np.random.default_rng(3).normal(0.0, 0.1, problem.x0.size))


@pytest.fixture(params=["texture", "vertex"])
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Scene:
    return scene_with_fields(request.param, tmp_path)


# The prior, the steps and the projection


def test_prior_of_a_field_against_differences(scene: Scene) -> None:
    """Quadratic: central differences are exact but for rounding, 1e-16 / 1e-4 of the value."""
    problem = rough_problem(scene)
    prior, x = problem.prior, away(problem)
    assert isinstance(prior, FieldPrior)
    way = np.random.default_rng(4).normal(size=x.size)
    ends = [x + share * 1e-4 * way for share in (1.0, -1.0)]
    slope = (prior.value(ends[0]) - prior.value(ends[1])) / 2e-4
    assert prior.gradient(x) @ way == pytest.approx(slope, rel=1e-6)
    bend = (prior.gradient(ends[0]) - prior.gradient(ends[1])) / 2e-4
    np.testing.assert_allclose(prior.sparse_information(x) @ way, bend, rtol=1e-6, atol=1e-6)
    together = np.repeat([0.3, -0.2], x.size // 2)  # each field as a whole: nothing is expected of its level
    assert prior.value(x + together) == pytest.approx(prior.value(x))


def test_expected_roughness_is_that_of_the_field() -> None:
    """Of a known field of normal differences, the mean inverse variance is theirs to a factor: the median of a squared
    normal number is 0.455, so 1 / (0.455 + d^2) has the mean 1.0 to 1.4 of 1 / variance."""
    pairs = np.column_stack([np.arange(0, 4000, 2), np.arange(1, 4000, 2)])
    rough = Roughness(pairs, np.ones(2000), np.zeros(2000, int), (4000,))
    x = np.zeros(4000)
    x[::2] = np.random.default_rng(5).normal(0.0, 0.2, 2000)
    found = rough.expected(x, np.zeros((4000, 1)), np.ones(4000, bool))
    assert 0.9 < found.precision.mean() * 0.2**2 < 1.6
    edge = x.copy()
    edge[0] = 3.0
    held = rough.expected(edge, np.zeros((4000, 1)), np.ones(4000, bool)).precision[0]
    assert held < 0.15  # 1 / 3^2: an edge is hardly held
    unseen = rough.expected(x, np.zeros((4000, 1)), np.zeros(4000, bool))
    np.testing.assert_array_equal(unseen.precision, rough.precision)


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("effects", [{}, {"antenna_pattern": {"beamwidth_m": 6.0}}, {"noise_floor": {"level": 0.002}}])
def test_curvature_and_gradient_of_a_field(scene: Scene, effects: dict[str, Any], calibrated: bool) -> None:
    """The curvature is that of the dense Jacobian, whose columns of nodes have tests of their own; the gradient is that
    of the loss by differences, float32 images allowing 2 %."""
    scene = replace(scene, effects=effects, grid=replace_grid(scene.grid, calibrated))
    problem = rough_problem(scene)
    x = away(problem)
    quadratic = SparseQuadratic.about(problem, x)
    modelled = problem.modelled(x)
    expected = problem.prior.sparse_information(x).toarray()  # type: ignore[attr-defined]
    for j, c in zip(problem.jacobian(x), problem.curvatures(modelled), strict=True):
        expected += j.T @ (c.weight[:, None] * j)
    found = quadratic.hessian.toarray()
    assert np.abs(found - expected).max() < 2e-3 * np.abs(expected).max()
    way = np.random.default_rng(6).normal(size=x.size)
    loss = [problem.loss_at(x + share * 1e-3 * way) for share in (1.0, -1.0)]
    assert quadratic.gradient @ way == pytest.approx((loss[0] - loss[1]) / 2e-3, rel=2e-2)
    assert quadratic.loss == pytest.approx(problem.loss_at(x), rel=1e-5)


def replace_grid(grid: Grid, calibrated: bool) -> Grid:
    return grid.model_copy(update={"calibrated": calibrated})


def test_steps_are_those_of_a_dense_solution(scene: Scene) -> None:
    problem = rough_problem(scene)
    quadratic = SparseQuadratic.about(problem, away(problem))
    damping = 0.01
    step = quadratic.step(damping)
    dense = quadratic.hessian.toarray()
    exact = -np.linalg.solve(dense + damping * np.diag(np.diag(dense)), quadratic.gradient)
    promised = -(quadratic.gradient @ exact + 0.5 * exact @ dense @ exact)
    assert step.promised == pytest.approx(promised, rel=1e-2)
    right = np.random.default_rng(7).normal(size=exact.size)
    left = quadratic.hessian @ solved(quadratic.hessian, right, quadratic.nodes) - right
    assert np.linalg.norm(left) <= 1.01 * SOLVED * np.linalg.norm(right)
    own = np.zeros(exact.size, bool)
    own[:3] = True  # the rest stays
    held = SparseQuadratic.about(problem, away(problem), own).step(damping)
    assert not held.step[3:].any()
    assert held.step[:3].any()


def test_jacobian_that_is_near_behind_a_blur(tmp_path: Path) -> None:
    """Without an effect of the image it is the exact one. Behind a blur it is exact for a change that makes the whole
    image grow: h, with whose square beta0 goes. Pixels at the darkest that is compared do not change."""
    bare = scene_with_fields("texture", tmp_path)
    problem = FitProblem(bare, CPU)
    for near, exact in zip(
        problem.sparse_jacobian(problem.x0, near=True), problem.sparse_jacobian(problem.x0), strict=True
    ):
        assert np.abs((near - exact).toarray()).max() < 1e-6
    blurred = FitProblem(replace(bare, effects=BLUR), CPU)
    near, exact = (
        np.concatenate([j.toarray() for j in js])
        for js in (blurred.sparse_jacobian(blurred.x0, near=True), blurred.sparse_jacobian(blurred.x0))
    )
    assert np.abs(near - exact).max() > 0.1 * np.abs(exact).max()  # not the same
    together = np.repeat([0.0, 1.0], blurred.x0.size // 2)  # beta0 goes with h^2 in small perturbation
    assert np.quantile(np.abs(near @ together - 2.0), 0.9) < 1e-3
    assert np.quantile(np.abs(exact @ together - 2.0), 0.5) < 1e-3  # where no faint tail of a column was left out


def test_projection_beside_a_field_is_that_of_dense_algebra() -> None:
    """A (A'A + D'D + 1 / REACH^2)^-1 A', and the covariance of scores against 4000 draws: 5 standard errors."""
    random = np.random.default_rng(8)
    tangent, looks = random.normal(size=(150, 20)), np.full(150, 2.0)
    rows = random.normal(size=(19, 20))
    known = PartlyKnown(rows, random.normal(size=19))
    projection = FieldProjection(np_sparse(tangent), looks, PartlyKnown(np_sparse(rows), known.residual))  # type: ignore[arg-type]
    scaled = 2.0 * tangent
    inverse = np.linalg.inv(scaled.T @ scaled + rows.T @ rows + np.eye(20) / REACH**2)
    columns, below = random.normal(size=(150, 3)), random.normal(size=(19, 3))
    expected = columns - scaled @ inverse @ (scaled.T @ columns + rows.T @ below)
    np.testing.assert_allclose(projection(columns, below), expected, rtol=1e-9, atol=1e-9)
    unit = columns / np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(scaled)[0]
    np.testing.assert_allclose(projection.left(unit), 1.0 - ((basis.T @ unit) ** 2).sum(axis=0), atol=1e-5)
    inside = scaled @ random.normal(size=(20, 1))  # what any field imitates
    assert projection.left(inside / np.linalg.norm(inside))[0] < 1e-6
    draws = projection(random.normal(size=(150, 4000)), random.normal(size=(19, 4000)))
    scores = unit.T @ draws
    moves = inverse @ scaled.T @ unit
    exact = (unit - scaled @ moves).T @ (unit - scaled @ moves) + (rows @ moves).T @ (rows @ moves)
    assert np.abs(np.cov(scores) - exact).max() < 5.0 * np.sqrt(2.0 / 4000) * np.diag(exact).max()


def test_what_fields_mostly_imitate_is_tried_only_beside_one_that_resembles_it() -> None:
    """Of three effects with too little left beside the fields, the one that resembles a sure find stays a candidate."""
    sure = Candidate("vegetation", "testable", eta=0.02, least=0.01, minus_log_p=50.0, resembles=["noise_floor"])
    alike = Candidate("noise_floor", "testable", eta=0.009, least=0.01, minus_log_p=45.0)
    alone = Candidate("range_loss", "testable", eta=0.009, least=0.01, minus_log_p=60.0, resembles=["antenna_pattern"])
    chance = Candidate("antenna_pattern", "testable", eta=0.005, least=0.01, minus_log_p=9.0)
    bar_those_alone([sure, alike, alone, chance], 7.0)
    assert [c.testability for c in (sure, alike, alone, chance)] == ["testable"] * 2 + ["not_testable"] * 2
    assert (alone.minus_log_p, alone.p_value) == (0.0, 1.0)
    uniform = Candidate("range_loss", "testable", eta=0.002, minus_log_p=60.0)
    bar_those_alone([uniform], 7.0)
    assert uniform.testability == "testable"  # the limit is that of uniform materials


def np_sparse(matrix: np.ndarray) -> Any:
    from scipy.sparse import csr_array

    return csr_array(matrix)


def test_what_is_known_beside_a_field(tmp_path: Path) -> None:
    """Information of a uniform parameter with the field projected out: the inverse of its part of the whole inverse."""
    scene = scene_with_fields("texture", tmp_path)
    soil = scene.materials["soil"]
    scene = replace(scene, materials={"soil": soil.model_copy(update={"learn": (*soil.learn, "correlation_length_m")})})
    problem = rough_problem(scene)
    x = problem.x0
    weights = np.concatenate([c.weight for c in problem.curvatures(problem.modelled(x))])
    tangent = np.sqrt(weights)[:, None] * sparse_tangent(problem, x).toarray()
    whole = tangent.T @ tangent + problem.prior.sparse_information(x).toarray()  # type: ignore[attr-defined]
    found = identify_beside(problem, x)
    assert found.labels == ["soil.correlation_length_m"]
    assert found.information[0, 0] == pytest.approx(1.0 / np.linalg.inv(whole)[-1, -1], rel=1e-4)


# Small scenes from end to end


def bumps(folder: Path, effects: dict[str, Any], *, seed: int = 1, texels: int = 10, layout: str = "texture") -> Scene:
    """Tilted facets whose eps_r and h change over the ground, with an edge; the maps that are learned begin uniform."""
    random = np.random.default_rng(7)
    mesh = bumpy(size=12.0, cells=5, depth=0.6)
    places = np.linspace(0.0, 1.0, texels)
    x, y = np.meshgrid(places, places)
    if layout == "vertex":
        x, y = (mesh.vertices[:, :2] / 12.0 + 0.5).T
    waves = [0.3 * np.sin(6.0 * x + random.uniform(0, 6)) * np.cos(5.0 * y) + 0.5 * (x > 0.5) for _ in range(2)]
    true = {"eps_r": 1.0 + 5.0 * np.exp(waves[0]), "rms_height_m": 0.0012 * np.exp(0.5 * waves[1])}
    start = {"eps_r": np.full(x.shape, 6.5), "rms_height_m": np.full(x.shape, 0.0013)}
    views = [view(a, i, name=f"v{k}", role=role) for k, (a, i, role) in enumerate(VIEWS)]

    def scene(values: dict[str, np.ndarray], learn: tuple[str, ...]) -> Scene:
        material: dict[str, Any] = {**SOIL, "layout": layout, "learn": learn}
        if layout == "texture":
            surface = replace(mesh, vertex_scalars={}, materials=("default",))
            material |= {key: Pixels(value) for key, value in values.items()}
        else:
            surface = replace(mesh, vertex_scalars=values, materials=("default",), uv=None)
            material |= {key: key for key in values}
        return scene_of(
            surface,
            views,
            shape=(32, 32),
            spacing_m=(0.4, 0.4),
            polarizations=("HH",),
            rays_per_pixel=256.0,
            materials={"default": material},
        )

    truth = replace(scene(true, ()), effects=effects)
    given = measured(truth, folder, seed=seed)
    start_scene = scene(start, ("eps_r", "rms_height_m"))
    return replace(
        given,
        mesh=start_scene.mesh,
        materials=start_scene.materials,
        effects={},
        sampling=Sampling(rays_per_pixel=64.0),
    )


@pytest.mark.full
@pytest.mark.parametrize("layout", ["texture", "vertex"])
def test_nothing_is_named_where_a_field_explains_all(layout: str, tmp_path: Path) -> None:
    done = diagnose(bumps(tmp_path, {}, layout=layout), device="cpu", options=QUICK)
    assert done.diagnosis.verdict == []
    assert not done.diagnosis.unexplained
    first = {c.effect: c for c in done.diagnosis.turns[0].candidates}
    assert first["eps_gradient"].testability == "not_testable"  # a field of eps_r is such a gradient
    assert first["point_spread"].testability == "testable"
    before = done.before["test"]
    assert before is not None
    assert before["deviance"] < 1.2  # the field holds on a view that it has not seen
    final = done.diagnosis.final.scene
    final.save(tmp_path / "after.toml")
    saved = Scene.load(tmp_path / "after.toml")
    for key in ("eps_r", "rms_height_m"):
        np.testing.assert_allclose(saved.field("default", key), final.field("default", key), rtol=1e-6)  # float32
        assert np.ptp(np.log(saved.field("default", key))) > 0.2  # no longer the uniform start


@pytest.mark.full
def test_a_blur_is_found_beside_a_field_and_everything_is_saved(tmp_path: Path) -> None:
    """The command, on a scene file with its maps, and its results read back from files alone."""
    scene = bumps(tmp_path, BLUR)
    scene.save(tmp_path / "scene.toml")
    out = tmp_path / "out"
    words = ["diagnose", str(tmp_path / "scene.toml"), "-o", str(out), "--device", "cpu", "--draws", "400"]
    run = CliRunner().invoke(main, [*words, "--starts", "0", "--most-effects", "2"])
    assert run.exit_code == 0, run.output
    content = json.loads((out / "diagnosis.json").read_text())
    assert content["verdict"] == ["point_spread"]
    assert content["unexplained"] is False
    for key, width in BLUR["point_spread"].items():
        assert content["effects"]["point_spread"][key] == pytest.approx(width, rel=0.15)
    assert "eps_gradient" in content["not_testable"]
    assert set(content["fields"]) == {"default.eps_r", "default.rms_height_m"}
    assert content["fields"]["default.eps_r"]["nodes"] == 100
    assert content["fields"]["default.eps_r"]["rms_move_log"] > 0
    assert set(content["identifiability"]["parameters"]) == {
        "point_spread.range_fwhm_m",
        "point_spread.azimuth_fwhm_m",
    }
    assert content["after"]["test"]["deviance"] < content["before"]["test"]["deviance"] - 0.5
    saved = Scene.load(out / "scene.toml")
    assert saved.field("default", "eps_r").shape == (10, 10)
    assert np.ptp(saved.field("default", "eps_r")) > 1.0
    evaluated = warpsar.evaluate(saved, device="cpu")
    assert evaluated.test is not None
    # on its own pixels and rays: within what those leave, as for uniform scenes (test_diagnose.py)
    assert evaluated.test["deviance"] == pytest.approx(content["after"]["test"]["deviance"], abs=0.1)
    assert "learned field" in (out / "report.html").read_text()


@pytest.mark.full
def test_beside_many_numbers_geometry_is_not_asked_and_that_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor is the last fit of a blur dense then."""
    monkeypatch.setattr(movable, "MOST_NUMBERS", 20)

    def dense(*_: Any, **__: Any) -> None:
        raise AssertionError("a dense curvature")

    monkeypatch.setattr(pose, "_quadratic", dense)
    scene = bumps(tmp_path, BLUR, texels=5)
    scene.save(tmp_path / "scene.toml")
    words = ["diagnose", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "out"), "--device", "cpu", "--draws", "400"]
    run = CliRunner().invoke(main, [*words, "--starts", "0", "--most-effects", "1"], catch_exceptions=False)
    assert run.exit_code == 0, run.output
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert "point_spread" in [*content["verdict"], *content["not_established"]]
    assert set(geometry_names()) <= set(content["not_testable"])


def test_a_checkpoint_keeps_a_model_with_fields(tmp_path: Path) -> None:
    """What another rank or a resumed run hears is the same model, to the bit."""
    scene = bumps(tmp_path, {}, texels=4)
    setup = bench_of(scene)
    fitted = fit_model(setup, scene, 0, 0)
    heard = Fitted.of(setup, scene, json.loads(json.dumps(fitted.content())))
    np.testing.assert_array_equal(heard.x, fitted.x)
    assert heard.scene.materials == fitted.scene.materials
    one, other = (each.problem.modelled(each.x) for each in (fitted, heard))
    np.testing.assert_array_equal(np.concatenate(one), np.concatenate(other))


def bench_of(scene: Scene) -> FitSetup:
    stage = Stage.of(scene, CPU)
    one, two = (FitSetup(CPU, Rays(stage, 400.0, seed), {}) for seed in (0, 1))
    return with_roughness(replace(one, observations=frozen(one, two, scene)), scene, 0)[0]


@pytest.mark.slow
def test_a_field_that_is_not_learned_changes_nothing(tmp_path: Path) -> None:
    """Fixed maps beside a learned uniform parameter: no prior of fields, and the dense steps as before."""
    scene = bumps(tmp_path, {}, texels=4)
    material = scene.materials["default"].model_copy(update={"learn": ("correlation_length_m",)})
    scene = replace(scene, materials={"default": material})
    assert not has_fields(scene)
    done = diagnose(scene, device="cpu", options=QUICK)
    assert done.diagnosis.setup.roughness is None
    assert done.diagnosis.final.problem.uniform


def test_vertices_that_no_file_holds_are_refused_at_once(tmp_path: Path) -> None:
    scene = bumps(tmp_path, {}, layout="vertex")
    vertices, faces = plate((-1, -1, 0), (2, 0, 0), (0, 2, 0), 2)
    mesh = mesh_of(default=(vertices, faces), other=(vertices + np.array([0, 0, 1.0]), faces))
    scalars = {name: np.full(len(mesh.vertices), float(np.median(v))) for name, v in scene.mesh.vertex_scalars.items()}
    materials = {"default": scene.materials["default"], "other": Material(**SOIL)}
    several = replace(scene, mesh=replace(mesh, vertex_scalars=scalars), materials=materials)
    with pytest.raises(InputError, match="of layout vertex, in a mesh with several") as refused:
        diagnose(several, device="cpu", options=QUICK)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
@pytest.mark.parametrize("named", [[], ["point_spread"]])
def test_maps_of_the_experiments(named: list[str], tmp_path: Path) -> None:
    """64 x 64 texels of three parameters, 12288 unknowns, at 16 looks."""
    references = benchmark("references")
    train, test = ("az000", "az120", "az180", "az300"), ("az060",)
    scene = Scene.load(references.DATA / "fields" / "scene.toml")
    scene = replace(scene, views=[one for one in scene.views if one.name in (*train, *test)])
    images = references.clean_images(replace(scene, effects={name: get(name).rate_case for name in named}))
    given = references.trained_on(references.measured(scene, images, tmp_path, 16.0, 0), train, test)
    shape = scene.field("site", "eps_r").shape
    start = zip(references.KEYS, (4.0, 0.0006, 0.0035), strict=True)
    maps = {key: Pixels(np.full(shape, value)) for key, value in start}
    done = diagnose(
        references.changed(given, "site", learn=references.KEYS, **maps), device="cpu", options=DiagnoseOptions()
    )
    assert done.diagnosis.verdict == named


def test_freed_prior_is_a_share_of_the_fields_own(tmp_path: Path) -> None:
    problem = rough_problem(scene_with_fields("texture", tmp_path))
    prior = problem.prior
    assert isinstance(prior, FieldPrior)
    known = known_of(problem, prior.roughness)
    assert known.residual @ known.residual == pytest.approx(2.0 * FREED * prior.value(problem.x0))
    assert whole_jacobian(problem, problem.x0).shape[1] == problem.x0.size
