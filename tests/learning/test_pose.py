"""Poses and sizes learned from images: what x means, the descent, the search, intervals, and what is not told apart."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from learning_scenes import speckle
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.differentiable.geometry import exact_images, image_slopes
from warpsar.effects.bounces import tracing
from warpsar.effects.registry import validate
from warpsar.errors import InputError
from warpsar.learning.command import run
from warpsar.learning.geometry import Geometry
from warpsar.learning.glints import with_glints
from warpsar.learning.learned_objects import learned_objects
from warpsar.learning.options import LearnOptions
from warpsar.learning.pose import (
    FEW_RAYS,
    DenseQuadratic,
    PosedProblem,
    _lower,
    _shortened,
    exact_rays,
    foretold_gain,
    render_elsewhere,
    without_shading,
)
from warpsar.learning.pose_pixels import FLOOR_SHARE, compared
from warpsar.learning.pose_search import find_poses, group_pose, known_near
from warpsar.learning.pose_sharing import boxes, columns_of, faces_about, shared
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.surface.stage import Stage
from warpsar.world.objects.assembly import Assembly
from warpsar.world.objects.table import Object
from warpsar.world.tables import Grid, Material, View
from warpsar.world.world import geometry_of

CPU = devices.resolve_device("cpu")
PLACE = {"position_m": (1.3, -0.8, 0.0), "heading_deg": 35.0, "material": "body"}
BOX = {"primitive": "box", "size_m": (7.0, 4.0, 5.0), **PLACE}
CAR = {"primitive": "car", "size_m": (4.6, 1.8, 1.5), **PLACE}
SIDES = ((10, 40), (100, 45), (190, 50), (280, 40))


def scene_with(
    table: dict[str, Any], sides: Any = SIDES, shape: int = 64, spacing_m: float = 0.5, **more: Any
) -> Scene:
    """An object on a plain."""
    views = [view(azimuth, incidence, name=f"v{k}") for k, (azimuth, incidence) in enumerate(sides)]
    plain = scene_of(mesh_of(g=ground(40)), views, shape=(shape, shape), spacing_m=(spacing_m, spacing_m))
    return placed_in(plain, Object(**{**table, **more}))


def placed_in(scene: Scene, one: Object) -> Scene:
    return with_objects(scene, (one,), {"g": Material(**SOIL), "body": Material(**BRICK)})


def measured(scene: Scene, seed: int = 1, looks: float = 16.0) -> Scene:
    """The scene with its own images, times speckle."""
    random = np.random.default_rng(seed)
    images = exact_images(scene, CPU)

    def seen(one: View) -> View:
        image = images[one.name]["HH"] * speckle(random, scene.grid.shape, looks)
        return one.model_copy(update={"images": {"HH": image.astype(np.float32)}, "looks": looks})

    return replace(scene, views=[seen(one) for one in scene.views])


def displaced(scene: Scene, **changes: Any) -> Scene:
    return placed_in(scene, scene.objects[0].model_copy(update=changes))


def learned(scene: Scene, angles: tuple[Any, ...] = (), spacings: tuple[Any, ...] = (), **tolerance: float) -> Scene:
    """The scene with angles of its first view, and spacings, to learn."""
    first = scene.views[0].model_copy(update={"learn": angles, "tolerance": tolerance})
    return replace(scene, views=[first, *scene.views[1:]], grid=scene.grid.model_copy(update={"learn": spacings}))


def problem_of(scene: Scene, blur_m: float = 0.0, *, held: bool = True) -> PosedProblem:
    plain = FitProblem(scene, CPU, rays=ExactRays(Stage.of(scene, CPU)))
    pixels = {one.view.name: list(one.observations) for one in plain.views}
    both = compared(scene, pixels, blur_m)
    return PosedProblem(both.scene, CPU, both.observations, held=held)


# ---- what x means ----


def test_a_metre_is_a_metre_at_the_edge() -> None:
    """Positions are metres; a heading of one metre moves a corner by about one; a size follows a logarithm."""
    learn = ("position", "heading", "size")
    poses = Geometry(scene_with(BOX, learn=learn))
    assert poses.labels == [f"box.{name}" for name in ("east", "north", "up", "heading", "length", "width", "height")]
    (one,) = poses.at(np.array([0.1, -0.2, 0.3, 0.5, 0.0, 0.4, 0.0])).objects
    np.testing.assert_allclose(one.position_m, (1.4, -1.0, 0.3))
    # half the diagonal of the extent, which the heading of 35 degrees widens
    turned = np.deg2rad(35.0)
    across, along = 4 * np.cos(turned) + 7 * np.sin(turned), 7 * np.cos(turned) + 4 * np.sin(turned)
    radius = np.sqrt(across**2 + along**2 + 25.0) / 2.0
    assert one.heading_deg == pytest.approx(35.0 + np.rad2deg(0.5 / radius))
    assert one.size_m == pytest.approx((7.0, 4.0 * np.exp(0.4 * 2.0 / 4.0), 5.0))
    assert poses.at(np.zeros(7)).objects[0] == scene_with(BOX, learn=learn).objects[0]


def test_tolerances_are_priors() -> None:
    """0.3 m counts as (p / 0.3)^2 / 2; a heading's degrees, and a size's per cent, are turned into metres."""
    tolerance = {"position_m": 0.3, "heading_deg": 2.0, "size_m": "5 %"}
    scene = scene_with(BOX, learn=("position", "heading", "size"), tolerance=tolerance)
    poses = Geometry(scene)
    sd = np.array([s / abs(c.per_metre(0.0)) for (_, s), c in zip(poses.known, poses.coordinates, strict=True)])
    np.testing.assert_allclose(sd[:3], 0.3)
    for k, (start, width) in {3: (35.0, 2.0), 4: (7.0, 0.35), 5: (4.0, 0.2)}.items():
        shift = np.zeros(7)
        shift[k] = 1e-3 * sd[k]
        (one,) = poses.at(shift).objects
        value = one.heading_deg if k == 3 else one.size_m[k - 4]  # type: ignore[index]
        assert value - start == pytest.approx(1e-3 * width, rel=1e-3)
    problem = problem_of(measured(scene))
    x = problem.x0.copy()
    x[0] = 0.6
    free = problem_of(measured(scene_with(BOX, learn=("position", "heading", "size"))))
    assert problem.value(x) - free.value(x) == pytest.approx(2.0, abs=1e-6)


def test_the_floor_keeps_the_mean_and_every_pixel() -> None:
    """Model and measurement get the same level; shadows, which measure nothing, count."""
    scene = measured(scene_with(BOX, learn=("position",)))
    plain = FitProblem(scene, CPU, rays=ExactRays(Stage.of(scene, CPU)))
    both = compared(scene, {one.view.name: list(one.observations) for one in plain.views})
    level = both.scene.effects["noise_floor"]["level"]
    lit = [seen for one in plain.views for seen in one.observations]
    assert level == pytest.approx(FLOOR_SHARE * np.median([np.median(seen.values) for seen in lit]))
    (seen,) = both.observations["v0"]
    np.testing.assert_allclose(seen.measured, scene.measured(scene.views[0], "HH") + level, rtol=1e-6)
    assert seen.count == 60 * 60
    assert (scene.measured(scene.views[0], "HH")[seen.interior] == 0).any()


# ---- derivatives ----


@pytest.mark.full
@pytest.mark.parametrize("blur_m", [0.0, 2.0])
def test_jacobian_against_other_steps(blur_m: float) -> None:
    """Every column against differences over half the step, made here: 1 % of the column's norm."""
    scene = measured(scene_with(CAR, spacing_m=0.25, learn=("position", "heading", "pitch", "roll", "scale", "cabin")))
    scene = learned(scene, ("azimuth_deg", "incidence_deg"), ("range_spacing_m", "azimuth_spacing_m"))
    problem = problem_of(scene, blur_m)
    x = problem.x0 + 0.01
    found = problem.jacobian(x)
    for k in range(x.size):
        step = np.zeros(x.size)
        step[k] = 1e-3
        above, below = problem.modelled(x + step), problem.modelled(x - step)
        for j, a, b in zip(found, above, below, strict=True):
            expected = (np.log(a) - np.log(b)) / 2e-3
            if not expected.any():  # the angle of another view
                assert not j[:, k].any()
                continue
            assert np.linalg.norm(j[:, k] - expected) < 0.01 * np.linalg.norm(expected)


