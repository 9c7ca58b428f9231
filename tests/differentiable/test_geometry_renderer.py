"""The renderer's gradients to poses, sizes and vertices: silhouettes, shadows, turned facets; against differences."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

import warpsar
from warpsar.differentiable.renderer import Renderer
from warpsar.effects.registry import validate
from warpsar.errors import InputError
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

EXAMPLE = Path(__file__).resolve().parents[2] / "data" / "example" / "scene.toml"
DARK = {**SOIL, "rms_height_m": 1e-6}  # returns nothing: only its shadow is seen
EVERY = ("position", "heading", "pitch", "roll", "scale")
BOX = {"primitive": "box", "size_m": (6, 4, 5), "heading_deg": 17.0, "position_m": (1, 2, 0), "learn": (*EVERY, "size")}
CAR = {
    **BOX,
    "primitive": "car",
    "size_m": (4.5, 1.8, 1.5),
    "side_curvature": 0.1,
    "learn": (*EVERY, "size", "cabin", "side_curvature"),
}
SHEET = {
    "primitive": "plate",
    "size_m": (0, 4, 4),
    "heading_deg": 40.0,
    "position_m": (1, 2, 3),
    "learn": (*EVERY, "size"),
}
STEPS = {"heading_deg": 0.01, "pitch_deg": 0.01, "roll_deg": 0.01, "scale": 1e-4, "cabin": 2e-4, "side_curvature": 4e-4}
STEP_M = 1e-3


def with_object(table: dict[str, Any], material: dict[str, Any] = BRICK, spacing_m: float = 0.5) -> Scene:
    """An object on flat ground beside a building, on which its shadow may fall, in two polarizations and two views."""
    views = [view(25, 40, name="a"), view(160, 50, name="b")]
    plain = scene_of(
        mesh_of(g=ground(30), b=box((-6, 4, 0), (-2, 9, 3))),
        views,
        shape=(60, 60),
        spacing_m=(spacing_m, spacing_m),
        polarizations=("HH", "VV"),
    )
    return with_objects(plain, [Object(**table, material="o")], {"o": Material(**material)})


def inner(images: Any, weights: Any) -> float:
    return sum(float(np.sum(weights[v][p] * np.asarray(images[v][p], float))) for v in weights for p in weights[v])


def change(render: Renderer, values: Any, name: str, at: tuple[int, ...], step: float) -> dict[str, Any]:
    """d images / d (one number): a central difference of exact images, in float64."""
    shift = np.zeros(values[name].shape)
    shift[at] = step
    up, down = (render({**values, name: values[name] + sign * shift}) for sign in (1, -1))
    return {v: {p: (up[v][p].astype(float) - down[v][p]) / (2.0 * step) for p in up[v]} for v in up}


def apart(render: Renderer, values: Any, wanted: dict[tuple[str, tuple[int, ...]], float], draws: int = 12) -> Any:
    """By number: how far the adjoint's derivative of the images lies from a central difference, over its norm.

    Under weights w of standard normal distribution, the mean of <w, error>^2 is |error|^2.
    """
    random = np.random.default_rng(5)
    images = render(values)
    slopes = {key: change(render, values, *key, step) for key, step in wanted.items()}
    errors: dict[Any, list[float]] = {key: [] for key in wanted}
    for _ in range(draws):
        weights = {v: {p: random.normal(size=i.shape) for p, i in one.items()} for v, one in images.items()}
        gradient = render.vjp(values, weights)
        for (name, at), slope in slopes.items():
            errors[name, at].append(float(gradient[name][at]) - inner(slope, weights))
    norm = {key: np.sqrt(inner(slope, slope)) for key, slope in slopes.items()}
    return {key: float(np.sqrt(np.mean(np.square(errors[key])))) / norm[key] for key in wanted}


def numbers(render: Renderer) -> dict[tuple[str, tuple[int, ...]], float]:
    """Every number of the geometry that has an effect, with the step of its difference."""
    found = {}
    for name, parameter in render.moves.parameters.items():
        for at in np.ndindex(parameter.shape):
            if not (name.endswith("size_m") and parameter.value[at] == 0.0):
                found[name, at] = STEPS.get(name.rpartition(".")[2], STEP_M)
    return found


@pytest.mark.full
@pytest.mark.parametrize(
    ("table", "material", "spacing_m"),
    [(BOX, BRICK, 0.5), (CAR, BRICK, 0.25), (SHEET, DARK, 0.5)],
    ids=["box", "car", "shadow alone"],
)
def test_gradients_are_those_of_central_differences(
    table: dict[str, Any], material: dict[str, Any], spacing_m: float
) -> None:
    """1 % of the derivative's norm, for every number of pose and size; differences over 2 mm leave some 0.1 %."""
    render = warpsar.renderer(with_object(table, material, spacing_m), device="cpu")
    assert len(numbers(render)) >= 9
    for key, error in apart(render, render.values, numbers(render)).items():
        assert error < 0.01, (key, error)


