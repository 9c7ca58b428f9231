"""What the mesh lacks: places that views agree on, bodies that are found there, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import with_effect
from learning_scenes import speckle
from one_body import BODY, BOX
from test_diagnose_geometry import fitted_of
from worlds import BRICK, SOIL, box, ground, join, mesh_of, plate, scene_of, view

from warpsar.diagnosis.command import run
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.geometry.missing_object import _worth_a_fit, proposed
from warpsar.diagnosis.models.projection import pixel_of
from warpsar.diagnosis.proposals import bodies, shapes
from warpsar.diagnosis.proposals.bodies import _materials as starts
from warpsar.diagnosis.proposals.bodies import sound
from warpsar.diagnosis.proposals.fit import Standing, TrialGround
from warpsar.diagnosis.proposals.left_out import explained
from warpsar.diagnosis.proposals.places import BodyPlace, Looked, Ratios, free_ground
from warpsar.diagnosis.proposals.shapes import TrialBody
from warpsar.diagnosis.turn.geometry_search import _around, _or_grown
from warpsar.differentiable.geometry import exact_images
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import expected_deviance
from warpsar.world.objects.assembly import Assembly
from warpsar.world.objects.table import Object
from warpsar.world.pixels import Pixels
from warpsar.world.tables import Material, View

CPU = devices.resolve_device("cpu")
SIDES = ((10, 40), (100, 45), (190, 50), (280, 40))
LOOKS = 16.0


def plain(shape: int = 48, sides: Any = SIDES) -> Scene:
    """Level ground with a hut."""
    views = [view(azimuth, incidence, name=f"v{k}", looks=LOOKS) for k, (azimuth, incidence) in enumerate(sides)]
    mesh = mesh_of(ground=ground(36), hut=box((-7.0, 2.0, 0.0), (-4.0, 6.0, 3.0)))
    return scene_of(mesh, views, shape=(shape, shape), spacing_m=(0.5, 0.5), materials={"ground": SOIL, "hut": BRICK})


def measured(scene: Scene, objects: tuple[Object, ...], seed: int = 1, point: Any = None) -> Scene:
    """The scene, and images of it with the objects, times speckle; `point`: a place whose pixel has more power."""
    truth = with_objects(scene, objects, {str(one.material): BODY for one in objects})
    images, random = exact_images(truth, CPU), np.random.default_rng(seed)

    def seen(one: View) -> View:
        image = images[one.name]["HH"].astype(float)
        if point is not None:
            row, col = pixel_of(scene, one, np.array([point]))
            image[int(row[0]), int(col[0])] += 6.0
        image = image * speckle(random, scene.grid.shape, LOOKS)
        return one.model_copy(update={"images": {"HH": image.astype(np.float32)}})

    return replace(scene, views=[seen(one) for one in scene.views])


def ratios_of(scene: Scene) -> list[Ratios]:
    """Measured over modelled power above a common floor, as it stands."""
    ground_of = TrialGround.of(scene, CPU, None, "gamma")
    problem = ground_of.problem(ground_of.scene)
    standing = Standing(ground_of.scene, 0.0, problem, problem.x0)
    found = []
    for seen, mu in zip(standing.observations, standing.modelled(), strict=True):
        image = np.zeros(seen.interior.shape)
        image[seen.interior] = seen.values / mu
        found.append(Ratios(seen.view, image, seen.interior, seen.looks))
    return found


# ---- where ----


def test_free_ground_has_the_height_of_the_ground_and_no_body() -> None:
    """A slope of one in ten, with a hut on it, and nothing beside it."""
    mesh = mesh_of(
        slope=plate((-5.0, -5.0, 0.0), (10.0, 0.0, 1.0), (0.0, 10.0, 0.0), 3), hut=box((1.0, 1.0, 0.0), (3.0, 3.0, 4.0))
    )
    east, north = np.arange(-6.0, 7.0, 0.5) + 0.1, np.arange(-4.0, 5.0, 0.5) + 0.1
    found = free_ground(mesh, east, north)
    x, y = np.meshgrid(east, north)
    inside = (np.abs(x) < 5.0) & ~((x > 1.0) & (x < 3.0) & (y > 1.0) & (y < 3.0))
    np.testing.assert_allclose(found[inside], (x[inside] + 5.0) / 10.0, atol=1e-12)
    assert np.isnan(found[~inside]).all()


def test_views_agree_on_the_place_of_a_box() -> None:
    """Within a metre, of about its width and height, and it explains most of what is unlike speckle there."""
    scene = measured(plain(), (BOX,))
    first, *rest = Looked.at(scene, ratios_of(scene)).best(3)
    assert np.hypot(first.position_m[0] - 2.0, first.position_m[1] + 1.5) < 1.0
    assert first.position_m[2] == 0.0
    assert 2.0 <= first.width_m <= 4.0
    assert first.height_m == 2.0
    assert first.share > 0.6
    assert all(one.score < 0.2 * first.score for one in rest)


def test_what_one_view_alone_shows_makes_no_place() -> None:
    """The same layover in three views makes one."""
    scene = measured(plain(), ())
    found = ratios_of(scene)
    rows = slice(20, 26)
    found[0].ratio[rows, rows] *= 20.0
    assert all(one.score < 30.0 for one in Looked.at(scene, found).best(3))
    for one in found[1:]:
        row, col = (int(at[0]) for at in pixel_of(scene, one.view, np.array([[0.0, 0.0, 0.0]])))
        one.ratio[row - 4 : row, col - 2 : col + 3] *= 20.0
    assert Looked.at(scene, found).best(1)[0].score > 1000.0


def test_a_place_that_is_half_explained_is_tried() -> None:
    """A place knows one width and one height; a box that is twice as long as wide is half explained by it."""

    def at(share: float, score: float = 1000.0) -> BodyPlace:
        return BodyPlace((0.0, 0.0, 0.0), 4.8, 2.4, score, share)

    tried = _worth_a_fit([at(0.51), at(0.2), at(0.9, score=400.0), at(0.9, score=20.0)], 26.0)
    assert [one.share for one in tried] == [0.51]  # one of less than half its score waits


# ---- what ----


@pytest.mark.parametrize("primitive", ["box", "cylinder", "car"])
def test_a_tidy_table_is_the_same_body(primitive: Any) -> None:
    """Length and width exchanged, and a quarter turn: the same corners, whatever their order. A car keeps its front."""
    table = Object(primitive=primitive, size_m=(1.5, 4.0, 1.4), position_m=(1.0, 2.0, 0.0), heading_deg=-75.0)
    tidied = shapes.tidy(table)
    one, other = (Assembly.of(None, (each,), {}).mesh((each,)).vertices for each in (table, tidied))
    # a cylinder's 48 corners are at the same angles after a quarter turn
    distance = np.linalg.norm(one[:, None] - other[None], axis=2)
    assert distance.min(axis=0).max() < 1e-9
    assert distance.min(axis=1).max() < 1e-9
    assert 0.0 <= tidied.heading_deg < 360.0
    assert tidied.size_m == ((1.5, 4.0, 1.4) if primitive == "car" else (4.0, 1.5, 1.4))


def test_a_round_cylinder_has_the_area_of_the_ellipse() -> None:
    table = Object(primitive="cylinder", size_m=(5.0, 3.2, 4.0), heading_deg=20.0, learn=shapes.BODY)
    found = shapes.round_one(shapes.TrialBody(table, 6))
    assert found is not None
    assert found.table.size_m == pytest.approx((4.0, 4.0, 4.0))
    assert found.numbers == 4
    assert "heading" not in found.table.learn
    assert shapes.round_one(shapes.TrialBody(BOX, 6)) is None


def test_vehicles_are_tried_where_a_box_has_their_size() -> None:
    def tried(size: tuple[float, float, float]) -> list[str]:
        return [str(s.table.primitive) for s in shapes.others(BOX.model_copy(update={"size_m": size}))]

    assert tried((4.5, 1.8, 1.5)) == ["cylinder", "car", "car"]
    assert tried((8.0, 2.5, 3.0)) == ["cylinder", "truck", "truck"]
    assert tried((20.0, 8.0, 6.0)) == ["cylinder"]


def test_a_flat_patch_is_no_body() -> None:
    scene = plain()

    def of(size: tuple[float, float, float]) -> Scene:
        return with_objects(scene, (BOX.model_copy(update={"size_m": size}),), {"it": BODY})

    assert sound(of((4.0, 2.0, 2.0)))
    assert not sound(of((4.0, 2.0, 0.2)))
    assert not sound(of((0.1, 2.0, 2.0)))
    assert not sound(of((14.0, 2.0, 2.0)))


@pytest.mark.parametrize("learn", [(), ("eps_r",)])
def test_a_body_has_one_number_where_the_ground_has_a_field(learn: tuple[str, ...]) -> None:
    """A box gets the median of the ground's map; a fit of it ends with numbers again."""
    eps = np.linspace(4.0, 12.0, 12, dtype=np.float32).reshape(3, 4)
    soil = Material(**SOIL, layout="texture").model_copy(update={"eps_r": Pixels(eps), "learn": learn})
    bare = measured(plain(24), (), seed=3)
    field = replace(bare.mesh, uv=np.zeros((len(bare.mesh.vertices), 2)))
    trial = TrialGround.of(replace(bare, mesh=field, materials={**bare.materials, "ground": soil}), CPU, None, "gamma")
    start = starts(trial)[0]
    assert (start.layout, start.eps_r, start.rms_height_m) == ("uniform", 8.0, SOIL["rms_height_m"])
    scene = trial.holding(BOX, start.model_copy(update={"learn": ("eps_r",)}))
    assert isinstance(trial.settled(scene, most=1).scene.materials["it"].eps_r, float)


