"""The renderer's derivatives are those of its images: against finite differences, in NumPy, PyTorch and JAX."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from worlds import SOIL, box, ground, mesh_of, scene_of, view

import warpsar
from warpsar import InputError, Material, Scene
from warpsar.differentiable.renderer import Renderer

ALL = ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction")
START = {**SOIL, "specular_fraction": 0.2, "learn": ALL}


def uniform(**effects: Any) -> Scene:
    """Ground and a block, two views, two polarizations."""
    scene = scene_of(
        mesh_of(lawn=ground(12.0), block=box((-2, -1.5, 0), (2, 1.5, 2))),
        [view(30, 40, name="a"), view(250, 55, name="b")],
        shape=(20, 22),
        spacing_m=(0.7, 0.6),
        polarizations=("HH", "VV"),
        materials={"lawn": START, "block": {**SOIL, "eps_r": (9.0, -0.5)}},
        rays_per_pixel=16.0,
    )
    return replace(scene, effects=effects)


def field(layout: str) -> Scene:
    scene = uniform()
    random = np.random.default_rng(1)
    mesh = mesh_of(lawn=ground(12.0, 6))
    low, spread = {"eps_r": (5.0, 2.0), "rms_height_m": (0.001, 0.0004)}, random.random((2, len(mesh.vertices)))
    values: dict[str, Any]
    if layout == "vertex":
        scalars = {key: a + b * r for (key, (a, b)), r in zip(low.items(), spread, strict=True)}
        mesh, values = replace(mesh, vertex_scalars=scalars), {key: key for key in low}
    else:
        mesh = replace(mesh, uv=mesh.vertices[:, :2] / 12.0 + 0.5)
        values = {key: a + b * r[:20].reshape(4, 5) for (key, (a, b)), r in zip(low.items(), spread, strict=True)}
    return replace(scene, mesh=mesh, materials={"lawn": Material(**{**START, **values}, layout=layout)})


SCENES: dict[str, Callable[[], Scene]] = {
    "uniform": uniform,
    "vertex": lambda: field("vertex"),
    "texture": lambda: field("texture"),
    "effects": lambda: uniform(noise_floor={"level": 0.01}, view_gain={"gain_db": {"a": 0.4, "b": -0.1}}),
}


def cotangents(render: Renderer, seed: int = 0) -> dict[str, dict[str, np.ndarray]]:
    random = np.random.default_rng(seed)
    return {name: {p: random.random(image.shape) for p, image in one.items()} for name, one in render().items()}


def product(images: Any, weights: Any) -> float:
    """Sum of cotangent x image, float64."""
    return sum(float(np.sum(weights[v][p] * np.asarray(images[v][p], float))) for v in weights for p in weights[v])


def difference(render: Renderer, values: Any, name: str, along: np.ndarray, weights: Any) -> float:
    """Richardson's extrapolation of central differences of `product` along a direction, in the parameter's own unit."""

    def at(step: float) -> float:
        return product(render({**values, name: values[name] + step * along}), weights)

    coarse, fine = (at(1.0) - at(-1.0)) / 2.0, at(0.5) - at(-0.5)
    return (4.0 * fine - coarse) / 3.0


@pytest.fixture(scope="module")
def renders() -> dict[tuple[str, str], Renderer]:
    return {}


@pytest.fixture
def of(renders: dict[tuple[str, str], Renderer]) -> Callable[[str, str], Renderer]:
    def made(name: str, device: str) -> Renderer:
        return renders.setdefault((name, device), warpsar.renderer(SCENES[name](), device=device))

    return made


def moved(render: Renderer) -> dict[str, np.ndarray]:
    """Values that are not the declared ones."""
    return {name: value * 1.05 for name, value in render.values.items()}


@pytest.mark.parametrize("name", SCENES)
def test_images_are_those_of_simulate(of: Any, name: str, device: str) -> None:
    render = of(name, device)
    images = render()
    for one in warpsar.simulate(render.scene, device=device):
        for p, beta0 in one.beta0.items():
            if device == "cpu":
                np.testing.assert_array_equal(images[one.name][p], beta0)
            else:  # CUDA's hits come in any order, and so do sums of float32
                np.testing.assert_allclose(images[one.name][p], beta0, rtol=1e-5)
            assert images[one.name][p].dtype == np.float32
    changed = render(moved(render))
    assert product(changed, changed) != product(images, images)
    for p, beta0 in render(render.values)["a"].items():
        np.testing.assert_allclose(beta0, images["a"][p], rtol=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_vjp_is_what_finite_differences_give(of: Any, name: str, device: str) -> None:
    render = of(name, device)
    values, weights = moved(render), cotangents(render)
    gradients = render.vjp(values, weights)
    assert set(gradients) == set(render.parameters)
    random = np.random.default_rng(2)
    for key, gradient in gradients.items():
        assert gradient.shape == render.parameters[key].shape
        step = 0.02 * np.abs(values[key]) * random.choice([-1.0, 1.0], gradient.shape)
        if gradient.size > 1:  # random signs would cancel
            step = np.abs(step) * np.sign(gradient + 1e-300)
        numeric, adjoint = difference(render, values, key, step, weights), float(np.sum(gradient * step))
        assert adjoint == pytest.approx(numeric, rel=2e-3), key
        assert abs(numeric) > 0, key


@pytest.mark.parametrize("name", SCENES)
def test_jvp_is_the_transpose_of_vjp(of: Any, name: str, device: str) -> None:
    render = of(name, device)
    values, weights = moved(render), cotangents(render)
    gradients = render.vjp(values, weights)
    tangents = {key: value * np.random.default_rng(3).uniform(0.5, 1.0, value.shape) for key, value in values.items()}
    forward = product(render.jvp(values, tangents), weights)
    assert forward == pytest.approx(sum(float(np.sum(gradients[k] * tangents[k])) for k in tangents), rel=2e-3)


def test_what_is_left_out_is_zero_or_declared(of: Any) -> None:
    render = of("uniform", "cpu")
    weights = cotangents(render)
    one = render.vjp(None, {"a": {"VV": weights["a"]["VV"]}})
    full = render.vjp(
        render.values, {v: {p: w * (v == "a" and p == "VV") for p, w in weights[v].items()} for v in "ab"}
    )
    for key, gradient in one.items():
        np.testing.assert_allclose(gradient, full[key], rtol=1e-5)
    assert all(not gradient.any() for gradient in render.vjp(None, {}).values())


def test_vertices_of_other_materials_have_no_gradient() -> None:
    low, high = ground(8.0, 2), box((-1, -1, 0), (1, 1, 1))
    mesh = mesh_of(lawn=low, block=high)
    mesh = replace(mesh, vertex_scalars={"wet": np.r_[np.full(len(low[0]), 6.0), np.zeros(len(high[0]))]})
    scene = scene_of(
        mesh, view(30, 40), materials={"lawn": {**SOIL, "eps_r": "wet", "layout": "vertex"}, "block": SOIL}
    )
    render = warpsar.renderer(scene, device="cpu")
    assert render.parameters["materials.lawn.eps_r"].shape == (len(mesh.vertices),)
    gradient = render.vjp(None, {"view": {"HH": np.ones(scene.grid.shape)}})["materials.lawn.eps_r"]
    assert (gradient[: len(low[0])] > 0).all()
    assert not gradient[len(low[0]) :].any()


def test_values_of_an_effect_on_each_material_have_derivatives() -> None:
    """They stand behind the effect's other parameters, one for each of the mesh's materials. Within 1 %, as float32
    images leave of a difference of two sums of 880 pixels."""
    share = {"lawn": 0.5, "block": 2.0}
    render = warpsar.renderer(uniform(unresolved_detail={"level": 0.05, "spread_m": 1.0, "share": share}), device="cpu")
    weights, values = cotangents(render), render.values
    gradient = render.vjp(values, weights)
    for material in share:
        name = f"effects.unresolved_detail.share[{material}]"
        expected = difference(render, values, name, np.array(0.1), weights) / 0.1
        assert abs(expected) > 1e-3
        assert float(gradient[name]) == pytest.approx(expected, rel=1e-2)


def test_several_calls_do_not_disturb_each_other(of: Any) -> None:
    render = of("uniform", "cpu")
    weights, values = cotangents(render), moved(render)
    first = render.vjp(values, weights)
    render()
    render.vjp(None, weights)
    for key, gradient in render.vjp(values, weights).items():
        np.testing.assert_array_equal(gradient, first[key])


WRONG: dict[str, tuple[Callable[[Renderer], Any], str]] = {
    "unknown": (
        lambda r: r({"materials.sea.eps_r": 3.0}),
        r"materials.sea.eps_r: found no such parameter; must be one of materials.lawn.eps_r",
    ),
    "held": (
        lambda r: r({"materials.block.specular_fraction": 0.5}),
        r"is held: materials.block.learn names eps_r, rms",
    ),
    "layout": (lambda r: r({"block.layout": 1.0}), r"block.layout: found no such parameter"),
    "not stated": (lambda r: r({"effects.registration.range_m[a]": 0.1}), r"found no such parameter"),
    "setting": (lambda r: r({"effects.point_spread.window": 1.0}), r"is discrete and cannot be learned"),
    "unstated": (lambda r: r({"effects.point_spread.azimuth_fwhm_m": 1.0}), r"does not state it"),
    "bounds": (
        lambda r: r({"materials.lawn.eps_r": 0.5}),
        r"materials.lawn.eps_r: found 0.5; must be from 1.01 to 300",
    ),
    "nan": (lambda r: r({"materials.lawn.eps_r": float("nan")}), r"materials.lawn.eps_r: found nan; must be from"),
    "shape": (
        lambda r: r({"materials.lawn.eps_r": [5.0, 6.0]}),
        r"materials.lawn.eps_r: found shape \(2,\); must be \(\)",
    ),
    "text": (lambda r: r({"materials.lawn.eps_r": "wet"}), r"materials.lawn.eps_r: found 'wet'; must be numbers"),
    "view": (lambda r: r.vjp(None, {"c": {}}), r"cotangents: found view 'c'; must be one of a, b"),
    "polarization": (lambda r: r.vjp(None, {"a": {"HV": 1}}), r"cotangents of a: found 'HV'; must be one of HH, VV"),
    "pixels": (lambda r: r.vjp(None, {"a": {"HH": np.ones(3)}}), r"a HH: found shape \(3,\); must be \(20, 22\)"),
    "tangent": (lambda r: r.jvp(None, {"materials.lawn.eps_r": 0.0}), r"tangents: found materials.lawn.eps_r, all 0"),
    "no tangent": (lambda r: r.jvp(None, {}), r"tangents: found none, all 0"),
    "tangent's shape": (
        lambda r: r.jvp(None, {"materials.lawn.eps_r": [1.0]}),
        r"materials.lawn.eps_r: found shape \(1,\)",
    ),
    "edge": (
        lambda r: r.jvp({"materials.lawn.eps_r": 300.0}, {"materials.lawn.eps_r": 1.0}),
        r"materials.lawn.eps_r is too close to its bound",
    ),
}


@pytest.mark.parametrize("how", WRONG)
def test_what_has_no_derivative_is_refused(how: str, renders: dict[tuple[str, str], Renderer]) -> None:
    scene = uniform(point_spread={"range_fwhm_m": 1.1})
    render = renders.setdefault(("wrong", "cpu"), warpsar.renderer(scene, device="cpu"))
    act, message = WRONG[how]
    with pytest.raises(InputError, match=message):
        act(render)


def test_a_dead_start_has_no_derivative() -> None:
    scene = uniform()
    dead = {**scene.materials, "lawn": Material(**{**START, "specular_fraction": 0.0})}
    render = warpsar.renderer(replace(scene, materials=dead), device="cpu")
    weights = cotangents(render)
    with pytest.raises(InputError, match=r"materials.lawn.specular_fraction: found 0; must be from 1e-06"):
        render.vjp(None, weights)
    assert render.vjp({"materials.lawn.specular_fraction": 0.1}, weights)["materials.lawn.specular_fraction"] != 0


# ---- PyTorch ----


def tensors(torch: Any, values: Any, device: str) -> dict[str, Any]:
    return {name: torch.tensor(value, device=device, requires_grad=True) for name, value in values.items()}


@pytest.mark.parametrize("name", SCENES)
def test_torch_gives_the_same_gradients(of: Any, name: str, device: str) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'warpsar[torch]'")
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("this PyTorch has no CUDA")
    render = of(name, device)
    values, weights = moved(render), cotangents(render)
    expected, images = render.vjp(values, weights), render(values)
    given = tensors(torch, values, device)
    found = render.torch(given)
    for v, one in found.items():
        for p, image in one.items():
            assert image.dtype == torch.float32
            assert image.device.type == device
            np.testing.assert_array_equal(image.detach().cpu().numpy(), images[v][p])
    render()  # another run before the backward pass
    loss = sum(
        (torch.as_tensor(w, device=device) * found[v][p]).sum() for v, o in weights.items() for p, w in o.items()
    )
    loss.backward()
    for key, tensor in given.items():
        np.testing.assert_allclose(
            tensor.grad.cpu().numpy(), expected[key], rtol=1e-4, atol=1e-6 * abs(expected[key]).max()
        )


def test_torch_gradients_are_finite_differences(of: Any) -> None:
    """As torch.autograd.gradcheck does, with the steps that float32 images ask for."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'warpsar[torch]'")
    render = of("uniform", "cpu")
    weights = cotangents(render)
    factor = torch.ones(3, dtype=torch.float64, requires_grad=True)  # a tensor that several parameters come from

    def loss(f: Any) -> Any:
        images = render.torch(
            {
                "materials.lawn.eps_r": 6.0 * f[0],
                "materials.lawn.rms_height_m": 0.0012 * f[1],
                "materials.block.eps_r": 9.0 * f[2] * f[0],
            }
        )
        return sum((torch.as_tensor(w) * images[v][p]).sum() for v, o in weights.items() for p, w in o.items())

    (gradient,) = torch.autograd.grad(loss(factor), factor)
    with torch.no_grad():
        for k in range(3):
            step = 0.01 * torch.eye(3, dtype=torch.float64)[k]
            numeric = (loss(factor + step) - loss(factor - step)) / 0.02
            assert float(gradient[k]) == pytest.approx(float(numeric), rel=2e-3)


