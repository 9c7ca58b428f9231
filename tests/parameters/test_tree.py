"""One tree of parameters: every number has one name, its value can be read, set and read again."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

import warpsar
from warpsar.effects.registry import validate
from warpsar.errors import InputError
from warpsar.parameters.at import at
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.scattering_term import learned
from warpsar.world.transform import Transform

pytestmark = pytest.mark.unit

EFFECTS = {
    "noise_floor": {"level": 0.01, "tolerance": {"level": 0.002}},
    "aim_point": {"range_m": {"a": 0.1, "b": 0.2}},
    "point_spread": {"range_fwhm_m": 1.1, "fixed": True},
    "glints": {"strength": 0.5, "points": [[0.0, 0.0, 1.0, 30.0, 12.0, 3.0], [1.0, 0.5, 1.5, 80.0, 20.0, 6.0]]},
}
POINTS = [f"effects.glints.points[{key}]" for key in ("east_m", "north_m", "up_m", "azimuth_deg", "half_width_deg")]
POINTS.append("effects.glints.points[level_dbsm]")


@pytest.fixture(scope="module")
def scene() -> Scene:
    mesh = mesh_of(lawn=ground(8.0, 2), block=box((-1, -1, 0), (1, 1, 1)))
    mesh = replace(mesh, vertex_scalars={"wet": np.linspace(4.0, 9.0, len(mesh.vertices))})
    lawn = {**SOIL, "eps_r": "wet", "layout": "vertex", "learn": ("eps_r",)}
    block = {**BRICK, "eps_r": (5.0, -0.2), "tolerance": {"eps_r": "10 %"}}
    views = [view(30, 40, name="a", looks=4.0), view(100, 50, name="b", texture=8.0)]
    made = scene_of(mesh, views, materials={"lawn": lawn, "block": block})
    made = with_objects(
        made,
        [
            Object(
                primitive="car",
                size_m=(4.6, 1.8, 1.5),
                position_m=(0, 3, 0),
                material="block",
                learn=("position", "size"),
                tolerance={"position_m": 0.3},
            )
        ],
    )
    effects = {name: validate(name, table, f"effects.{name}", ["a", "b"]) for name, table in EFFECTS.items()}
    return replace(made, effects=effects)


def test_names_of_a_whole_scene(scene: Scene) -> None:
    assert set(scene.parameters) == {
        *(f"materials.lawn.{key}" for key in ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction")),
        *(f"materials.block.{key}" for key in ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction")),
        "effects.noise_floor.level",
        *(f"effects.aim_point.range_m[{name}]" for name in "ab"),
        "effects.point_spread.range_fwhm_m",
        *("effects.glints.strength", *POINTS),
        *(f"objects.car.{key}" for key in ("position_m", "heading_deg", "pitch_deg", "roll_deg")),
        *(f"objects.car.{key}" for key in ("scale", "size_m", "cabin", "side_curvature")),
        *("views.azimuth_deg", "views.incidence_deg"),
        *(f"views.{name}.{key}" for name in "ab" for key in ("azimuth_deg", "incidence_deg")),
        *("views.a.looks", "views.b.texture"),
        *("image.range_spacing_m", "image.azimuth_spacing_m"),
        "mesh.vertices",
    }
    assert all(one.name == name for name, one in scene.parameters.items())


def test_what_each_of_them_is(scene: Scene) -> None:
    tree = scene.parameters
    assert tree["materials.block.eps_r"].value == 5.0  # of eps' - j eps'' it is eps'
    assert tree["materials.block.eps_r"].known == ((5.0, 0.5),)
    assert tree["materials.lawn.eps_r"].layout == "vertex"
    assert tree["materials.lawn.eps_r"].shape == (len(scene.mesh.vertices),)
    assert tree["effects.aim_point.range_m[b]"].value == 0.2
    assert tree["effects.aim_point.range_m[b]"].layout == "per view"
    assert tree["effects.noise_floor.level"].known == ((0.01, 0.002),)
    assert tree["objects.car.position_m"].known == ((0.0, 0.3), (3.0, 0.3), (0.0, 0.3))
    assert tree["objects.car.cabin"].value == 0.6  # as a car has it that does not state it
    units = {name: one.unit for name, one in tree.items()}
    assert units["objects.car.heading_deg"] == units["views.a.azimuth_deg"] == "deg"
    assert units["materials.lawn.rms_height_m"] == units["image.range_spacing_m"] == units["mesh.vertices"] == "m"
    assert units["materials.lawn.eps_r"] == "1"


def test_what_a_fit_may_change(scene: Scene) -> None:
    """What `learn` names, and what the tables of effects that are not `fixed` state."""
    assert {name for name, one in scene.parameters.items() if one.freed} == {
        "materials.lawn.eps_r",
        *(f"materials.block.{key}" for key in ("eps_r", "rms_height_m", "correlation_length_m")),
        "effects.noise_floor.level",
        *(f"effects.aim_point.range_m[{name}]" for name in "ab"),
        "effects.glints.strength",
        *("objects.car.position_m", "objects.car.size_m"),
    }


def test_what_has_a_derivative(scene: Scene) -> None:
    """The renderer's parameters are those with a derivative of power that something frees or an effect states."""
    render = warpsar.renderer(replace(scene, materials=uniform(scene), objects=(), effects={}), device="cpu")
    free = {name for name, one in scene.parameters.items() if one.freed and one.root == "materials"}
    assert set(render.parameters) == free | {"materials.lawn.rms_height_m", "materials.lawn.correlation_length_m"}
    none = {name for name, one in scene.parameters.items() if not one.derivatives}
    assert {name.partition(".")[0] for name in none if name not in POINTS} == {"views", "image"}
    assert none >= set(POINTS)  # their places come from what views leave


