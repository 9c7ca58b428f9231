"""`warpsar diagnose --folds`: what stays is what views say that were left out."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from warpsar import Scene, simulate
from warpsar.cli.main import main
from warpsar.compare.prediction import Agreement, PredictedImage, advantage, predictions, summaries
from warpsar.diagnosis.held_out.arcs import folds, mean_and_error, over_draws
from warpsar.diagnosis.held_out.azimuths import counted
from warpsar.diagnosis.held_out.box import as_box
from warpsar.diagnosis.held_out.geometry import TURNED, WIDE, beyond_mesh, likeliest, minimum, numbers, profiled
from warpsar.diagnosis.held_out.glints import found_by_parts, found_in_all, merged, on_bodies, with_glints
from warpsar.diagnosis.held_out.hypotheses import EffectHypothesis
from warpsar.diagnosis.held_out.model import TrainViews, scene_content, scene_of
from warpsar.diagnosis.held_out.report import judgement, sentence
from warpsar.diagnosis.held_out.search import (
    BEATEN,
    DRAWS,
    GEOMETRY,
    RIVALS,
    SEARCHED,
    Added,
    FoldSearch,
    HeldOut,
    Model,
    TrialStep,
    held_out,
)
from warpsar.diagnosis.run_log import RunLog, open_run_log
from warpsar.effects.glints import Glint
from warpsar.errors import InputError
from warpsar.learning.pull import leaving
from warpsar.measured.chips import import_chips
from warpsar.runtime import devices
from warpsar.runtime.deadline import TimeUp
from warpsar.scene.placing import with_objects
from warpsar.world.mesh import Mesh
from warpsar.world.obj import write_obj
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.pixels import Pixels
from warpsar.world.tables import View

SCENE = """
[scene]
reference_point_m = [0.0, 0.0, 0.0]
[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]
[image]
shape = [52, 52]
spacing_m = [0.3, 0.3]
calibrated = false
[sampling]
rays_per_pixel = 16.0
[materials.ground]
eps_r = 6.0
rms_height_m = 0.004
correlation_length_m = 0.004
learn = []
[materials.metal]
eps_r = 40.0
rms_height_m = 0.003
correlation_length_m = 0.006
learn = ["rms_height_m"]
[effects.aim_point]
reach_m = 1.2
[[objects]]
name = "ground"
primitive = "plate"
size_m = [40.0, 40.0, 0.0]
material = "ground"
[[objects]]
name = "body"
primitive = "box"
size_m = [5.0, 2.5, 2.0]
material = "metal"
learn = ["size"]
tolerance = { size_m = "10 %" }
"""


def views(count: int, role: str = "train", first_deg: float = 0.0) -> str:
    angles = first_deg + np.arange(count) * 360.0 / count
    return "".join(
        f'[[views]]\nname = "{role}{k}"\nazimuth_deg = {a}\nincidence_deg = 60.0\nrole = "{role}"\n'
        for k, a in enumerate(angles)
    )


def measured(folder: Path, *, height_m: float = 2.0, floor: float = 0.004, count: int = 12, more: str = "") -> Scene:
    """`count` train views and six test views of a box with a noise floor, each shifted by up to three pixels, of one
    look."""
    path = folder / "scene.toml"
    path.write_text(SCENE + views(count) + views(6, "test", 7.0))
    declared = Scene.load(path)
    (folder / "true.toml").write_text(
        path.read_text().replace("2.5, 2.0]", f"2.5, {height_m}]") + f"[effects.noise_floor]\nlevel = {floor}\n" + more
    )
    random = np.random.default_rng(1)
    images = simulate(Scene.load(folder / "true.toml"), device="cpu", seed=5)
    seen = []
    for view, image in zip(declared.views, images, strict=True):
        power = image.beta0["HH"] * random.gamma(1.0, 1.0, image.beta0["HH"].shape) * random.uniform(1e3, 3e3)
        moved = np.roll(power, random.integers(-3, 4, 2), (0, 1)).astype(np.float32)
        stated = view.model_dump(by_alias=True, exclude_unset=True)
        seen.append(View.model_validate({**stated, "images": {"HH": moved}, "looks": 1.0}))
    return Scene(**{**_fields(declared), "views": seen})


def _fields(scene: Scene) -> dict[str, object]:
    return {name: getattr(scene, name) for name in scene.__dataclass_fields__ if scene.__dataclass_fields__[name].init}


@pytest.mark.unit
def test_views_are_left_out_in_arcs() -> None:
    some = [View(name=f"v{k}", azimuth_deg=10.0 * k, incidence_deg=60.0) for k in range(36)]
    parts = folds(some, 3)
    assert sorted(name for part in parts for name in part) == sorted(view.name for view in some)
    assert parts[0][:4] == ["v0", "v1", "v2", "v3"]
    assert [len(part) for part in parts] == [12, 12, 12]
    with pytest.raises(InputError, match="--folds 20: found 36 train views; must be 40 or more"):
        folds(some, 20)


@pytest.mark.unit
def test_views_of_an_arc_are_wrong_together() -> None:
    """Nine arcs of four views with one gain for each arc: their mean is known as well as nine numbers tell it, not 36.
    Where each view has its own, arcs say no more than views do."""
    random = np.random.default_rng(0)
    by_arc = random.normal(size=9)
    mean, error = mean_and_error(np.repeat(by_arc, 4), 9)
    assert mean == pytest.approx(by_arc.mean())
    assert error == pytest.approx(by_arc.std(ddof=1) / 3.0)
    own = random.normal(size=36)
    assert mean_and_error(own)[1] == pytest.approx(own.std(ddof=1) / 6.0)
    assert mean_and_error(own, 9)[1] >= mean_and_error(own)[1]


@pytest.mark.unit
def test_draws_of_rays_that_disagree_widen_the_error() -> None:
    """A gain of 1 on one draw and of 3 on another, alike in all views: 2, to half of their difference."""
    assert over_draws([np.full(12, 1.0), np.full(12, 3.0)], 6) == pytest.approx((2.0, 1.0))
    gain = np.random.default_rng(0).normal(size=12)
    assert over_draws([gain], 6) == mean_and_error(gain, 6)
    assert over_draws([gain, gain], 6) == pytest.approx(mean_and_error(gain, 6))


@pytest.mark.unit
@pytest.mark.parametrize(
    ("worth", "draws", "said"),
    [
        ((0.5, 0.5), 1, "stays"),
        ((0.03, 0.03), 2, "stays"),
        ((0.03, 0.0), 2, "cannot be told here"),
        ((-0.005, 0.01), 2, "cannot be told here"),
        ((-0.03, -0.03), 2, "goes"),
    ],
)
def test_an_effect_is_named_where_it_is_worth_more_than_its_uncertainty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, worth: tuple[float, ...], draws: int, said: str
) -> None:
    """What leaving it out costs by draws of rays, in views that scatter by 0.03: 0.5 is certain on one draw, 0.03 on
    two is three standard errors. The same on one draw alone is not told: the other one lets it go."""
    (tmp_path / "scene.toml").write_text(SCENE + views(12) + "[effects.noise_floor]\nlevel = 0.004\n")
    scene = Scene.load(tmp_path / "scene.toml")
    search = FoldSearch.__new__(FoldSearch)
    search.folds, search.order = folds(scene.views, 2), [view.name for view in scene.views]
    search._arcs, search._whose = 6, ""
    scatter = 0.03 * np.tile([1.0, -1.0], 6)
    asked: list[float] = []

    def fitted(
        starts: list[Scene], enough: Callable[[np.ndarray], bool] = lambda scores: False, **_: object
    ) -> Model | None:
        if "noise_floor" in starts[0].effects:
            return Model(starts, np.full(12, 1.0))
        asked.append(worth[len(asked)])
        without = Model(starts, 1.0 + asked[-1] + scatter)
        return None if enough(search._of_first(without)) else without

    monkeypatch.setattr(search, "_fitted", fitted)
    search._added = {"noise_floor": Added("noise_floor")}
    search._glanced = {"noise_floor": (0.0, 0.0, {}, False)}
    search.held, search.steps = ["noise_floor"], [TrialStep("noise_floor", 0.1, 0.01, 0.0, True)]
    model = search._asked_again(Model([scene] * 2, np.full(12, 1.0)))
    assert len(asked) == draws <= DRAWS
    assert ("noise_floor" in search.held) is (said == "stays")
    assert ("noise_floor" in model.scenes[0].effects) is (said == "stays")
    assert (search._untold() == ["noise_floor"]) is (said == "cannot be told here")


@pytest.mark.unit
def test_rays_are_followed_anew_only_where_a_trace_of_them_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A trace of bounces makes views left out worse, in both readings of a reflection: no fit of them begins."""
    (tmp_path / "scene.toml").write_text(SCENE + views(12))
    scene = Scene.load(tmp_path / "scene.toml")
    search = FoldSearch.__new__(FoldSearch)
    search.folds, search.order = folds(scene.views, 2), [view.name for view in scene.views]
    search._log, search._glanced, search.device = RunLog(), {}, devices.resolve_device("cpu")
    search.trained = TrainViews.__new__(TrainViews)
    search.trained.names = search.order
    asked: list[tuple[float, float]] = []

    def scores(one: Scene, names: list[str], *, coarse: bool = False) -> np.ndarray:
        assert coarse  # borders of corners are cut finer for a fit alone
        strength = one.effects.get("multibounce", {}).get("strength", 0.0)
        asked.append((strength, one.sampling.density_per_m2(one.grid) / scene.sampling.density_per_m2(scene.grid)))
        return np.full(len(names), 1.0 + strength)

    monkeypatch.setattr(search.trained, "scores", scores)
    monkeypatch.setattr(search, "_level", lambda model: 0.01)
    monkeypatch.setattr(search, "_progress", lambda: None, raising=False)
    search._glance(Model([scene] * 2, np.ones(12)), [EffectHypothesis("multibounce")])
    gain, *_ = search._glanced["multibounce"]
    traces = [strength for strength, _ in asked if strength]
    assert gain == pytest.approx(-min(traces))
    assert max(traces) < 0.1  # where fits begin it is 0.2 and more
    assert {share for _, share in asked} == {0.125}