def test_changes_of_a_pose_close_by_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within a tenth of a pixel they are those that were made; where the end is asked for, or beyond, they are new."""
    problem = problem_of(measured(scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position", "heading"))))
    made: list[str] = []
    plain = PosedProblem._change

    def counted(self: PosedProblem, inner: Any, *more: Any, forward: bool) -> None:
        made.extend(one.view.name for one in inner.views)
        plain(self, inner, *more, forward=forward)

    monkeypatch.setattr(PosedProblem, "_change", counted)
    near, far = problem.x0 + 0.04, problem.x0 + 0.06
    problem.jacobian(problem.x0)
    assert made == ["v0", "v1"]
    problem.jacobian(problem.x0)
    problem.jacobian(near, near=True)
    assert len(made) == 2
    problem.jacobian(far, near=True)
    problem.jacobian(near)
    assert len(made) == 6


def two_boxes(apart_m: float, **more: Any) -> Scene:
    """Two boxes with a material each, beside each other on a plain, in one view."""
    scene = scene_with(BOX, sides=SIDES[:1])
    along = geometry_of(scene, scene.views[0]).u
    tables = [{**BOX, "name": f"box{k}", "material": f"body{k}", **more} for k in range(2)]
    places = [tuple((k - 0.5) * apart_m * along) for k in range(2)]
    objects = [Object(**{**table, "position_m": at}) for table, at in zip(tables, places, strict=True)]
    bricks = {f"body{k}": Material(**BRICK, learn=("rms_height_m",)) for k in range(2)}
    return with_objects(scene, objects, {"g": Material(**SOIL, learn=()), **bricks})


@pytest.mark.parametrize(("apart_m", "others"), [(16.0, 0), (7.0, 2)])
def test_changes_of_bodies_that_stay_are_kept(monkeypatch: pytest.MonkeyPatch, apart_m: float, others: int) -> None:
    """One of two boxes turns brighter and moves by half a metre: its two columns are made again, and those of the other
    only where their pixels meet. Whatever is kept is as a problem that begins there has it."""
    scene = measured(two_boxes(apart_m, learn=("position", "heading"), heading_deg=20.0))
    problem, made = problem_of(scene, held=False), []
    count = problem.count // 2
    plain = PosedProblem._change

    def counted(
        self: PosedProblem, inner: Any, rest: Any, p: Any, columns: np.ndarray, into: Any, *, forward: bool
    ) -> None:
        made.append(columns.tolist())
        plain(self, inner, rest, p, columns, into, forward=forward)

    monkeypatch.setattr(PosedProblem, "_change", counted)
    problem.jacobian(problem.x0)
    x = problem.x0.copy()
    x[problem.labels.index("body0.rms_height_m")] += 0.3
    x[problem.labels.index("box0.east")] += 0.5
    kept = problem.jacobian(x, near=True)[0]
    assert made == [list(range(2 * count)), list(range(count + others * count // 2))]
    new = problem_of(scene, held=False).jacobian(x)[0]
    # differences to one side are off in the few pixels where an edge crosses a border within the step: 5 % at most here
    off = np.linalg.norm(kept - new, axis=0) / np.linalg.norm(new, axis=0)
    assert off.max() < 0.1
    assert (off[-count:] == 0.0).all() == (others == 0)
    assert not problem.is_made_at(x)
    np.testing.assert_allclose(problem.jacobian(x)[0], new, atol=1e-6 * np.abs(new).max())
    assert problem.is_made_at(x)


def test_changes_of_angles_are_made_again_where_no_body_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    """What belongs to no body depends on everything: a turn of the views by half a degree."""
    flat = scene_of(mesh_of(g=ground(40), w=box((-2, -2, 0), (2, 2, 4))), [view(*SIDES[0], name="v0")], shape=(48, 48))
    plain = with_objects(flat, [], {})
    problem = problem_of(measured(learned(plain, ("azimuth_deg",), ())))
    made: list[bool] = []
    change = PosedProblem._change
    monkeypatch.setattr(PosedProblem, "_change", lambda *given, **more: (made.append(True), change(*given, **more)))
    for x in (problem.x0, problem.x0 + 0.001, problem.x0 + 0.5):
        problem.jacobian(x, near=True)
    assert len(made) == 2


@pytest.mark.parametrize(("tolerance", "near"), [({"position_m": 0.3, "heading_deg": 2.0}, True), ({}, False)])
def test_what_is_known_to_be_near_needs_no_search(tolerance: dict[str, float], near: bool) -> None:
    """Pixels of 0.5 m lie 0.5 / sqrt(sin 40) = 0.62 m apart on the ground: 0.3 m is known well enough, 0.4 m is not."""
    scene = scene_with(BOX, sides=SIDES[:1], learn=("position", "heading"), tolerance=tolerance)
    assert known_near(scene) is near
    assert not known_near(displaced(scene, tolerance={**tolerance, "position_m": 0.4}))


def test_only_columns_that_a_body_changes_are_made() -> None:
    """Differences of power in these columns are those of whole ones, to rounding of float32."""
    scene = measured(scene_with(CAR, sides=SIDES[:1], learn=("position",)))
    problem = problem_of(scene, 1.0)
    inner, rest = problem.split(problem.x0)
    (seen,) = inner.views
    box = boxes(inner.scene, seen.view)["car"]  # type: ignore[index]
    columns = columns_of([box])
    assert columns == (box.low[1], box.high[1])
    assert columns[1] - columns[0] < 0.7 * scene.grid.shape[1]
    ends = [problem.geometry.at(np.array([t, 0.0, 0.0])) for t in (2e-3, -2e-3)]

    def power(end: Scene, which: tuple[int, int] | None = None) -> np.ndarray:
        return render_elsewhere(inner, seen, rest, end, which).before_image["HH"].numpy().astype(float)

    whole, part = (np.subtract(*(power(end, which) for end in ends)) for which in (None, columns))
    level = float(inner.modelled(rest)[0].max())
    np.testing.assert_allclose(part, whole, atol=1e-5 * level)
    assert np.abs(whole).max() > 1e-3 * level
    for beside in ((-90, -80), (500, 510)):  # a body beside the image
        ahead, behind = (power(end, beside) for end in ends)
        assert np.array_equal(ahead[whole == 0.0], behind[whole == 0.0])


def test_rough_changes_are_those_of_single_bounces() -> None:
    """Beside bounces, the model has their power, and its changes are those without them."""
    plain = measured(scene_with(BOX, sides=SIDES[:1], shape=48, learn=("position",)))
    table = validate("multibounce", {"strength": 1.0, "fixed": True}, "effects.multibounce")
    bounced = replace(plain, effects={"multibounce": table})
    without = FitProblem(plain, CPU, rays=ExactRays(Stage.of(plain, CPU)))
    pixels = {one.view.name: list(one.observations) for one in without.views}
    rough = PosedProblem(bounced, CPU, pixels, held=True, rough=True)
    single = PosedProblem(plain, CPU, pixels, held=True, forward=True)
    (changed,), (expected,) = rough.jacobian(rough.x0), single.jacobian(single.x0)
    (more,), (less,) = (one.modelled(one.x0) for one in (rough, single))
    assert (more > 1.5 * less).any()
    np.testing.assert_allclose(changed * more[:, None], expected * less[:, None], rtol=1e-5, atol=1e-9)


def test_searches_on_blurred_images_send_few_rays_and_cut_no_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search on blurred images asks for pixels' means alone; what is compared has all rays, and finer corners."""
    scene = measured(scene_with(BOX, sides=SIDES[:1], shape=48, learn=("position",)))
    table = validate("multibounce", {"strength": 1.0, "fixed": True}, "effects.multibounce")
    bounced = replace(scene, effects={"multibounce": table})
    plain = FitProblem(scene, CPU, rays=ExactRays(Stage.of(scene, CPU)))
    pixels = {one.view.name: list(one.observations) for one in plain.views}
    cut: list[int] = []
    cuts = tracing._cuts

    def counted(*given: Any) -> Any:
        cut.append(1)
        return cuts(*given)

    monkeypatch.setattr(tracing, "_cuts", counted)
    levels = []
    for forward, expected in ((True, 0), (False, 1)):
        problem = PosedProblem(bounced, CPU, pixels, held=True, forward=forward)
        levels.append(float(problem.modelled(problem.x0)[0].sum()))
        assert len(cut) == expected
        assert problem.by_rays
    # an eighth of 64 rays for each of some hundred pixels along the walls: 1 / sqrt(800), twice
    assert levels[0] == pytest.approx(levels[1], rel=0.07)
    assert not PosedProblem(scene, CPU, pixels, held=True).by_rays
    stage = Stage.of(bounced, CPU)
    few, every = (exact_rays(bounced, stage, coarse=coarse) for coarse in (True, False))
    assert few.rays_per_m2 == pytest.approx(FEW_RAYS * bounced.sampling.density_per_m2(bounced.grid))
    assert every.rays_per_m2 == bounced.sampling.density_per_m2(bounced.grid)