def test_how_far_a_fit_goes(scene: Scene) -> None:
    """So far as `reach` says of the declared value, and within `fit_bounds`."""
    tree = scene.parameters
    for name, low, high in (
        ("objects.car.position_m", (-50.0, -47.0, -50.0), (50.0, 53.0, 50.0)),
        ("objects.car.size_m", (1.15, 0.45, 0.375), (18.4, 7.2, 6.0)),
        ("objects.car.cabin", 0.1, 0.85),
        ("objects.car.heading_deg", -180.0, 180.0),
        ("views.a.incidence_deg", 20.0, 60.0),
        ("materials.block.eps_r", 1.01, 300.0),
    ):
        np.testing.assert_allclose(tree[name].fit_ends, (low, high), rtol=1e-12, err_msg=name)
    least, most = tree["image.range_spacing_m"].fit_ends
    assert most / least == pytest.approx(1.25**2)
    steep = scene.with_values({"views.a.incidence_deg": 80.0}).parameters["views.a.incidence_deg"]
    assert steep.fit_ends == (60.0, 89.0)


def test_tables_and_learned_terms_have_what_is_expected_of_them(scene: Scene, tmp_path: Path) -> None:
    """Of weights w, that units @ w scatters as far as a term that has learned nothing, less what is left of it where it
    has (Rasmussen and Williams 2006, equation 2.26). Of a table's rows, the square exponential and each row's own."""
    places = np.column_stack([[0.5, 0.6, 0.9], *np.tile([[0.1], [1.0], [1.5]], 3)])
    term = learned("ka_spm", places, {"HH": np.array([1.0, -0.5, 0.2])})
    term.save(tmp_path / "term.json")
    (tmp_path / "table.csv").write_text("incidence_deg,HH\n10,-5\n30,-8\n35,-9\n")
    lawn = {"model": "facet", "sigma0": tmp_path / "table.csv", "learn": ("sigma0",)}
    block = {**BRICK, "learned_term": tmp_path / "term.json"}
    mesh = mesh_of(lawn=ground(8.0, 2), block=box((-1, -1, 0), (1, 1, 1)))
    tree = scene_of(mesh, [view(30, 40)], materials={"lawn": lawn, "block": block}).parameters
    weights, rows = tree["materials.block.learned_term[HH]"], tree["materials.lawn.sigma0[HH]"]
    np.testing.assert_array_equal(weights.value, term.weights["HH"])
    assert (weights.freed, rows.freed, rows.unit, weights.layout) == (False, True, "dB", "table")
    assert weights.prior_root is not None
    assert rows.prior_root is not None
    root = term.units(places) @ weights.prior_root() * 10.0 / np.log(10.0)  # [dB]
    left = term.sd_db("HH", places)
    np.testing.assert_allclose(np.diag(root @ root.T), 9.0 - left**2 + 0.25**2, rtol=1e-9)
    root = rows.prior_root()
    angle = np.array([10.0, 30.0, 35.0])
    expected = 9.0 * np.exp(-0.5 * ((angle[:, None] - angle) / 10.0) ** 2) + 0.25**2 * np.eye(3)
    np.testing.assert_allclose(root @ root.T, expected, rtol=1e-12)
    with pytest.raises(InputError, match=r"learned_term.HH.: stands in the file .*term.json; only a fit changes it"):
        at(scene_of(mesh, [view(30, 40)], materials={"lawn": lawn, "block": block}), {weights: weights.value})


def uniform(scene: Scene) -> dict[str, Any]:
    plain = scene.materials["lawn"].model_copy(
        update={"eps_r": 4.0, "layout": "uniform", "learn": ("eps_r", "rms_height_m", "correlation_length_m")}
    )
    return {**scene.materials, "lawn": plain}


def test_a_value_that_is_set_is_read_again(scene: Scene) -> None:
    """Each alone: then no other parameter has another value, but for vertices, which follow the bodies."""
    for name, one in scene.parameters.items():
        if name in ("views.azimuth_deg", "views.incidence_deg"):
            continue  # a turn of all views from where they stand, which is 0 again afterwards
        new = one.value * 1.02 + (0.001 if one.unit != "1" else 0.0)
        moved = at(scene, {one: new})
        for other, theirs in moved.parameters.items():
            follows = other == "mesh.vertices" and one.root == "objects"
            if other == name:  # of a field the material's own vertices: the rest is never looked at
                own = (np.atleast_1d(each)[one.used] for each in (theirs.value, new))
                np.testing.assert_allclose(*own, rtol=1e-12, err_msg=name)
            elif not follows:
                np.testing.assert_array_equal(theirs.value, scene.parameters[other].value, err_msg=f"{name}: {other}")