@pytest.mark.unit
def test_a_profile_that_is_not_even_has_its_minimum_where_it_is() -> None:
    """Of x^2 + 0.4 x^3 about 0.3, by five places: a parabola would be off by 0.03."""
    places = np.linspace(-0.7, 1.3, 5)
    loss = (places - 0.3) ** 2 + 0.4 * (places - 0.3) ** 3
    assert minimum(places.tolist(), loss.tolist()) == pytest.approx(0.3, abs=1e-3)


@pytest.mark.unit
def test_the_interval_is_that_of_the_scatter() -> None:
    """Views that like places about 1 with a scatter of 0.2: 36 of them tell their mean to 0.2 / 6, and what is known
    draws it as one more measurement does."""
    likes = 1.0 + 0.2 * np.random.default_rng(0).normal(size=36)
    places = np.linspace(0.0, 2.0, 7)
    losses = 0.5 * (places[:, None] - likes) ** 2
    found, sd, half = likeliest(places.tolist(), losses, np.zeros(7))
    assert found == pytest.approx(likes.mean(), abs=1e-6)
    assert sd == pytest.approx(likes.std(ddof=1) / 6.0, rel=0.5)
    assert half > 2.0 * sd
    pulled, *_ = likeliest(places.tolist(), losses, 0.5 * 36.0 * (places - 0.5) ** 2)
    assert pulled == pytest.approx(0.5 * (likes.mean() + 0.5), abs=1e-6)