@pytest.mark.parametrize(
    ("model", "free"),
    [
        ({"model": "facet"}, ("level",)),
        ({"model": "oh", "eps_r": 8.0, "rms_height_m": 0.005}, ("eps_r", "rms_height_m")),
        ({**SOIL, "model": "two_scale"}, ("eps_r", "rms_height_m", "correlation_length_m")),
    ],
    ids=["facet", "oh", "two_scale"],
)
def test_a_body_has_the_numbers_of_its_model(model: dict[str, Any], free: tuple[str, ...], tmp_path: Path) -> None:
    """A box of the ground's material: what is free is what its model has, and each number counts."""
    if model["model"] == "facet":
        table = tmp_path / "sigma0.csv"
        table.write_text("incidence_deg,HH\n20,-8\n40,-12\n60,-16\n")
        model = {**model, "sigma0": table}
    bare = measured(plain(24), (), seed=3)
    scene = replace(bare, materials={**bare.materials, "ground": Material(**model)})
    trial = TrialGround.of(scene, CPU, None, "gamma")
    found = bodies._fitted(trial, TrialBody(BOX, 6), starts(trial)[0], 1)
    assert found.standing.scene.materials["it"].learn == free
    assert found.numbers == 6 + len(free)


class _Model:
    """Modelled power of one image, in the place of `Standing`."""

    def __init__(self, seen: Any, mu: np.ndarray) -> None:
        self.observations, self._mu = [seen], mu

    def modelled(self) -> list[np.ndarray]:
        return [self._mu]