def test_torch_refuses_what_the_renderer_refuses(of: Any) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install 'warpsar[torch]'")
    render = of("uniform", "cpu")
    for values, message in (
        ({"materials.sea.eps_r": 3.0}, "found no such parameter"),
        ({"materials.lawn.eps_r": torch.tensor([1.0])}, r"found shape \(1,\)"),
        ({"materials.lawn.eps_r": torch.tensor(0.5)}, "found 0.5; must be from 1.01"),
    ):
        with pytest.raises(InputError, match=message):
            render.torch(values)
    given = torch.tensor(6.0, requires_grad=True)
    with pytest.raises(InputError, match="has no second derivative; create_graph must be False"):
        torch.autograd.grad(render.torch({"materials.lawn.eps_r": given})["a"]["HH"].sum(), given, create_graph=True)


# ---- JAX ----


@pytest.mark.parametrize("name", SCENES)
def test_jax_gives_the_same_gradients(of: Any, name: str, device: str) -> None:
    jax = pytest.importorskip("jax", reason="JAX is not installed: pip install 'warpsar[jax]'")
    render = of(name, device)
    values, weights = moved(render), cotangents(render)
    expected = render.vjp(values, weights)

    def loss(given: Any) -> Any:
        images = render.jax(given)
        return sum((jax.numpy.asarray(w) * images[v][p]).sum() for v, o in weights.items() for p, w in o.items())

    for gradient in (jax.grad(loss)(values), jax.jit(jax.grad(loss))(values)):
        for key, found in gradient.items():
            np.testing.assert_allclose(found, expected[key], rtol=1e-3, atol=1e-5 * abs(expected[key]).max())
    images = render(values)
    np.testing.assert_allclose(render.jax(values)["a"]["HH"], images["a"]["HH"], rtol=1e-5)