def test_views_left_out_begin_with_the_changes_of_all() -> None:
    scene = measured(scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position",)))
    plain = FitProblem(scene, CPU, rays=ExactRays(Stage.of(scene, CPU)))
    pixels = {one.view.name: list(one.observations) for one in plain.views}
    every, other, own = (
        PosedProblem(scene, CPU, seen, held=True) for seen in (pixels, {"v1": pixels["v1"]}, {"v1": pixels["v1"]})
    )
    other.begin_with(every)
    assert other.is_made_at(other.x0)
    np.testing.assert_allclose(other.jacobian(other.x0)[0], own.jacobian(own.x0)[0], rtol=1e-6)


def test_shifts_of_images_are_foretold() -> None:
    """Blurred images whose pixels lie a fifth of a pixel further in range, and a tenth nearer in azimuth: the shift of
    each image, to the error of differences over pixels, and what it costs of ln L."""
    scene = measured(scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position",)), looks=1e6)
    far = {"range_m": 0.1, "azimuth_m": -0.05}
    moved = exact_images(replace(scene, effects={"registration": validate("registration", far, "registration")}), CPU)

    def problem(images: dict[str, dict[str, np.ndarray]]) -> PosedProblem:
        seen = {one.name: {"HH": images[one.name]["HH"].astype(np.float32)} for one in scene.views}
        views = [one.model_copy(update={"images": seen[one.name], "looks": 16.0}) for one in scene.views]
        return problem_of(replace(scene, views=views), 3.0)

    shifted, there = problem(moved), problem(exact_images(scene, CPU))
    left, slope = (part[3:] for part in without_shading(shifted, shifts=True))
    assert np.linalg.solve(left[:, 3:], slope) == pytest.approx([0.2, -0.1, 0.2, -0.1], abs=0.03)
    cost = shifted.value(shifted.x0) - there.value(there.x0)
    assert foretold_gain(left[:, 3:], slope) == pytest.approx(cost, rel=0.1)


def test_slopes_to_vertices() -> None:
    """The slope of a box that is moved as a whole is that of its position."""
    scene = scene_with(BOX, sides=SIDES[:1])
    displacement = np.zeros_like(scene.mesh.vertices)
    displacement[4:] = (0.6, 0.8, 0.0)
    (found,) = (slopes["HH"] for slopes in image_slopes(scene, displacement, CPU).values())
    there = [displaced(scene, position_m=(1.3 + 0.6 * t, -0.8 + 0.8 * t, 0.0)) for t in (5e-4, -5e-4)]
    up, down = (exact_images(one, CPU)["v0"]["HH"].astype(float) for one in there)
    expected = (up - down) / 1e-3
    assert np.linalg.norm(found - expected) < 0.01 * np.linalg.norm(expected)
    with pytest.raises(InputError, match="found shape"):
        image_slopes(scene, displacement[1:], CPU)
    with pytest.raises(InputError, match="above 0 somewhere"):
        image_slopes(scene, 0.0 * displacement, CPU)


# ---- fits ----


@pytest.mark.full
def test_an_object_is_found_from_afar() -> None:
    """2.5 m, 15 degrees and 20 % off; within three standard deviations of the truth."""
    truth = measured(scene_with(CAR, sides=SIDES[:3], shape=48, spacing_m=0.25, learn=("position", "heading", "scale")))
    away = displaced(truth, position_m=(3.1, -2.5, 0.0), heading_deg=20.0, scale=1.2)
    found = find_poses(away, CPU, held=True)
    told = found.objects["car"]
    for value, sd, expected in (
        *zip(told["position_m"], told["position_sd_m"], (1.3, -0.8, 0.0), strict=True),
        (told["heading_deg"], told["heading_sd_deg"], 35.0),
        (told["scale"][0], told["scale_sd"], 1.0),
    ):
        assert abs(value - expected) < 3.0 * sd
        assert sd < 0.2
    assert found.gain > 100.0
    assert found.size == 5


@pytest.mark.full
def test_a_pose_that_is_right_gains_nothing_to_speak_of() -> None:
    """Twice the gain is chi-square with 4 degrees of freedom: above 18.5 once in a thousand."""
    scene = measured(scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position", "heading")))
    found = find_poses(scene, CPU)
    assert 0.0 <= 2.0 * found.gain < 18.5
    wrong = find_poses(displaced(scene, position_m=(1.4, -0.8, 0.0)), CPU)
    assert 2.0 * wrong.gain > 100.0


@pytest.mark.full
def test_effects_are_fitted_along() -> None:
    """A point spread that is declared: the search blurs more, and the fit finds both."""
    scene = scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position", "heading"))
    blur = validate("point_spread", {"range_fwhm_m": 1.0, "azimuth_fwhm_m": 0.8}, "effects.point_spread")
    seen = measured(replace(scene, effects={"point_spread": blur}))
    start = validate("point_spread", {"range_fwhm_m": 0.7, "azimuth_fwhm_m": 1.1}, "effects.point_spread")
    found = find_poses(replace(displaced(seen, position_m=(1.7, -0.5, 0.0)), effects={"point_spread": start}), CPU)
    told = found.objects["box"]
    np.testing.assert_allclose(told["position_m"], (1.3, -0.8, 0.0), atol=4.0 * max(told["position_sd_m"]))
    assert found.scene.effects["point_spread"]["range_fwhm_m"] == pytest.approx(1.0, rel=0.1)
    assert found.scene.effects["point_spread"]["azimuth_fwhm_m"] == pytest.approx(0.8, rel=0.1)
    assert set(found.scene.effects) == {"point_spread"}


@pytest.mark.full
def test_uncalibrated_images() -> None:
    """A gain of three that nobody stated."""
    scene = measured(scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position", "heading")))
    louder = [
        one.model_copy(update={"images": {"HH": 3.0 * scene.measured(one, "HH")}, "looks": one.looks})
        for one in scene.views
    ]
    free = replace(scene, views=louder, grid=scene.grid.model_copy(update={"calibrated": False}))
    told = find_poses(displaced(free, position_m=(1.7, -0.5, 0.0)), CPU).objects["box"]
    np.testing.assert_allclose(told["position_m"], (1.3, -0.8, 0.0), atol=4.0 * max(told["position_sd_m"]))


@pytest.mark.slow
@pytest.mark.parametrize("table", [BOX, CAR], ids=["box", "car"])
def test_nineteen_of_twenty_starts_find_it(table: dict[str, Any]) -> None:
    """From 3 m, 20 degrees and 20 % of each size. A box sunk into the ground looks like a lower one: roofs count."""
    spacing = 0.5 if table is BOX else 0.25
    truth = measured(scene_with(table, spacing_m=spacing, learn=("position", "heading", "size")))
    good = 0
    for seed in range(20):
        random = np.random.default_rng(seed)
        shift = random.normal(size=2)
        shift *= 3.0 * np.sqrt(random.random()) / np.linalg.norm(shift)
        start = displaced(
            truth,
            position_m=(1.3 + shift[0], -0.8 + shift[1], 0.0),
            heading_deg=35.0 + random.uniform(-20.0, 20.0),
            size_m=tuple(np.array(table["size_m"]) * random.uniform(0.8, 1.2, 3)),
        )
        told = find_poses(start, CPU, held=True).objects[str(table["primitive"])]
        east, north, up = told["position_m"]
        roof = up + told["size_m"][2] - table["size_m"][2]
        error = max(
            abs(east - 1.3), abs(north + 0.8), abs(roof), *np.abs(np.subtract(told["size_m"], table["size_m"])[:2])
        )
        good += error < 0.1 and abs(told["heading_deg"] - 35.0) < 1.0
    assert good >= 19


def test_height_and_range_shift_from_one_side_are_said() -> None:
    """One image of a body without ground: a rise by sin(40), away by cos(40), keeps the range. Four sides part them.

    A shadow on the ground would tell them apart, too.
    """
    words = {}
    for name, sides in {"one": ((0, 40),), "four": SIDES}.items():
        scene = scene_with(BOX, sides=sides, learn=("position",))
        bare = Assembly.of(None, scene.objects, {})
        materials = {"body": scene.materials["body"]}
        scene = replace(scene, assembly=bare, mesh=bare.mesh(scene.objects), materials=materials)
        words[name] = find_poses(measured(scene), CPU, search=False, held=True).words
    (said,) = words["one"]
    assert "box.north -0.77 m, box.up +0.64 m" in said or "box.north +0.77 m, box.up -0.64 m" in said
    assert words["four"] == []


def test_a_sunk_box_and_a_low_one_are_said() -> None:
    scene = measured(scene_with(BOX, learn=("position", "size"), position_m=(1.3, -0.8, -1.0)))
    words = find_poses(scene, CPU, search=False, held=True).words
    assert any("box.height" in sentence for sentence in words)


@pytest.mark.full
def test_learn_writes_poses(tmp_path: Path) -> None:
    """learn.json has values and standard deviations; scene.toml has the pose, and simulates."""
    truth = scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position", "heading"))
    scene = displaced(measured(truth), position_m=(1.6, -0.5, 0.0), heading_deg=30.0)
    scene.save(tmp_path / "scene.toml")
    content = run(tmp_path / "scene.toml", tmp_path / "out", device="cpu", options=LearnOptions(starts=1))
    told = json.loads((tmp_path / "out" / "learn.json").read_text())["objects"]["box"]
    assert told["not_told_apart"] == []
    assert told["heading_deg"] == pytest.approx(35.0, abs=4.0 * told["heading_sd_deg"])
    np.testing.assert_allclose(told["position_m"], (1.3, -0.8, 0.0), atol=4.0 * max(told["position_sd_m"]))
    assert content["intervals_hold"]
    assert (tmp_path / "out" / "objects.png").is_file()
    again = Scene.load(tmp_path / "out" / "scene.toml")
    assert list(again.objects[0].position_m) == told["position_m"]
    assert "noise_floor" not in again.effects


@pytest.mark.full
def test_learn_of_poses_alone(tmp_path: Path) -> None:
    """Surfaces that are known stay as they are."""
    truth = scene_with(BOX, sides=SIDES[:2], shape=48, learn=("position",))
    known = {name: material.model_copy(update={"learn": ()}) for name, material in truth.materials.items()}
    scene = replace(measured(truth), materials=known)
    off = replace(displaced(scene, position_m=(1.5, -0.8, 0.0)), materials=known)
    off.save(tmp_path / "scene.toml")
    content = run(tmp_path / "scene.toml", tmp_path / "out", device="cpu", options=LearnOptions(starts=1))
    assert content["objects"]["box"]["position_m"][0] == pytest.approx(1.3, abs=0.05)
    assert content["stopped"] == "nothing but poses is learned"
    assert "identifiability" not in content


def test_a_pose_that_wants_to_leave_its_tolerance_is_an_alarm() -> None:
    """The box stands 0.5 m east of where the scene knows it to 0.05 m: ten standard deviations. North is right."""
    learn = ("position",)
    truth = measured(scene_with(BOX, sides=SIDES[:2], shape=48, learn=learn))
    away = displaced(truth, position_m=(0.8, -0.8, 0.0), tolerance={"position_m": 0.05})
    found = find_poses(away, CPU, held=True)
    by_label = {pull.label: pull for pull in found.pulls}
    assert set(by_label) == {"box.east", "box.north", "box.up"}
    east, north = by_label["box.east"], by_label["box.north"]
    assert (east.prior, east.prior_sd, east.unit) == (0.8, 0.05, "m")
    assert east.alarm
    assert east.tension is not None
    assert east.data == pytest.approx(1.3, abs=0.05)
    assert abs(north.pull) < 3.0
    assert 0.8 < east.posterior < east.data  # between what is known and what the images say
    # a fit of what was written counts the images once
    (box,) = found.scene.objects
    assert box.tolerance == {"position_m": {"about": (0.8, -0.8, 0.0), "sd": 0.05}}
    assert box.position_m[0] > 1.0
    again = problem_of(found.scene)
    assert again.prior.value(again.x0) == pytest.approx(0.5 * sum(pull.pull**2 for pull in found.pulls), rel=1e-6)


def test_surfaces_keep_their_tolerances_beside_poses() -> None:
    """The gradient of the prior holds materials and poses alike."""
    scene = measured(scene_with(BOX, sides=SIDES[:1], shape=48, learn=("position",), tolerance={"position_m": 0.3}))
    known = scene.materials["g"].model_copy(update={"tolerance": {"eps_r": 0.01}})
    problem = problem_of(replace(scene, materials={**scene.materials, "g": known}), held=False)
    at, x = problem.labels.index("g.eps_r"), problem.x0.copy()
    x[at] += 0.01  # of ln(eps_r - 1), where eps_r - 1 is 5: five standard deviations
    x[problem.size] += 0.3
    assert problem.prior.value(x) == pytest.approx(0.5 * (5.0 * np.expm1(0.01) / 0.01) ** 2 + 0.5, rel=1e-6)
    free = problem_of(scene, held=False)
    assert problem.value(x) - free.value(x) == pytest.approx(problem.prior.value(x) - 0.5, abs=1e-6)


@pytest.mark.full
def test_an_angle_and_a_spacing_are_found() -> None:
    """1.2 degrees of one view's azimuth and 2 % of the azimuth pixels, with the surfaces free: within three standard
    deviations of the truth, which are under 0.1 degrees and 0.2 %. What the scene knows of the angle is a prior."""
    truth = measured(scene_with(BOX))
    wrong = truth.with_values({"views.v0.azimuth_deg": 11.2, "image.azimuth_spacing_m": 0.49})
    start = learned(wrong, ("azimuth_deg",), ("azimuth_spacing_m",))
    found = find_poses(start, CPU)
    angle, spacing = (found.numbers[name] for name in ("views.v0.azimuth_deg", "image.azimuth_spacing_m"))
    assert angle["value"] == pytest.approx(10.0, abs=3.0 * angle["sd"])
    assert spacing["value"] == pytest.approx(0.5, abs=3.0 * spacing["sd"])
    assert (angle["sd"] < 0.1, spacing["sd"] < 1e-3) == (True, True)
    assert found.scene.views[0].azimuth_deg == angle["value"]
    # all views by one number: a turn of the scene, which the same tolerance holds
    turned = truth.with_values({"views.azimuth_deg": 1.0})
    assert [view.azimuth_deg for view in turned.views] == [azimuth + 1.0 for azimuth, _ in SIDES]
    common = turned.radar.model_copy(update={"learn": ("azimuth_deg",), "tolerance": {"azimuth_deg": 2.0}})
    back = find_poses(replace(turned, radar=common), CPU, search=False)
    assert back.numbers["views.azimuth_deg"]["value"] == pytest.approx(-1.0, abs=0.1)
    assert back.scene.views[3].azimuth_deg == pytest.approx(280.0, abs=0.1)
    about = back.scene.radar.tolerance["azimuth_deg"]["about"]
    assert about == pytest.approx(-back.numbers["views.azimuth_deg"]["value"])
    held = learned(wrong, ("azimuth_deg",), azimuth_deg=1e-3)
    (pull,) = find_poses(held, CPU, search=False).pulls
    assert (pull.label, pull.prior, pull.alarm) == ("views.v0.azimuth_deg", 11.2, True)
    assert pull.posterior == pytest.approx(11.2, abs=0.1)


def test_a_tolerance_of_what_is_not_learned_is_refused() -> None:
    seen = {"name": "v", "azimuth_deg": 0.0, "incidence_deg": 40.0, "tolerance": {"azimuth_deg": 1.0}}
    with pytest.raises(InputError, match=r"tolerance: found azimuth_deg; allowed are values that `learn` names"):
        View(**seen)
    with pytest.raises(InputError, match=r"tolerance.range_spacing_m: found 0; allowed is one standard deviation"):
        Grid(shape=(4, 4), spacing_m=(1.0, 1.0), learn=("range_spacing_m",), tolerance={"range_spacing_m": 0})


def test_nothing_to_learn_is_refused() -> None:
    with pytest.raises(InputError, match=r"found no object, view, \[radar\] or \[image\] with `learn`"):
        find_poses(measured(scene_with(BOX)), CPU)
    with pytest.raises(InputError, match="must be a group of the scene's mesh"):
        group_pose(measured(scene_with(BOX)), CPU, "tower")


# ---- the public case ----


@pytest.mark.slow
def test_the_moved_tower(independent_cases: Path) -> None:
    """No object is declared. The truth lies at (-0.7, +0.5) m and 5 degrees: within 5 cm and 0.5 degrees."""
    found = group_pose(Scene.load(independent_cases / "moved_object" / "scene.toml"), CPU, "tower")
    told = found.objects["tower"]
    np.testing.assert_allclose(told["position_m"], (-0.7, 0.5, 0.0), atol=0.05)
    assert told["heading_deg"] == pytest.approx(5.0, abs=0.5)
    assert max(told["position_sd_m"]) < 0.02
    assert told["heading_sd_deg"] < 0.2


# ---- objects that share a render ----


def car_park(count: int) -> Scene:
    """Cars in a row, 6 m apart, and one more behind the first one's shadow."""
    views = [view(0, 45, name="v0"), view(90, 40, name="v1")]
    plain = scene_of(mesh_of(g=ground(60)), views, shape=(120, 120), spacing_m=(0.5, 0.5))
    places = [(6.0 * k - 3.0 * count, 0.3 * k, 0.0) for k in range(count)] + [(-3.0 * count, -12.0, 0.0)]
    table = {"primitive": "car", "size_m": (4.6, 1.8, 1.5), "material": "body", "learn": ("position", "heading")}
    cars = [Object(**{**table, "name": f"c{k}", "position_m": place}) for k, place in enumerate(places)]
    return with_objects(plain, cars, {"g": Material(**SOIL), "body": Material(**BRICK)})


def test_objects_share_a_render_and_the_slopes_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five cars cost less than five times one; every column is what it is with a render of its own.

    1e-3: float32 of the two images that a column is the difference of.
    """
    scene = measured(car_park(4))
    problem = problem_of(scene)
    groups = shared(problem.geometry.coordinates, boxes(scene, scene.views[0]))
    assert sorted(k for group in groups for k in group) == list(range(20))
    assert len(groups) <= 8
    together = problem.jacobian(problem.x0)
    monkeypatch.setattr("warpsar.learning.pose.boxes", lambda scene, view: None)
    alone = problem.jacobian(problem.x0)
    for found, expected in zip(together, alone, strict=True):
        assert np.linalg.norm(found - expected, axis=0).max() < 1e-3 * np.linalg.norm(expected, axis=0).min()


@pytest.mark.parametrize(
    "effects",
    [
        {"registration": {"range_m": 3.0, "azimuth_m": -2.2, "up_m": 1.0}},
        {"aim_point": {"range_m": {"v0": 2.0, "v1": -1.0}, "azimuth_m": {"v1": 4.0}}},
    ],
)
def test_objects_share_a_render_where_effects_move_images(
    effects: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A box is where hits lie and where their power falls: the slopes are those of whole images, to float32."""
    scene = measured(car_park(4))
    problem = problem_of(replace(scene, effects=effects))
    assert len(shared(problem.geometry.coordinates, boxes(problem.scene, scene.views[0]))) < 20
    together = problem.jacobian(problem.x0)
    monkeypatch.setattr("warpsar.learning.pose.boxes", lambda scene, view: None)
    alone = problem.jacobian(problem.x0)
    for found, expected in zip(together, alone, strict=True):
        assert np.linalg.norm(found - expected, axis=0).max() < 1e-3 * np.linalg.norm(expected, axis=0).min()


def test_a_box_holds_all_that_a_move_changes() -> None:
    """A tall body and its long shadow, moved by 5 cm: nothing changes outside of its box."""
    scene = scene_with(BOX, sides=((25, 60),), shape=96, spacing_m=0.5)
    (place,) = (boxes(scene, scene.views[0]) or {}).values()
    up, down = (displaced(scene, position_m=(1.3 + t, -0.8, 0.0)) for t in (0.05, -0.05))
    change = np.abs(exact_images(up, CPU)["v0"]["HH"] - exact_images(down, CPU)["v0"]["HH"])
    assert (change - place.alone(change)).max() < 1e-6 * change.max()
    assert change.max() > 0


def test_faces_elsewhere_change_nothing_of_a_move() -> None:
    """The difference that a move makes is the same without the faces that lie elsewhere across the look direction."""
    far = Object(name="far", primitive="box", size_m=(2.0, 2.0, 2.0), position_m=(-8.0, 9.0, 0.0), material="body")
    scene = measured(scene_with(CAR, sides=SIDES[:1], learn=("position",)))
    scene = with_objects(scene, [*scene.objects, far])
    problem = problem_of(scene, 0.0)
    inner, rest = problem.split(problem.x0)
    label = scene.objects[0].label
    faces = faces_about(scene, inner.views[0].view, {label})
    assert 0.2 < faces.mean() < 1.0
    ends = [problem.geometry.stepped(inner.scene, np.zeros(3), t * np.eye(3)[0]) for t in (2e-3, -2e-3)]
    whole, part = (
        np.subtract(
            *(
                render_elsewhere(inner, inner.views[0], rest, end, None, some).before_image["HH"].numpy().astype(float)
                for end in ends
            )
        )
        for some in (None, faces)
    )
    np.testing.assert_allclose(part, whole, atol=1e-5 * np.abs(inner.modelled(rest)[0]).max())
    assert np.abs(whole).max() > 0.0


@pytest.mark.full
def test_a_bright_point_beside_a_body_is_found_and_none_is_where_there_is_none() -> None:
    """A plate that stands beside a box: its place is found to a pixel, and both bodies' images pay for it or not."""
    body = Object(name="hut", primitive="box", size_m=(6.0, 3.0, 3.0), material="body", glint=True)
    lower = body.model_copy(update={"name": "shed", "position_m": (-9.0, 7.0, 0.0)})
    point = Object(name="lamp", primitive="box", size_m=(0.4, 0.4, 0.4), position_m=(1.0, 2.5, 3.2), material="lamp")
    views = [view(azimuth, 45, name=f"v{k}") for k, azimuth in enumerate((88.0, 92.0))]
    plain = scene_of(mesh_of(g=ground(40)), views, shape=(64, 64), spacing_m=(0.5, 0.5))
    kinds = {"g": Material(**SOIL), "body": Material(**BRICK)}
    bright = Material(**{**BRICK, "rms_height_m": 6.0 * BRICK["rms_height_m"]})
    truth = measured(with_objects(plain, [body, lower, point], {**kinds, "lamp": bright}))
    asked = with_objects(truth, [body, lower], kinds)
    found = with_glints(asked, CPU, "gamma")
    assert [one.label for one in found.objects] == ["hut", "shed", "hut.glint"]
    assert not any(one.glint for one in found.objects)
    glint = found.objects[-1]
    d, u = (getattr(geometry_of(found, views[0]), axis) for axis in "du")
    for axis in (d, u):  # where it is seen, in range and in azimuth
        assert abs(np.subtract(glint.position_m, point.position_m) @ axis) < 0.5
    again = with_glints(measured(asked), CPU, "gamma")
    assert [one.label for one in again.objects] == ["hut", "shed"]


@pytest.mark.full
def test_learn_fits_a_body_together_with_its_bright_point() -> None:
    """A box that stands 0.4 m from where it was read off, and a lamp beside it: both are found, the box within three
    standard deviations, and the images gain by the lamp."""
    views = [view(azimuth, 45, name=f"v{k}") for k, azimuth in enumerate((40.0, 110.0))]
    plain = scene_of(mesh_of(g=ground(40)), views, shape=(64, 64), spacing_m=(0.5, 0.5))
    known = {"learn": ("position",), "tolerance": {"position_m": [0.5, 0.5, 0.0]}}
    body = Object(name="hut", primitive="box", size_m=(6.0, 3.0, 3.0), material="body", **known)
    lamp = Object(name="lamp", primitive="box", size_m=(0.4, 0.4, 0.4), position_m=(1.0, 2.5, 3.2), material="lamp")
    bright = Material(**{**BRICK, "rms_height_m": 6.0 * BRICK["rms_height_m"]})
    kinds = {"g": Material(**SOIL), "body": Material(**BRICK).model_copy(update={"learn": ("rms_height_m",)})}
    stands = body.model_copy(update={"position_m": (0.3, -0.25, 0.0)})
    truth = measured(with_objects(plain, [stands, lamp], {**kinds, "lamp": bright}))
    ends = {}
    for glint in (False, True):
        asked = with_objects(truth, [body.model_copy(update={"glint": glint})], kinds)
        learned = learned_objects(asked, CPU, "gamma")
        assert learned is not None
        ends[glint] = learned.found
    assert [one.label for one in ends[True].scene.objects] == ["hut", "hut.glint"]
    told = ends[True].objects["hut"]
    for value, sd, true in zip(told["position_m"], told["position_sd_m"], stands.position_m, strict=True):
        assert abs(value - true) <= 3.0 * sd
    assert told["position_sd_m"][2] == 0.0
    assert ends[True].loss < ends[False].loss - 30.0


def test_effects_that_carry_power_share_nothing() -> None:
    scene = replace(car_park(2), effects={"multibounce": {"max_bounces": 2}})
    assert boxes(scene, scene.views[0]) is None
    assert shared(Geometry(scene).coordinates, None) == [[k] for k in range(12)]


@pytest.mark.unit
def test_a_step_that_gains_nothing_is_damped_however_many_gained_before() -> None:
    """A curvature that is a hundred times too small: steps overshoot until they are damped by 50 or more. After many
    steps of gain the damping stands at 1e-9."""
    x, curvature = np.array([1e-3]), 3.0
    problem: Any = SimpleNamespace(
        bounds=(np.array([-1e3]), np.array([1e3])),
        size=0,
        nodes=None,
        geometry=SimpleNamespace(coordinates=[SimpleNamespace(body="car")]),
        value=lambda at: float(0.5 * curvature * at[0] ** 2),
    )
    gradient, hessian = curvature * x, np.array([[curvature / 100.0]])
    here = DenseQuadratic(x, problem.value(x), gradient, hessian, problem.bounds)
    found = _lower(problem, here, 1e-9, 1e-9)
    assert found is not None
    assert found[1] < problem.value(x)


@pytest.mark.unit
def test_a_body_that_would_move_far_does_not_hold_another_back() -> None:
    """Nor does the surface of one body hold back that of the other, or what both have in common."""
    geometry = SimpleNamespace(coordinates=[SimpleNamespace(body=body) for body in ("car", "car", "van")])
    owners = np.array([[False, False, True, False], [False, False, False, True]])
    problem: Any = SimpleNamespace(size=4, nodes=None, geometry=geometry, owners=owners)
    step = np.array([2.0, 1.0, 4.0, -0.5, 5.0, -1.0, 0.5])
    np.testing.assert_allclose(_shortened(problem, step), [1.0, 0.5, 1.0, -0.5, 1.0, -0.2, 0.5])