@pytest.mark.full
def test_the_example_scene_and_its_vertices() -> None:
    """A building that is moved as a whole, and single vertices; its walls stand on the ground."""
    scene = Scene.load(EXAMPLE)
    scene = replace(scene, views=scene.views[:1])
    render = warpsar.renderer(scene, device="cpu", vertices=True)
    values, random = render.values, np.random.default_rng(3)
    places, at = np.unique(scene.mesh.vertices, axis=0, return_inverse=True)
    part = [scene.mesh.materials.index(name) for name in ("concrete", "felt")]
    standing = np.unique(at.ravel()[scene.mesh.faces[np.isin(scene.mesh.face_material, part)]])
    moves = {"building and tank": np.isin(at.ravel(), standing)[:, None] * (1.0, 0.5, 0.0)}
    rim = standing[(places[standing, 2] == 15.0) & (places[standing, 1] < 0.0)]  # of the tank: all its edges are whole
    for place in random.choice(rim, 4, replace=False):
        moves[f"vertex at {places[place]}"] = (at.ravel() == place)[:, None] * random.normal(size=3)
    slopes = {name: render.jvp(values, {"mesh.vertices": move}) for name, move in moves.items()}
    images = render(values)
    errors: dict[str, list[float]] = {name: [] for name in moves}
    for _ in range(8):
        weights = {v: {p: random.normal(size=i.shape) for p, i in one.items()} for v, one in images.items()}
        gradient = render.vjp(values, weights)["mesh.vertices"]
        for name, move in moves.items():
            errors[name].append(float(np.sum(gradient * move)) - inner(slopes[name], weights))
    for name, slope in slopes.items():
        norm = np.sqrt(inner(slope, slope))
        assert norm > 0.0
        assert np.sqrt(np.mean(np.square(errors[name]))) < 0.01 * norm, name


def with_effects(scene: Scene) -> Scene:
    tables = {
        "point_spread": {"range_fwhm_m": 1.1, "azimuth_fwhm_m": 0.9},
        "noise_floor": {"level": 0.01},
        "view_gain": {"gain_db": {"a": 0.4, "b": -0.1}},
    }
    return replace(scene, effects={name: validate(name, table, f"effects.{name}") for name, table in tables.items()})


def test_surfaces_effects_and_poses_together() -> None:
    """All are differentiated at other values than the declared ones; the effects blur, lift and weigh the slopes."""
    scene = with_effects(with_object({**BOX, "learn": ("position", "heading")}))
    render = warpsar.renderer(scene, device="cpu")
    assert {
        "materials.g.eps_r",
        "effects.point_spread.range_fwhm_m",
        "effects.view_gain.gain_db[a]",
        "objects.box.position_m",
    } <= set(render.parameters)
    values = {**render.values, "materials.g.eps_r": np.array(7.0), "objects.box.heading_deg": np.array(18.5)}
    values["effects.point_spread.range_fwhm_m"] = np.array(1.3)
    for key, error in apart(render, values, numbers(render)).items():
        assert error < 0.01, (key, error)
    fixed = warpsar.renderer(
        replace(scene, objects=tuple(o.model_copy(update={"learn": (), "heading_deg": 18.5}) for o in scene.objects)),
        device="cpu",
    )
    assert not fixed.moves.parameters
    weights = render(values)
    gradient = render.vjp(values, weights)
    step = {"materials.g.eps_r": 0.01, "effects.point_spread.range_fwhm_m": 0.01}
    for name, width in step.items():
        up, down = (render({**values, name: values[name] + sign * width}) for sign in (1, -1))
        assert gradient[name] == pytest.approx((inner(up, weights) - inner(down, weights)) / (2 * width), rel=5e-3)


