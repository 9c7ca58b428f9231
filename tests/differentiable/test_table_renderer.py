"""`warpsar.renderer` with a table of sigma0 among its parameters: against finite differences, in every library."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_learned_table import ANGLES, GIVEN, PARTS, bent, site, written

from warpsar import InputError, Scene, renderer
from warpsar.differentiable.renderer import Renderer

NAMES = ["materials.block.sigma0[HH]", "materials.block.sigma0[VV]", "materials.block.sigma0[HV]"]


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """A block whose table is free, with turned walls, on ground of another table, whose level is."""
    files = written(tmp_path, given=GIVEN, other=bent())
    block, lawn = ({"sigma0": files[f], "learn": (key,)} for f, key in (("given", "sigma0"), ("other", "level")))
    made = site({"lawn": lawn, "block": block}, ("HH", "HV"))
    assert set(PARTS) == set(made.materials)
    return replace(made, effects={"noise_floor": {"level": 0.002}})


def weights_of(render: Renderer) -> dict[str, dict[str, np.ndarray]]:
    random = np.random.default_rng(0)
    return {name: {p: random.random(image.shape) for p, image in one.items()} for name, one in render().items()}


def total(images: Any, weights: dict[str, dict[str, np.ndarray]]) -> float:
    return float(sum((weights[v][p] * images[v][p]).sum() for v in weights for p in weights[v]))


@pytest.mark.parametrize("vertices", [False, True])
def test_gradients_to_a_tables_columns_are_those_of_differences(scene: Scene, vertices: bool, device: str) -> None:
    """Also where the mesh's vertices are free, and beside the level of the other table and an effect."""
    render = renderer(scene, device=device, vertices=vertices)
    assert [name for name in render.parameters if "sigma0" in name] == NAMES
    weights, values = weights_of(render), render.values
    gradient = render.vjp(values, weights)
    random = np.random.default_rng(1)
    for name in [*NAMES, "materials.lawn.level", "effects.noise_floor.level"]:
        values[name] = values[name] * (1.0 + 0.01 * random.random(values[name].shape))  # not where it was declared
    gradient = render.vjp(values, weights)
    for name in [*NAMES, "materials.lawn.level", "effects.noise_floor.level"]:
        assert gradient[name].shape == values[name].shape
        move = random.normal(size=values[name].shape) * (0.1 if name in NAMES else 0.02 * values[name])
        ends = [total(render({**values, name: values[name] + step * move}), weights) for step in (1, -1, 2, -2)]
        expected = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / 12
        assert float((gradient[name] * move).sum()) == pytest.approx(expected, rel=2e-3, abs=1e-5)  # float32 sums
    assert np.abs(gradient[NAMES[1]]).max() > 0  # on turned facets HH and HV hold VV


def test_images_are_those_of_the_table_given(scene: Scene, tmp_path: Path) -> None:
    truth = bent()
    changed = {f"materials.block.sigma0[{key}]": column for key, column in truth.sigma0_db.items()}
    render = renderer(scene, device="cpu")
    declared = render()
    found = render(changed)
    block = scene.materials["block"].model_copy(update={"sigma0": tmp_path / "other.csv"})
    expected = renderer(replace(scene, materials=scene.materials | {"block": block}), device="cpu")()
    again = render()
    for view, images in expected.items():
        for p, image in images.items():
            np.testing.assert_array_equal(found[view][p], image)
            np.testing.assert_array_equal(again[view][p], declared[view][p])


def test_jvp_is_the_adjoint_of_vjp(scene: Scene) -> None:
    render = renderer(scene, device="cpu")
    weights, name = weights_of(render), NAMES[0]
    move = np.random.default_rng(2).normal(size=ANGLES.size)
    moved = render.jvp({}, {name: move})
    assert total(moved, weights) == pytest.approx(float((render.vjp({}, weights)[name] * move).sum()), rel=2e-3)


def test_torch_and_jax_have_the_same_gradients(scene: Scene) -> None:
    torch, jax = pytest.importorskip("torch"), pytest.importorskip("jax")
    render = renderer(scene, device="cpu")
    weights = weights_of(render)
    values = {name: render.values[name] + 0.3 for name in NAMES[:2]}
    expected = render.vjp(values, weights)
    tensors = {name: torch.tensor(value, requires_grad=True) for name, value in values.items()}
    found = render.torch(tensors)
    sum(
        (torch.as_tensor(weights[v][p]) * image).sum() for v, one in found.items() for p, image in one.items()
    ).backward()

    def loss(given: Any) -> Any:
        images = render.jax(given)
        return sum((weights[v][p] * image).sum() for v, one in images.items() for p, image in one.items())

    by_jax = jax.grad(loss)(values)
    for name in values:
        np.testing.assert_allclose(tensors[name].grad.numpy(), expected[name], rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose(np.asarray(by_jax[name]), expected[name], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"materials.block.sigma0[HH]": np.zeros(3)}, r"found shape \(3,\); must be \(10,\)"),
        ({"materials.block.sigma0[HH]": np.full(10, 101.0)}, "must be from -100 to 100"),
        ({"materials.block.sigma0": np.zeros(10)}, "found no such parameter"),
        ({"materials.block.level": 1.0}, "is held: materials.block.learn names sigma0"),
        ({"materials.lawn.sigma0[HH]": np.zeros(10)}, "is held: materials.lawn.learn names level"),
    ],
)
def test_what_is_no_column_is_refused(values: dict[str, Any], said: str, scene: Scene) -> None:
    with pytest.raises(InputError, match=said):
        renderer(scene, device="cpu")(values)