def test_explained_is_one_for_the_truth_and_none_for_no_change() -> None:
    """Pixels that the object does not touch do not count, however wrong they are."""
    random = np.random.default_rng(2)
    truth = np.concatenate([np.full(4000, 0.3), np.full(4000, 0.1)])
    values = truth * random.gamma(LOOKS, 1.0 / LOOKS, truth.size)

    class Seen:
        looks = LOOKS
        law = Law(LOOKS)

    Seen.values = values  # type: ignore[attr-defined]
    wrong = truth.copy()
    wrong[:2000] *= 2.0
    wrong[4000:] *= 5.0
    found = wrong.copy()
    found[:2000] = truth[:2000]
    # the mean loss of speckle has a standard error of sqrt(2000) times that of a pixel, about its mean
    noise = 4.0 * np.sqrt(2000.0) * 0.5 * expected_deviance(LOOKS) / (2000.0 * LOOKS * (np.log(2.0) - 0.5))
    assert explained(_Model(Seen, wrong), _Model(Seen, found)) == pytest.approx(1.0, abs=noise)  # type: ignore[arg-type]
    half = wrong.copy()
    half[:2000] *= 0.8
    assert 0.0 < explained(_Model(Seen, wrong), _Model(Seen, half)) < 0.8  # type: ignore[arg-type]
    assert explained(_Model(Seen, wrong), _Model(Seen, wrong)) == 0.0  # type: ignore[arg-type]


# ---- found ----


@pytest.fixture(scope="module")
def found_box() -> tuple[Scene, list[GeometryCandidate]]:
    scene = measured(plain(), (BOX,))
    return scene, proposed(scene, CPU)