def test_jax_refuses(of: Any) -> None:
    jax = pytest.importorskip("jax", reason="JAX is not installed: pip install 'warpsar[jax]'")
    render = of("uniform", "cpu")
    with pytest.raises(InputError, match="found no such parameter"):
        render.jax({"materials.sea.eps_r": 3.0})
    with pytest.raises(InputError, match=r"found shape \(2,\)"):
        render.jax({"materials.lawn.eps_r": np.ones(2)})
    with pytest.raises(Exception, match=r"materials.lawn.eps_r: found 0.5; must be from 1.01"):
        jax.block_until_ready(render.jax({"materials.lawn.eps_r": 0.5}))
    with pytest.raises(TypeError, match="forward-mode"):
        jax.jvp(lambda e: render.jax({"materials.lawn.eps_r": e})["a"]["HH"], (6.0,), (1.0,))


@pytest.mark.parametrize("face", ["torch", "jax"])
def test_a_missing_library_is_said(of: Any, face: str, monkeypatch: pytest.MonkeyPatch) -> None:
    render = Renderer.__new__(Renderer)
    monkeypatch.setitem(__import__("sys").modules, face, None)
    with pytest.raises(InputError, match=rf'needs \w+: pip install "warpsar\[{face}\]"'):
        getattr(render, face)