@pytest.mark.unit
def test_numbers_are_those_with_a_tolerance(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(
        SCENE.replace('learn = ["size"]', 'learn = ["size", "heading"]').replace(
            'polarizations = ["HH"]',
            'polarizations = ["HH"]\nlearn = ["azimuth_deg"]\ntolerance = { azimuth_deg = 3.0 }',
        )
        + views(2)
    )
    scene = Scene.load(path)
    found = numbers(scene)
    assert [one.label for one in found] == ["views.azimuth_deg", "body.height", "body.width", "body.length"]
    assert [one.sd for one in found] == pytest.approx([3.0, 0.2, 0.25, 0.5])
    turned = found[0].moved(scene, 2.0)
    assert [view.azimuth_deg for view in turned.views] == [2.0, 182.0]
    assert found[0].now(turned) == pytest.approx(2.0)
    assert found[1].now(found[1].moved(scene, 0.3)) == pytest.approx(2.3)


@pytest.mark.unit
def test_a_profile_goes_on_beyond_its_end(tmp_path: Path) -> None:
    """The losses of twelve views are least at a height of 2.6 m, three standard deviations above the known one; the
    first places end at 2.24 m."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + views(2))
    scene = Scene.load(path)
    height = next(one for one in numbers(scene) if one.label == "body.height")
    likes = 2.6 + 0.02 * np.random.default_rng(0).normal(size=12)
    found, by = profiled(height, scene, WIDE, lambda change: (height.now(change(scene)) - likes) ** 2, weight=1e4)
    assert len(found.places) == len(WIDE)
    assert found.value == pytest.approx(2.6, abs=0.02)
    assert height.now(height.moved(scene, by)) == pytest.approx(found.value)
    assert found.half > 0.0
    # what falls as far as anybody looks is known to no better than a step
    end, _ = profiled(height, scene, WIDE, lambda change: np.full(12, -height.now(change(scene))), weight=1e4)
    assert end.half >= end.places[-1] - end.places[-2]


@pytest.mark.unit
@pytest.mark.parametrize(
    ("likes_m", "scatter_m", "weight", "leaves"),
    [(2.68, 0.02, 1e4, True), (2.68, 2.0, 1.0, False), (2.3, 0.02, 1e4, False)],
)
def test_a_height_far_from_its_tolerance_is_said(
    tmp_path: Path, likes_m: float, scatter_m: float, weight: float, leaves: bool
) -> None:
    """Known as 2.0 +- 0.2 m: 2.68 m is 3.4 of its standard deviations away. Views that hardly know do not say so."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + views(2))
    scene = Scene.load(path)
    height = next(one for one in numbers(scene) if one.label == "body.height")
    likes = likes_m + scatter_m * np.random.default_rng(0).normal(size=12)
    found, _ = profiled(height, scene, WIDE, lambda change: (height.now(change(scene)) - likes) ** 2, weight)
    result = held({"model": (0.9, 1.3), **PICTURE}, 1.3, rivals=False)
    result.profiles["body.height"] = found
    assert found.pull.prior == pytest.approx(2.0)
    assert leaving(result.pulls) == (["body.height"] if leaves else [])
    assert any("body.height leaves its tolerance: known as 2 +- 0.2 m" in one for one in judgement(result)) == leaves
    if scatter_m < 1.0:
        assert found.data == pytest.approx(likes.mean(), abs=0.01)
        assert found.pull.tension == pytest.approx((likes.mean() - 2.0) / 0.2, rel=0.02)


@pytest.mark.unit
def test_a_body_as_a_box_stands_where_it_stood(tmp_path: Path) -> None:
    """A wedge, 6 x 2 x 1 m and off its file's origin, heading 30 degrees and rolled: the box has its extents, hull and
    material, and its sizes are free."""
    corners = [(a, b, c) for a in (-0.5, 1.5) for b in (1.0, 7.0) for c in (0.2, 1.2)]
    (tmp_path / "wedge.obj").write_text(
        "".join(f"v {a} {b} {c}\n" for a, b, c in corners) + "f 1 3 7\nf 1 7 5\nf 2 6 8\nf 2 8 4\nf 1 2 3\n"
    )
    text = SCENE.replace('primitive = "box"', 'mesh = "wedge.obj"').replace("size_m = [5.0, 2.5, 2.0]\n", "")
    text = text.replace('learn = ["size"]', 'learn = ["scale", "heading"]').replace(
        "tolerance = { size_m", "tolerance = { scale"
    )
    path = tmp_path / "scene.toml"
    path.write_text(text + "position_m = [3.0, -2.0, 0.0]\nheading_deg = 30.0\nroll_deg = 4.0\n" + views(2))
    scene = Scene.load(path)
    boxed = as_box(scene, ["body"])
    one = boxed.objects[1]
    assert one.size_m == pytest.approx((6.0, 2.0, 1.0))
    assert one.material == "metal"
    assert scene.assembly is not None
    assert boxed.assembly is not None
    wedge, box = scene.assembly.vertices_of(scene.objects[1]), boxed.assembly.vertices_of(one)
    np.testing.assert_allclose(box.min(axis=0), wedge.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(box.max(axis=0), wedge.max(axis=0), atol=1e-6)
    assert {"body.height", "body.width", "body.length"} <= {number.label for number in numbers(boxed)}
    again = scene_of(scene, scene_content(scene, boxed))
    np.testing.assert_array_equal(again.mesh.vertices, boxed.mesh.vertices)


def test_views_that_were_turned_past_north_are_cut(tmp_path: Path) -> None:
    """A scene file's azimuths end at 360 degrees. Those of views that were turned together may pass it."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE + views(2))
    scene = Scene.load(path)
    found = [one.model_copy(update={"images": {"HH": Pixels(np.ones(scene.grid.shape))}}) for one in scene.views]
    turned = found[0].model_copy(update={"azimuth_deg": 360.7})
    train = TrainViews(replace(scene, views=[turned, *found[1:]]), devices.resolve_device("cpu"))
    cut = train.scene.views[0]
    assert cut.azimuth_deg == 360.7
    assert cut.images["HH"].shape == train.scene.grid.shape < scene.grid.shape


@pytest.mark.full
def test_a_floor_and_a_height_are_found(tmp_path: Path) -> None:
    """A box 12 % higher than declared, over a floor that nobody declared, in twelve views of one look. A search that
    goes on from all entries of its checkpoint but the last eight ends as one that never stopped."""
    scene, device = measured(tmp_path, height_m=2.24), devices.resolve_device("cpu")
    log = RunLog(tmp_path, "this run")
    found = held_out(scene, device, 2, log)
    assert "noise_floor" in found.held
    assert GEOMETRY in found.held
    height = found.profiles["body.height"]
    assert height.value == pytest.approx(2.24, abs=max(height.half, 0.1))
    before, after = (np.mean(list(each.values())) for each in (found.before, found.after))
    assert after < before
    assert after == pytest.approx(1.0, abs=0.15)
    level = found.final.effects["noise_floor"]["level"]
    assert level == pytest.approx(0.004, rel=0.5)

    stored = open_run_log(tmp_path, "this run", True).entries
    assert len(stored) == len(log.entries)
    resumed = RunLog(entries=stored[:-8])
    again = held_out(scene, device, 2, resumed)
    assert json.dumps(resumed.entries) == json.dumps(stored)
    for key in ("steps", "after", "profiles", "held"):
        assert getattr(again, key) == getattr(found, key), key
    assert again.final.effects == found.final.effects


def of_a_truck(folder: Path, name: str, heading_deg: float = 0.0) -> FoldSearch:
    """A search, fitted as declared, of twelve views of one look of a truck 6 m long, whose declared body is a mesh: of
    the truck itself, or of a box."""
    truck = Object(primitive="truck", size_m=(6.0, 2.5, 2.6), cabin=0.4, material="metal")
    for kind, one in {"truck": truck, "box": truck.model_copy(update={"primitive": "box", "cabin": None})}.items():
        made = body(one)
        write_obj(folder / f"{kind}.obj", Mesh(made.vertices, made.faces, np.zeros(len(made.faces), np.int32)))
    scenes = {}
    for kind in dict.fromkeys(("truck", name)):
        text = SCENE.replace('primitive = "box"', f'mesh = "{kind}.obj"').replace("size_m = [5.0, 2.5, 2.0]\n", "")
        text = text.replace('learn = ["size"]', 'learn = ["scale", "heading"]')
        (folder / "scene.toml").write_text(text.replace("tolerance = { size_m", "tolerance = { scale") + views(12))
        scenes[kind] = Scene.load(folder / "scene.toml")
    random, seen = np.random.default_rng(1), []
    for view, image in zip(scenes[name].views, simulate(scenes["truck"], device="cpu", seed=5), strict=True):
        power = image.beta0["HH"] * random.gamma(1.0, 1.0, image.beta0["HH"].shape)
        stated = view.model_dump(by_alias=True, exclude_unset=True)
        seen.append(View.model_validate({**stated, "images": {"HH": power.astype(np.float32)}, "looks": 1.0}))
    declared = Scene(**{**_fields(scenes[name]), "views": seen})
    ground, one = declared.objects
    declared = with_objects(declared, [ground, one.model_copy(update={"heading_deg": heading_deg})])
    search = FoldSearch(declared, devices.resolve_device("cpu"), 2, lambda: None)
    search._model = search._surely_fitted([search.start] * 2)
    return search


@pytest.mark.full
def test_a_mesh_that_says_no_more_than_a_box_is_not_this_body(tmp_path: Path) -> None:
    """Of a truck, its own mesh predicts the views left out better than a box of its size does, and a mesh of a box does
    not."""
    ahead = {}
    for name in ("truck", "box"):
        search = of_a_truck(tmp_path, name)
        search._meet_box()
        models = {"model": search._model.scenes, "box": search._rivals["box"].scenes}
        lead = advantage(search._images(models), rivals=("box",))
        assert lead is not None
        ahead[name] = lead.ahead
        assert search._beaten() is (name == "box")
    assert ahead["truck"]
    assert not ahead["box"]


@pytest.mark.full
def test_the_box_has_a_search_of_its_own_before_a_lead_is_claimed(tmp_path: Path) -> None:
    """A box that was left below its best is as good as a mesh of a box once it was searched, and stays behind a truck's
    own mesh. A resumed run takes the box's search from the log."""
    for name in ("truck", "box"):
        search = of_a_truck(tmp_path, name)
        search._meet_box()
        poor = search._rivals["box"]
        below = Model(poor.scenes, poor.scores + 1.0)
        search._rivals["box"], search._log = below, RunLog()
        search._search_box()
        found, log = search._rivals["box"], search._log
        search._rivals["box"], search._log = below, RunLog(entries=log.entries)
        search._search_box()
        assert (search._rivals["box"].scores == found.scores).all()
        assert search._log.entries == log.entries  # nothing was found anew
        assert found.scores.mean() < poor.scores.mean() + 0.5
        assert search.steps[-1].label == SEARCHED
        models = {"model": search._model.scenes, "box": found.scenes}
        lead = advantage(search._images(models), rivals=("box",))
        assert lead is not None
        assert lead.ahead is (name == "truck")


@pytest.mark.full
def test_a_body_turned_round_meets_its_turned_rival(tmp_path: Path) -> None:
    """A truck that is declared the wrong way round is turned, and its front is told; it is not asked again."""
    search = of_a_truck(tmp_path, "truck", heading_deg=180.0)
    search._ask_fronts()
    assert search.held == [f"body {TURNED}"]
    assert [scene.objects[1].heading_deg % 360.0 for scene in search._model.scenes] == [0.0, 0.0]
    front = search._fronts["body"]
    assert front.gain < -4.0 * front.error  # of what is now the rival
    tried = len(search.steps)
    search._ask_fronts()
    assert len(search.steps) == tried


@pytest.mark.unit
def test_fronts_are_asked_at_the_first_sizes_and_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three effects gain, and sizes are moved after each: the front is asked beside the first of these models and the
    last one, the box too. Where the first is the last, both are asked once."""
    (tmp_path / "scene.toml").write_text(SCENE + views(6))
    scene = Scene.load(tmp_path / "scene.toml")
    for effects, expected in ((3, [1, 3]), (1, [1])):
        search = FoldSearch.__new__(FoldSearch)
        search._met = search._faced = None
        search.steps, search.bodies, search.ended = [], ["body"], ""
        search._model = Model([scene], np.zeros(6))
        left, asked = list(range(1, effects + 1)), {"front": [], "box": []}  # type: ignore[var-annotated]

        def turn(model: Model, refused: set[str], search: FoldSearch = search, left: list[int] = left) -> Model | None:
            search.steps.append(TrialStep("one", 1.0, 0.1, 0.0, True))
            return Model(model.scenes, np.full(6, float(left.pop(0)))) if left else None

        def fronts(search: FoldSearch = search, asked: dict[str, list[int]] = asked) -> None:
            asked["front"].append(int(search._model.scores[0]))
            search._faced = search._model

        def box(search: FoldSearch = search, asked: dict[str, list[int]] = asked) -> None:
            asked["box"].append(int(search._model.scores[0]))
            search._met = search._model

        for name, stub in {
            "_turn": turn,
            "_ask_fronts": fronts,
            "_ask_glints": lambda: None,
            "_meet_box": box,
            "_geometry": lambda offsets: offsets,
            "_asked_again": lambda model: model,
            "_beaten": lambda: False,
            "_ahead_of_box": lambda: False,
        }.items():
            monkeypatch.setattr(search, name, stub)
        search._search()
        assert asked == {"front": expected, "box": expected}


def held(
    beside: dict[str, tuple[float, float]],
    after: float,
    *,
    rivals: bool = True,
    fronts: dict[str, TrialStep] | None = None,
    box_held: list[str] | None = None,
) -> HeldOut:
    """An outcome with predictions of ten views by name: correlation and deviance; `after` is the score of the model."""
    scatter = np.linspace(-0.01, 0.01, 10)
    view = View(name="v", azimuth_deg=0.0, incidence_deg=60.0)
    images = [
        PredictedImage(
            view,
            "HH",
            True,
            {name: Agreement(c + (k + 1) * d, c, v, (0, 0)) for k, (name, (c, v)) in enumerate(beside.items())},
        )
        for d in scatter
    ]
    scores = {f"v{k}": after + float(d) for k, d in enumerate(scatter)}
    scene = Scene.__new__(Scene)
    return HeldOut(scene, scene, scene, [], [], {}, scores, scores, images, rivals, fronts or {}, box_held)


PICTURE = {"nearest": (0.8, 3.0)}


@pytest.mark.unit
def test_no_lead_is_claimed_before_a_box_was_met() -> None:
    """The model is ahead of pictures in all of these: that alone says nothing of a body."""
    unmet = held({"model": (0.9, 1.3), **PICTURE}, 1.3)
    assert not unmet.ahead
    assert sentence(unmet).endswith("no lead is claimed: a box of its size was not asked")
    assert held({"model": (0.9, 1.3), **PICTURE}, 1.3, rivals=False).ahead

    beaten = held({"model": (0.9, 1.3), **PICTURE, "box": (0.9, 1.3)}, 1.3)
    assert not beaten.ahead
    assert sentence(beaten).endswith("not this body")
    beaten.ended = BEATEN
    assert "the search ended early, for a box of its size predicts as well" in sentence(beaten)

    early = held({"model": (0.9, 1.3), **PICTURE, "box": (0.8, 1.4)}, 1.3)
    assert not early.ahead
    assert sentence(early).endswith("no lead is claimed: a box of its size had no search of its own")
    better = held({"model": (0.9, 1.3), **PICTURE, "box": (0.8, 1.4)}, 1.3, box_held=[])
    assert better.ahead
    assert sentence(better).endswith("predicts better than pictures of other views and a box")

    # by correlation it is ahead, by deviance behind, within the error of scattered deviances
    scattered = held({"model": (0.9, 1.301), **PICTURE, "box": (0.8, 1.3)}, 1.3, box_held=[])
    for image, off in zip(scattered.images, np.tile([0.1, -0.1], 5), strict=True):
        model = image.predictions["model"]
        more = {**image.predictions, "model": replace(model, deviance=model.deviance + off)}
        object.__setattr__(image, "predictions", more)
    assert not scattered.ahead
    assert "whether it is this body is not told" in sentence(scattered)

    # the body is a box: nothing but speckle is left
    box = held({"model": (0.9, 1.0), **PICTURE, "box": (0.9, 1.0)}, 1.0)
    assert box.ahead
    assert "a box does as well, and nothing but speckle is left" in sentence(box)


@pytest.mark.unit
def test_a_box_that_was_asked_early_meets_the_model_of_that_time() -> None:
    found = held({"model": (0.95, 1.2), **PICTURE, "box": (0.9, 1.3), "then": (0.9, 1.3)}, 1.2)
    assert not found.ahead
    assert any("before all effects were tried" in words for words in judgement(found))


@pytest.mark.unit
def test_a_front_that_is_not_told_is_said() -> None:
    beside = {"model": (0.9, 1.3), **PICTURE, "box": (0.8, 1.4)}
    step = TrialStep(f"car {TURNED}", -0.01, 0.02, 0.0, False)
    assert "which end of car is its front is not told" in sentence(held(beside, 1.3, fronts={"car": step}))
    told = held(beside, 1.3, fronts={"car": replace(step, gain=-0.1)})
    assert "front" not in sentence(told)
    assert any("turned round, car changes" in words for words in judgement(told))


@pytest.mark.full
def test_time_that_is_over_leaves_the_first_model(tmp_path: Path) -> None:
    late = held_out(measured(tmp_path), devices.resolve_device("cpu"), 2, time_limit_s=0.0)
    assert late.not_asked == ["whether another effect is missing", RIVALS]
    assert not late.ahead
    assert late.before == late.after


@pytest.mark.full
def test_time_that_is_over_leaves_no_name_that_is_not_earned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three effects stay by one standard error. One is worth two, and one was asked again: the third has no name."""

    def search(self: FoldSearch) -> None:
        for label, gain in (("noise_floor", 0.03), ("two_scale", 0.015), ("vegetation", 0.015)):
            self._added[label] = Added(label)
            self.held.append(label)
            self.steps.append(TrialStep(label, gain, 0.01, 0.0, True))
        self.steps.append(TrialStep("vegetation", 0.03, 0.01, 0.0, True, again=True))
        raise TimeUp

    monkeypatch.setattr(FoldSearch, "_search", search)
    late = held_out(measured(tmp_path), devices.resolve_device("cpu"), 2)
    assert late.held == ["noise_floor", "vegetation"]
    assert late.untold == ["two_scale"]
    assert late.not_asked == ["", "the gain of each effect at the end", RIVALS]


@pytest.mark.full
def test_the_commands_end_in_a_prediction(tmp_path: Path) -> None:
    """`diagnose --folds`, then `evaluate`: its test views beside the rivals, each at its own aim point."""
    (tmp_path / "in").mkdir()
    measured(tmp_path).save(tmp_path / "in" / "scene.toml")
    run = CliRunner().invoke(
        main, ["diagnose", str(tmp_path / "in" / "scene.toml"), "-o", str(tmp_path / "out"), "--folds", "2"]
    )
    assert run.exit_code in (0, 4), run.output
    assert "found: noise_floor" in run.output
    assert (tmp_path / "out" / "report.html").stat().st_size > 10_000
    run = CliRunner().invoke(
        main,
        [
            "evaluate",
            str(tmp_path / "out" / "scene.toml"),
            "-o",
            str(tmp_path / "ev"),
            "--before",
            str(tmp_path / "in" / "scene.toml"),
        ],
    )
    assert run.exit_code == 0, run.output
    assert "correlation" in run.output
    assert (tmp_path / "ev" / "evaluate.json").read_text().count('"nearest"') > 1


@pytest.mark.unit
def test_options_of_tests_are_refused_beside_folds(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    words = ["diagnose", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "o"), "--folds", "3", "--draws", "500"]
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 2
    assert "--draws: not with --folds" in run.output


@pytest.mark.unit
def test_nothing_to_go_on_from_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE + views(6))
    words = ["diagnose", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "o"), "--folds", "3", "--resume"]
    run = CliRunner().invoke(main, words)
    assert run.exit_code == 2
    assert f"--resume: found no checkpoint in {tmp_path / 'o'}" in run.output