def test_walls_edge_on_take_the_mean_of_both_sides() -> None:
    """A box seen along its walls: a turn to the left shows another wall than a turn to the right."""
    table = {**BOX, "heading_deg": 25.0, "learn": ("heading", "position")}
    render = warpsar.renderer(with_object(table), device="cpu")
    for key, error in apart(render, render.values, numbers(render)).items():
        assert error < 0.01, (key, error)


def test_a_rise_in_closed_form() -> None:
    """A plate raised by dz comes nearer by dz cos(incidence): the sum of row x beta0 follows, in ten whole rows."""
    theta = np.deg2rad(40.0)
    sheet = Object(primitive="plate", size_m=(5.0 / np.sin(theta), 8.0, 0.0), material="o", learn=("position",))
    plain = scene_of(mesh_of(g=box((30, 30, 0), (31, 31, 1))), view(0.0, 40.0), shape=(40, 40))
    scene = with_objects(plain, [sheet], {"o": Material(**SOIL)})
    render = warpsar.renderer(scene, device="cpu")
    rows = np.tile((np.arange(40) + 0.5)[:, None], (1, 40))
    power = float(render()["view"]["HH"].sum())
    gradient = render.vjp(None, {"view": {"HH": rows}})["objects.plate.position_m"]
    np.testing.assert_allclose(gradient[2], -power * np.cos(theta) / 0.5, rtol=1e-3)
    np.testing.assert_allclose(gradient[1], -power * np.sin(theta) / 0.5, rtol=1e-3)


# ---- PyTorch and JAX ----


@pytest.mark.full
def test_torch_gradients_to_poses() -> None:
    """A tensor that several numbers come from; the same gradient as `vjp`, and again after another run."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'warpsar[torch]'")
    render = warpsar.renderer(with_object({**BOX, "learn": ("position", "size")}), device="cpu")
    weights = {v: {p: i * 0.0 + 1.0 + i for p, i in one.items()} for v, one in render().items()}

    def loss(f: Any) -> Any:
        place = torch.stack([f, 2.0 * f, 0.0 * f])
        size = torch.stack([torch.tensor(6.0, dtype=f.dtype), 4.0 * f, torch.tensor(5.0, dtype=f.dtype)])
        images = render.torch(
            {"objects.box.position_m": place, "objects.box.size_m": size, "materials.g.eps_r": 6.0 * f}
        )
        return sum((torch.as_tensor(w) * images[v][p]).sum() for v, o in weights.items() for p, w in o.items())

    factor = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)
    total = loss(factor)
    render({"objects.box.position_m": np.array([3.0, 3.0, 0.0])})  # another run before the backward pass
    total.backward()
    values = {"objects.box.position_m": np.array([1.0, 2.0, 0.0]), "objects.box.size_m": np.array([6.0, 4.0, 5.0])}
    expected = render.vjp(values, weights)
    by_hand = (
        expected["objects.box.position_m"] @ (1, 2, 0)
        + 4.0 * expected["objects.box.size_m"][1]
        + 6.0 * expected["materials.g.eps_r"]
    )
    assert float(factor.grad) == pytest.approx(by_hand, rel=1e-4)
    with torch.no_grad():
        ends = [float(loss(torch.tensor(1.0 + s * 1e-3, dtype=torch.float64))) for s in (1, -1)]
    assert float(factor.grad) == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=0.01)


def test_torch_gradients_to_vertices() -> None:
    """A mesh that PyTorch makes: a roof's height."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'warpsar[torch]'")
    scene = with_object({**BOX, "learn": ()})
    render = warpsar.renderer(scene, device="cpu", vertices=True)
    start = torch.tensor(scene.mesh.vertices)
    roof = torch.tensor(np.isclose(scene.mesh.vertices[:, 2], 5.0))
    height = torch.tensor(5.0, dtype=torch.float64, requires_grad=True)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    images = render.torch({"mesh.vertices": start + (roof * (height - 5.0))[:, None] * up})
    images["a"]["HH"].square().sum().backward()
    taller = warpsar.renderer(with_object({**BOX, "learn": ("size",)}), device="cpu")
    weights = {"a": {"HH": 2.0 * taller()["a"]["HH"]}}
    assert float(height.grad) == pytest.approx(taller.vjp(None, weights)["objects.box.size_m"][2], rel=1e-4)