@pytest.mark.full
def test_a_box_is_found(found_box: tuple[Scene, list[GeometryCandidate]]) -> None:
    """Place, heading and size within four standard deviations, and 20 %; a footprint's diagonal is the same thing."""
    (one,) = found_box[1]
    assert (one.kind, one.object) == ("missing_object", "found_1")
    assert one.gain > 1000.0
    assert one.size in (6, 9)
    values = one.values
    assert values["primitive"] == "box"
    for value, sd, truth in (
        *zip(values["position_m"], values["position_sd_m"], (2.0, -1.5, 0.0), strict=True),
        *zip(values["size_m"], values["size_sd_m"], (4.0, 2.5, 2.5), strict=True),
        (values["heading_deg"], values["heading_sd_deg"], 35.0),
    ):
        assert abs(value - truth) < 4.0 * sd
    assert values["size_m"] == pytest.approx((4.0, 2.5, 2.5), rel=0.05)
    assert any("views left out" in sentence for sentence in one.words)


@pytest.mark.full
def test_its_scene_simulates_and_learns(found_box: tuple[Scene, list[GeometryCandidate]], tmp_path: Path) -> None:
    """The table is written, read again, and gives the image of the truth to a few per cent of its power."""
    scene, (one,) = found_box
    assert one.scene.objects[-1].learn == ("position", "heading", "size")
    assert set(one.scene.effects) == set(scene.effects)
    one.scene.save(tmp_path / "scene.toml")
    again = Scene.load(tmp_path / "scene.toml")
    assert again.objects[-1].size_m == pytest.approx(one.scene.objects[-1].size_m)
    truth = exact_images(with_objects(plain(), (BOX,), {"it": BODY}), CPU)
    for name, image in exact_images(again, CPU).items():
        error = np.linalg.norm(image["HH"] - truth[name]["HH"]) / np.linalg.norm(truth[name]["HH"])
        assert error < 0.1


@pytest.mark.full
@pytest.mark.parametrize("ground_has", ["a map", "a loss"])
def test_a_box_is_named_on_other_grounds(ground_has: str, tmp_path: Path) -> None:
    """A map has no place on a body, and a loss is no number that is learned: the box has numbers of its own."""
    bare = plain(40)
    soil = Material(**{**SOIL, "eps_r": (20.0, -6.0)})
    if ground_has == "a map":
        eps = np.linspace(4.0, 12.0, 12, dtype=np.float32).reshape(3, 4)
        soil = Material(**SOIL, layout="texture").model_copy(update={"eps_r": Pixels(eps), "learn": ("rms_height_m",)})
        bare = replace(bare, mesh=replace(bare.mesh, uv=(bare.mesh.vertices[:, :2] / 36.0 + 0.5).astype(np.float32)))
    bare = replace(bare, materials={**bare.materials, "ground": soil})
    measured(bare, (BOX,), seed=3).save(tmp_path / "scene.toml")
    content = run(tmp_path / "scene.toml", tmp_path / "out", device="cpu")
    assert (content["verdict"], content["unexplained"]) == (["missing_object"], False)
    (own,) = content["objects"].values()
    np.testing.assert_allclose(own["size_m"], BOX.size_m, rtol=0.2)  # as `test_a_box_is_found`


@pytest.mark.full
def test_nothing_is_proposed_where_nothing_is_missing(found_box: tuple[Scene, list[GeometryCandidate]]) -> None:
    """Neither in speckle alone, nor once the box stands in the scene."""
    assert proposed(measured(plain(), ()), CPU) == []
    assert proposed(found_box[1][0].scene, CPU) == []


def test_one_view_places_nothing() -> None:
    assert proposed(measured(plain(sides=SIDES[:1]), (BOX,)), CPU) == []