@pytest.mark.measured
@pytest.mark.full
def test_measured_chips_come_with_roles_and_rivals(tmp_path: Path, measured_data: Path) -> None:
    """Every sixth chip of the example's vehicle: its declared model is further from the test chips than a picture of
    the nearest train chip, and says so."""
    folder = measured_data / "mstar_btr70"
    example = Path(__file__).resolve().parents[2] / "examples" / "measured" / "btr70" / "scene.toml"
    path = tmp_path / "scene.toml"
    path.write_text(example.read_text().replace("vehicle.obj", str(folder / "BTR70.obj")))
    done = import_chips(
        sorted((folder / "chips").glob("*.jpeg"))[::6],
        path,
        folder / "views.csv",
        quantity="amplitude",
        radar_at="bottom",
        spacing_m=(0.202148, 0.203125),
        scale="unknown",
        train=20,
        held_back=[(85.0, 115.0), (205.0, 235.0), (315.0, 345.0)],
    )
    scene = Scene.load(path)
    assert sum(view.role == "train" for view in scene.views) == 20
    assert len(done.views) == len(scene.views)
    found = predictions({"model": scene}, devices.resolve_device("cpu"))
    means = {row.prediction: row.correlation for row in summaries(found) if row.in_sector}
    assert 0.7 < means["model"] < means["nearest"] < 0.9
    assert means["mean"] < means["model"]
    one = advantage(found)
    assert one is not None
    assert not one.ahead