def test_all_at_once_are_each_by_itself(scene: Scene) -> None:
    some = [one for name, one in scene.parameters.items() if name != "mesh.vertices"]
    moved = at(scene, {one: one.value * 1.01 for one in some})
    for one in some:
        own = (np.atleast_1d(each)[one.used] for each in (moved.parameters[one.name].value, one.value * 1.01))
        np.testing.assert_allclose(*own, rtol=1e-12, err_msg=one.name)
    assert scene.materials["block"].eps_r == (5.0, -0.2)  # and the scene itself stays
    assert moved.materials["block"].eps_r == (pytest.approx(5.05), -0.2)  # its loss is no parameter


def test_a_scalar_that_two_materials_name_changes_for_one(scene: Scene) -> None:
    """The vertices of the other material keep it."""
    both = {**scene.materials, "block": scene.materials["lawn"]}
    everywhere = replace(scene.mesh, vertex_scalars={"wet": np.linspace(4.0, 9.0, len(scene.mesh.vertices))})
    shared = replace(scene, mesh=everywhere, materials=both, objects=(), effects={})
    one, other = (shared.parameters[f"materials.{name}.eps_r"] for name in ("lawn", "block"))
    moved = at(shared, {one: one.value + 1.0}).parameters
    np.testing.assert_array_equal(moved[one.name].value[one.used], one.value[one.used] + 1.0)
    np.testing.assert_array_equal(moved[other.name].value[other.used], other.value[other.used])


def test_a_value_that_may_not_be_is_refused(scene: Scene) -> None:
    for name, value, said in (
        ("views.a.incidence_deg", 95.0, "views.a.incidence_deg: found 95; must be from 0 to 90"),
        ("materials.block.eps_r", 0.5, "materials.block.eps_r: found 0.5; must be from 1 to"),
        ("objects.car.position_m", 1.0, r"objects.car.position_m: found shape \(\); must be \(3,\)"),
        ("objects.car.size_m", (4.6, 0.0, 1.5), "a size of 0 must stay 0"),
    ):
        with pytest.raises(InputError, match=said):
            scene.with_values({name: value})


def test_values_go_by_name(scene: Scene) -> None:
    turned = scene.with_values({"views.a.azimuth_deg": 31.2, "objects.car.heading_deg": 20.0})
    assert [one.azimuth_deg for one in turned.views] == [31.2, 100.0]
    assert turned.objects[0].heading_deg == 20.0
    with pytest.raises(InputError, match=r"views.c.azimuth_deg: found no such parameter; .*views.a.azimuth_deg"):
        scene.with_values({"views.c.azimuth_deg": 1.0})


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("block.eps_r", "materials.block.eps_r"),
        ("noise_floor.level", "effects.noise_floor.level"),
        ("aim_point.range_m[a]", "effects.aim_point.range_m[a]"),
        ("car.heading_deg", "objects.car.heading_deg"),
        ("vertices", "mesh.vertices"),
    ],
)
def test_an_older_name_is_understood_with_a_warning(old: str, new: str, scene: Scene) -> None:
    with pytest.warns(FutureWarning, match=rf"{old.split('[')[0]}.*: is called {new.split('[')[0]}") as said:
        assert scene.parameters[old] is scene.parameters[new]
    assert said[0].filename == __file__
    with pytest.raises(KeyError):
        scene.parameters["nobody.eps_r"]


def test_older_names_work_in_a_renderer(scene: Scene) -> None:
    plain = replace(scene, materials=uniform(scene), objects=(), effects={})
    render = warpsar.renderer(plain, device="cpu")
    weights = render()
    expected = render.vjp({"materials.block.eps_r": 6.0}, weights)
    with pytest.warns(FutureWarning):
        gradient = render.vjp({"block.eps_r": 6.0}, weights)["block.eps_r"]
    assert gradient == expected["materials.block.eps_r"]


@pytest.mark.parametrize(
    "transform", [Transform("linear", 3.0), Transform("log", 0.5), Transform("contrast"), Transform("logit")]
)
def test_a_coordinate_and_back(transform: Transform) -> None:
    """Slopes against central differences: their error is of the order of the step squared, 1e-10."""
    value = np.array([0.2, 0.5, 0.9]) + (1.0 if transform.kind == "contrast" else 0.0)
    x, step = transform.to_coordinate(value), 1e-5
    np.testing.assert_allclose(transform.from_coordinate(x), value, rtol=1e-12)
    slope = (transform.from_coordinate(x + step) - transform.from_coordinate(x - step)) / (2.0 * step)
    np.testing.assert_allclose(transform.slope(x), slope, rtol=1e-8)
    np.testing.assert_allclose(transform.slope_at(value), slope, rtol=1e-8)