def test_trials_beside_paths_are_of_single_bounces() -> None:
    """A scene without paths is tried as it is. With them, a trial leaves out the pixels of the hut's corners, to which
    paths bring most, and has the rest to 10 % of a pixel; a fit leaves the paths in the scene."""
    bare = measured(plain(24, SIDES[:2]), ())
    ground_of = TrialGround.of(bare, CPU, None, "gamma")
    assert ground_of.trials is ground_of
    scene = with_effect(bare, "multibounce", {"strength": 1.0})
    images = exact_images(scene, CPU)
    ground_of = TrialGround.of(scene, CPU, None, "gamma")
    standing = ground_of.trials.as_it_stands(ground_of.trials.scene)
    left = ground_of.as_it_stands(ground_of.scene).observations
    for seen, all_of_it, mu in zip(standing.observations, left, standing.modelled(), strict=True):
        image = images[seen.view.name]["HH"][seen.interior]
        np.testing.assert_array_less(image, mu / 0.9)
        without = all_of_it.interior & ~seen.interior
        assert 0 < without.sum() < 0.1 * seen.interior.sum()
        assert images[seen.view.name]["HH"][without].max() > 10.0 * np.median(image)
    moved = ground_of.trials.settled(scene, most=1)
    assert moved.scene.effects == scene.effects
    assert "multibounce" not in moved.problem.scene.effects


@pytest.mark.full
def test_a_box_is_found_beside_its_bounces() -> None:
    """Images hold the box and its bounces, which bring five times the power of its own light. Single bounces find it,
    and with its bounces it explains nearly all. They are bright lines at its walls' feet, so its sides end short."""
    scene = with_effect(plain(40), "multibounce", {"strength": 1.0})
    (one,) = proposed(measured(scene, (BOX,)), CPU)
    assert one.values["primitive"] == "box"
    assert one.values["position_m"][:2] == pytest.approx((2.0, -1.5), abs=0.1)
    assert one.values["size_m"] == pytest.approx((4.0, 2.5, 2.5), rel=0.1)
    assert one.values["heading_deg"] == pytest.approx(35.0, abs=5.0)
    assert one.scene.effects["multibounce"]["strength"] == pytest.approx(1.0, abs=0.1)
    assert one.scene.objects[-1].learn == ("position", "heading", "size")
    assert one.gain > 10_000.0


@pytest.mark.slow
def test_a_point_reflector_is_found() -> None:
    """Power in one pixel of each view is all that the images hold of it: the place falls on that pixel in each.

    In azimuth to a quarter of a pixel of its middle. In range to half a pixel, the radius of the sphere, by which its
    near side lies before its middle. The point itself lies anywhere on the pixels: as far as half of one from a middle.
    """
    point = (2.3, -1.7, 0.6)
    scene = measured(plain(), (), point=point)
    (one,) = proposed(scene, CPU)
    assert one.values["primitive"] == "sphere"
    assert one.size == 4
    middle = np.add(one.values["position_m"], (0.0, 0.0, 0.25))
    for each in scene.views:
        bright, found = (np.ravel(pixel_of(scene, each, np.array([place]))) for place in (point, middle))
        assert np.all(np.abs(found - np.floor(bright) - 0.5) < (0.5, 0.25))


@pytest.mark.slow
@pytest.mark.parametrize("primitive", ["cylinder", "car"])
def test_other_bodies_are_told_from_a_box(primitive: Any) -> None:
    size = (3.0, 3.0, 2.5) if primitive == "cylinder" else (4.6, 1.8, 1.5)
    heading = 0.0 if primitive == "cylinder" else 35.0
    table = Object(
        name="it", primitive=primitive, size_m=size, position_m=(2.0, -1.5, 0.0), heading_deg=heading, material="it"
    )
    (one,) = proposed(measured(plain(), (table,)), CPU)
    assert one.values["primitive"] == primitive
    assert one.values["size_m"] == pytest.approx(size, rel=0.1)
    assert one.values["position_m"] == pytest.approx((2.0, -1.5, 0.0), abs=0.1)


@pytest.mark.slow
def test_two_boxes_one_after_the_other() -> None:
    other = BOX.model_copy(update={"name": "too", "position_m": (-2.0, -6.5, 0.0), "size_m": (3.0, 2.0, 2.0)})
    other = other.model_copy(update={"material": "too"})
    scene, found = measured(plain(64), (BOX, other)), []
    for _ in range(2):
        (one,) = proposed(scene, CPU)
        scene = one.scene
        found.append(one.values["position_m"])
    expected = [(2.0, -1.5, 0.0), (-2.0, -6.5, 0.0)]
    for truth in expected:
        assert min(float(np.linalg.norm(np.subtract(each, truth))) for each in found) < 0.1
    assert proposed(scene, CPU) == []