# ---- azimuths of a table of another hand


@pytest.fixture(scope="module")
def eighteen(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return measured(tmp_path_factory.mktemp("eighteen"), count=18)


def test_azimuths_as_stated_are_left_alone(eighteen: Scene) -> None:
    assert counted(TrainViews(eighteen, devices.resolve_device("cpu"))) is None


@pytest.mark.parametrize(
    ("stated", "label"),
    [
        (lambda azimuth: -azimuth, "azimuths counted counterclockwise from the front"),
        (lambda azimuth: azimuth - 90.0, "azimuths counted clockwise from the right side"),
        (lambda azimuth: 90.0 - azimuth, "azimuths counted counterclockwise from the right side"),
    ],
)
def test_how_azimuths_are_counted_is_found(eighteen: Scene, stated: Callable[[float], float], label: str) -> None:
    """A box looks the same from behind, so only one of two opposite sides is asked of it: the first that does as well.
    Counted anew, all views have the azimuths that they were made at."""
    views = [view.model_copy(update={"azimuth_deg": stated(view.azimuth_deg) % 360.0}) for view in eighteen.views]
    search = FoldSearch(replace(eighteen, views=views), devices.resolve_device("cpu"), 3, lambda: None)
    assert search.held == [label]
    found = np.array([view.azimuth_deg for view in search.start.views])
    np.testing.assert_allclose((found - [view.azimuth_deg for view in eighteen.views]) % 180.0, 0.0, atol=1e-9)


def test_detail_beyond_the_mesh_ends_a_body(tmp_path: Path) -> None:
    """Two ends, each known to half of a cell of 0.4 m: 0.283 m of a length, a share of 0.283 / 5 of a mesh of 5 m."""
    (tmp_path / "scene.toml").write_text(SCENE + views(6))
    text = (tmp_path / "scene.toml").read_text()
    text += "[effects.point_spread]\nrange_fwhm_m = 0.3\nazimuth_fwhm_m = 0.4\nfixed = true\n"
    detailed = text + "[effects.unresolved_detail]\nlevel = 0.01\nspread_m = 0.5\n"
    corners = [(a, b, c) for a in (-1.25, 1.25) for b in (-2.5, 2.5) for c in (0.0, 2.0)]
    (tmp_path / "body.obj").write_text(
        "".join(f"v {a} {b} {c}\n" for a, b, c in corners) + "f 1 3 7\nf 1 7 5\nf 2 6 8\nf 2 8 4\nf 1 2 3\n"
    )
    meshed = detailed.replace(
        'primitive = "box"\nsize_m = [5.0, 2.5, 2.0]', 'mesh = "body.obj"\nscale = [0.5, 1.0, 1.0]'
    )
    meshed = meshed.replace('["size"]\ntolerance = { size_m', '["scale"]\ntolerance = { scale')
    found = {}
    for name, each in {"plain": text, "detailed": detailed, "meshed": meshed}.items():
        (tmp_path / f"{name}.toml").write_text(each)
        scene = Scene.load(tmp_path / f"{name}.toml")
        found[name] = {one.label: beyond_mesh(one, scene) for one in numbers(scene)}
    end_m = 0.4 * np.sqrt(0.5)
    assert set(found["plain"].values()) == {0.0}
    assert found["detailed"] == pytest.approx({"body.height": 0.0, "body.width": end_m, "body.length": end_m})
    shares = {"body.upward": 0.0, "body.across": end_m / 2.5, "body.along": end_m / 5.0}
    assert found["meshed"] == pytest.approx(shares)


# ---- glints


GLINT = Glint((0.75, 1.5, 1.2), 40.0, 60.0, 0.5)


def test_a_glint_is_found_where_it_lies(tmp_path: Path) -> None:
    """A point of -3 dBsm with a wide lobe on a box, in 18 views of one look; nobody declared it. It is found first, to
    a pixel and a step of places, with its lobe, at 0.6 of its cross-section, to half a step of levels (3.2 dB). Views
    left out pay for it."""
    more = f"[effects.glints]\nstrength = 1.0\npoints = [{GLINT.row}]\n"
    scene = measured(tmp_path, count=18, more=more)
    declared = replace(scene, effects={**scene.effects, "noise_floor": {"level": 0.004}})
    trained = TrainViews(declared, devices.resolve_device("cpu"))
    (first,) = found_in_all(trained, trained.scene, 1)
    assert (
        np.abs(np.subtract(first.place_m, GLINT.place_m)).max() < 0.55
    )  # 0.3 m of a pixel and 0.25 m; a foot of height
    assert abs((first.azimuth_deg - GLINT.azimuth_deg + 180.0) % 360.0 - 180.0) <= 40.0
    assert first.half_width_deg in (40.0, 80.0)
    assert -6.0 < 10.0 * np.log10(first.rcs_m2 / GLINT.rcs_m2) < 1.5

    found, count = found_by_parts(trained, [trained.scene] * 3, folds(trained.views, 3))
    assert count >= 1
    assert [len(part) for part in found] <= [count] * 3

    (listed,) = on_bodies(with_glints(trained.scene, [first]))
    assert listed.body == "body"
    assert listed.place_m == pytest.approx(first.place_m, abs=0.01)  # the body stands upright in the middle
    assert listed.rcs_dbsm == pytest.approx(10.0 * np.log10(first.rcs_m2), abs=0.06)


def test_glints_of_one_place_and_lobe_are_one() -> None:
    twice = merged([GLINT, replace(GLINT, azimuth_deg=50.0), replace(GLINT, rcs_m2=0.25)])
    assert twice == [replace(GLINT, rcs_m2=0.75), replace(GLINT, azimuth_deg=50.0)]
    assert Glint.of(GLINT.row) == replace(GLINT, rcs_m2=pytest.approx(0.5, rel=2e-3))