def test_jax_gradients_to_poses() -> None:
    jax = pytest.importorskip("jax", reason="JAX is not installed: pip install 'warpsar[jax]'")
    render = warpsar.renderer(with_object({**BOX, "learn": ("position",)}), device="cpu")
    weights = {v: {p: np.ones(i.shape) + i for p, i in one.items()} for v, one in render().items()}
    place = {"objects.box.position_m": np.array([1.1, 2.0, 0.0])}

    def loss(given: Any) -> Any:
        images = render.jax(given)
        return sum((jax.numpy.asarray(w) * images[v][p]).sum() for v, o in weights.items() for p, w in o.items())

    expected = render.vjp(place, weights)["objects.box.position_m"]
    found = jax.jit(jax.grad(loss))(place)["objects.box.position_m"]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("free", [{"side_curvature": 0.0}, {"heading_deg": 360.0}])
def test_a_number_at_its_bound_has_a_gradient(free: dict[str, Any]) -> None:
    """The difference of vertices steps over the bound, where the body is as sound as on it."""
    ((key, value),) = free.items()
    render = warpsar.renderer(with_object({**CAR, **free, "learn": (key.removesuffix("_deg"),)}), device="cpu")
    name = f"objects.{CAR.get('name') or 'car'}.{key}"
    assert render.parameters[name].value == value
    assert np.isfinite(render.vjp(None, render())[name])


# ---- what is refused ----


def test_what_has_no_derivative_is_refused() -> None:
    scene = with_object({**BOX, "learn": ("position",)})
    render = warpsar.renderer(scene, device="cpu")
    for values, message in (
        ({"objects.box.heading_deg": 3.0}, "objects.box.heading_deg: is held: objects.box.learn names position"),
        ({"mesh.vertices": 3.0}, "mesh.vertices: are held; renderer"),
        ({"objects.box.position_m": 3.0}, r"objects.box.position_m: found shape \(\); must be \(3,\)"),
        ({"objects.box.position_m": [np.nan, 0, 0]}, "objects.box.position_m: found nan; must be from"),
    ):
        with pytest.raises(InputError, match=message):
            render(values)
    sheet = warpsar.renderer(with_object(SHEET), device="cpu")
    with pytest.raises(InputError, match="a size of 0 must stay 0"):
        sheet({"objects.plate.size_m": [0.1, 4.0, 4.0]})
    with pytest.raises(InputError, match="free these or the vertices"):
        warpsar.renderer(scene, device="cpu", vertices=True)
    bounces = {"multibounce": validate("multibounce", {"max_bounces": 2}, "effects.multibounce")}
    with pytest.raises(InputError, match=r"not there beside effects.multibounce, which looks where surfaces lie"):
        warpsar.renderer(replace(scene, effects=bounces), device="cpu")
    track = scene.radar.model_copy(update={"slant_range_m": 300.0})
    with pytest.raises(InputError, match=r"not there beside view b, which has a track"):
        warpsar.renderer(replace(scene, radar=track), device="cpu")