@pytest.mark.slow
def test_the_independent_case(independent_cases: Path) -> None:
    """missing_object: place within 1 m, footprint and height within 20 %, test deviance within 10 % of the floor."""
    folder = independent_cases / "missing_object"
    (at, size, turn) = json.loads((folder / "truth.json").read_text())["effects"]["missing_object"]
    (one,) = proposed(Scene.load(folder / "scene.toml"), CPU)
    values = one.values
    assert values["primitive"] == "box"
    assert np.linalg.norm(np.subtract(values["position_m"], at)) < 1.0
    assert values["size_m"] == pytest.approx(size, rel=0.2)
    assert (90.0 - values["heading_deg"] - turn + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=2.0)
    assert deviance_of_test_views(one.scene) == pytest.approx(1.0, abs=0.1)


def deviance_of_test_views(scene: Scene) -> float:
    """Mean deviance of the test views over that of speckle, where the model lights a pixel."""
    images = exact_images(scene, CPU)
    found = []
    for one in scene.views:
        if one.role == "test":
            measured_image, image = scene.measured(one, "HH").astype(float), images[one.name]["HH"].astype(float)
            use = (image > 0.0) & (measured_image > 0.0)
            ratio = measured_image[use] / image[use]
            found.append(2.0 * LOOKS * (ratio - 1.0 - np.log(ratio)) / expected_deviance(LOOKS))
    return float(np.mean(np.concatenate(found)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["none", "noise_floor", "multibounce", "point_spread", "registration"])
def test_other_effects_are_no_objects(name: str, independent_cases: Path) -> None:
    assert proposed(Scene.load(independent_cases / name / "scene.toml"), CPU) == []


def test_a_place_says_what_it_is() -> None:
    one = BodyPlace((0.0, 0.0, 0.0), 4.0, 2.0, 50.0, 0.7)
    boxes = list(shapes.boxes(one, "it"))
    assert [b.table.heading_deg for b in boxes] == [0.0, 45.0, 90.0, 135.0]
    for b in boxes:
        assert b.table.size_m is not None
        assert b.table.size_m[0] * b.table.size_m[1] == pytest.approx(16.0)


@pytest.mark.parametrize(
    ("at", "body"),
    [((-5.5, 4.0, 0.0), "hut"), ((-2.5, 4.0, 0.0), None), ((-5.5, 7.0, 0.0), None), ((2.0, -1.5, 0.0), None)],
)
def test_a_body_that_stands_within_one_of_the_scene_is_told(at: tuple[float, float, float], body: str | None) -> None:
    """One beside it is an annex, and the ground is no body."""
    assert _around(plain(), BOX.model_copy(update={"position_m": at})) == body


def test_of_bodies_around_a_place_the_smallest_is_meant() -> None:
    """All huts are one group, too; a body between them stands within none."""
    huts = [box((-7.0, 2.0, 0.0), (-4.0, 6.0, 3.0)), box((5.0, -6.0, 0.0), (8.0, -2.0, 3.0))]
    mesh = mesh_of(ground=ground(36), hut=join(huts))
    west, east = np.split(np.flatnonzero(mesh.face_material == 1).astype(np.int32), 2)
    scene = replace(plain(), mesh=replace(mesh, groups={"west": west, "east": east}))
    places = [(-5.5, 4.0, 0.0), (6.0, -4.0, 0.0), (1.0, 0.0, 0.0)]
    found = [_around(scene, BOX.model_copy(update={"position_m": at})) for at in places]
    assert found == ["west", "east", None]


@pytest.mark.full
def test_a_hut_that_is_higher_is_no_body_within_the_hut() -> None:
    """A box as wide as the hut and 1.5 m higher explains all: it is offered as the hut's height, 3 m, times 1.5."""
    scene = plain()
    higher = mesh_of(ground=ground(36), hut=box((-7.0, 2.0, 0.0), (-4.0, 6.0, 4.5)))
    given = replace(measured(replace(scene, mesh=higher), ()), mesh=scene.mesh, assembly=scene.assembly)
    setup, here = fitted_of(given)
    inside = with_objects(given, (BOX.model_copy(update={"position_m": (-5.5, 4.0, 0.0)}),), {"it": BODY})
    box_found = GeometryCandidate("missing_object", "it", inside, 50.0, 6)
    found = _or_grown(given, setup, here, box_found)
    assert found.name == "object_size hut"
    assert found.values["scale"][2] == pytest.approx(1.5, abs=0.05)
    far_better = replace(box_found, gain=10.0 * found.gain)
    assert _or_grown(given, setup, here, far_better) is far_better
