"""The tape's adjoint of the loss against central differences: a table of tiny scenes with one thing each.

Differences are of losses written out here in NumPy, float64, from the modelled images, not of the kernels' sums.

Tolerance 1e-3. The images are float32: a pixel's rounding, 1e-7 to 1e-6 of it, leaves about 1e-6 / STEP of a
derivative that is as large as the loss, and ten times as much of the smallest ones here (eps_r in HV as printed). The
truncation of central differences at STEP and STEP / 2, extrapolated (Richardson), is f^(5) STEP^4 / 480. Along one
parameter STEP = 0.05 keeps both below 5e-4. Along all of them at once f^(5) is larger (seen: errors of 0.1 at 0.1,
7e-3 at 0.05, 4e-4 at 0.02, then rounding), so there it is 0.02.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import bumpy
from scipy.special import digamma, polygamma
from worlds import scene_of, view

from warpsar.io.images import write_exr, write_tiff
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import ROUNDING
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.surface.surface import KEYS
from warpsar.world.tables import Material, View

pytestmark = pytest.mark.unit

STEP, STEP_OF_ALL = 0.05, 0.02
TOLERANCE = 1e-3
LOOKS = 4.0
POLARIZATIONS = ("HH", "VV", "HV")
SCALARS = {"eps_r": "eps", "rms_height_m": "h", "correlation_length_m": "l", "specular_fraction": "t"}
NUMBERS = {"eps_r": 6.0, "rms_height_m": 0.002, "correlation_length_m": 0.008, "specular_fraction": 0.3}


def derivative(value: Callable[[float], Any], step: float = STEP) -> Any:
    """d value / dt at 0 by central differences at two steps, extrapolated."""
    wide = (value(step) - value(-step)) / (2 * step)
    narrow = (value(step / 2) - value(-step / 2)) / step
    return (4 * narrow - wide) / 3


def material(layout: str, spectrum: str, folder: Path) -> Material:
    values: dict[str, Any] = dict(NUMBERS)
    if layout == "vertex":
        values = dict(SCALARS)
    elif layout == "texture":
        random = np.random.default_rng(2)
        for key, number in NUMBERS.items():
            values[key] = str(folder / f"{key}.exr")
            write_exr(values[key], {key: number * random.uniform(0.8, 1.25, (3, 4))})
    elif spectrum == "separable":
        values["correlation_length_m"] = (0.008, 0.011)
    return Material(layout=layout, spectrum=spectrum, learn=KEYS, **values)


def tiny_scene(
    folder: Path, *, layout: str = "uniform", spectrum: str = "gaussian", geometry: str = "plane", **more: Any
) -> Scene:
    """12 x 12 pixels of tilted facets, one view for each polarization; measured: the model's own image, 1.3 to 2 times
    as bright, so that every residual has one sign and no derivative cancels to nothing."""
    radar: dict[str, Any] = {"variant": more.get("variant", "standard")}
    if geometry == "strip-map":
        radar["slant_range_m"] = 60.0
    views = [view(40.0 + 100.0 * i, 42.0, name=p, looks=LOOKS) for i, p in enumerate(POLARIZATIONS)]
    scene = scene_of(
        bumpy(), views, shape=(12, 12), spacing_m=(0.4, 0.4), rays_per_pixel=16.0, polarizations=POLARIZATIONS, **radar
    )
    scene = replace(scene, materials={"soil": material(layout, spectrum, folder)})
    random = np.random.default_rng(3)
    seen: list[View] = []
    for one, made in zip(scene.views, simulate(scene, device="cpu"), strict=True):
        path = folder / f"{one.name}.tif"
        write_tiff(path, made.beta0[one.name] * random.uniform(1.3, 2.0, scene.grid.shape))
        seen.append(one.model_copy(update={"images": {one.name: path}}))
    return replace(scene, views=seen)


def gamma(measured: np.ndarray, mu: np.ndarray) -> float:
    return float(np.sum(LOOKS * (measured / mu - 1 - np.log(measured / mu))))


def misfit(problem: FitProblem, x: np.ndarray) -> float:
    return sum(gamma(seen.values, mu) for seen, mu in zip(problem.observations, problem.modelled(x), strict=True))


def directions(problem: FitProblem, key: str) -> list[np.ndarray]:
    """Along one parameter: the number, or two random combinations of a field's nodes."""
    block = problem.surface.block("soil", key)
    random = np.random.default_rng(7)
    found = []
    for _ in range(1 if block.size == 1 else 2):
        direction = np.zeros(problem.x0.size)
        direction[block.start : block.stop] = 1.0 if block.size == 1 else random.uniform(-1, 1, block.size)
        found.append(direction)
    return found


@pytest.mark.full
@pytest.mark.parametrize(
    ("layout", "spectrum", "variant", "geometry"),
    list(
        product(
            ("uniform", "vertex", "texture"),
            ("gaussian", "exponential", "separable"),
            ("standard", "as_printed"),
            ("plane", "strip-map"),
        )
    ),
)
def test_every_parameter_in_every_polarization(
    layout: str, spectrum: str, variant: str, geometry: str, tmp_path: Path
) -> None:
    scene = tiny_scene(tmp_path, layout=layout, spectrum=spectrum, variant=variant, geometry=geometry)
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    x0 = problem.x0
    problem.gradient(x0)
    adjoint = [one.render.nodes.grad.numpy().astype(float) for one in problem.views]
    values = [seen.values for seen in problem.observations]
    assert min(len(v) for v in values) > 20
    for key in KEYS:
        for direction in directions(problem, key):

            def losses(t: float, direction: np.ndarray = direction) -> np.ndarray:
                return np.array(
                    [gamma(i, mu) for i, mu in zip(values, problem.modelled(x0 + t * direction), strict=True)]
                )

            # HV lives on the difference of two amplitudes, of which float32 leaves few digits: rounded at several steps
            numeric = np.mean([derivative(losses, step) for step in (STEP, 0.9 * STEP, 1.1 * STEP)], axis=0)
            for index, polarization in enumerate(POLARIZATIONS):
                found = adjoint[index] @ direction
                # a combination of nodes may cancel: its size is that of what is added up
                size = max(abs(numeric[index]), np.abs(adjoint[index] * direction).max())
                assert size > 1e-3, (key, polarization)
                assert abs(found - numeric[index]) < TOLERANCE * size, (key, polarization, found, numeric[index])


@pytest.fixture(scope="module")
def uniform(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return tiny_scene(tmp_path_factory.mktemp("uniform"))


def check(
    problem: FitProblem, loss: Callable[[np.ndarray], float], sharp: Callable[[np.ndarray], float] = lambda x: 0.0
) -> None:
    """`problem.gradient` along random directions against differences of `loss`, and the loss itself; `sharp` is a
    part of it that bends within a step, but is a float64 formula, and has a step of its own."""
    value, gradient = problem.gradient(problem.x0)
    # float32 terms added up in float64
    assert value == pytest.approx(loss(problem.x0) + sharp(problem.x0), rel=1e-5)
    random = np.random.default_rng(11)
    for _ in range(4):
        direction = random.uniform(-1, 1, problem.x0.size)
        numeric = derivative(lambda t, d=direction: loss(problem.x0 + t * d), STEP_OF_ALL)
        numeric += derivative(lambda t, d=direction: sharp(problem.x0 + t * d), 1e-5)
        size = max(abs(numeric), np.abs(gradient * direction).max())
        assert abs(gradient @ direction - numeric) < TOLERANCE * size


def log_loss(measured: np.ndarray, mu: np.ndarray) -> float:
    bias = digamma(LOOKS) - np.log(LOOKS)
    return float(np.sum(0.5 * (np.log(measured / mu) - bias) ** 2) / polygamma(1, LOOKS))


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("name", ["gamma", "mse", "log"])
def test_every_loss(name: str, calibrated: bool, uniform: Scene) -> None:
    """With unknown gains the best one is looked for by brute force."""
    from scipy.optimize import minimize_scalar

    scene = replace(uniform, grid=uniform.grid.model_copy(update={"calibrated": calibrated}))
    problem = FitProblem(scene, devices.resolve_device("cpu"), loss=name)
    mean_square = np.mean([np.mean(scene.measured(v, v.name).astype(float) ** 2) for v in scene.views])
    written_out = {
        "gamma": gamma,
        "mse": lambda measured, mu: float(np.sum(0.5 * (measured - mu) ** 2) / mean_square),
        "log": log_loss,
    }[name]

    def loss(x: np.ndarray) -> float:
        total = 0.0
        for seen, mu in zip(problem.observations, problem.modelled(x), strict=True):
            if calibrated:
                total += written_out(seen.values, mu)
            else:
                at = minimize_scalar(
                    lambda t, i=seen.values, m=mu: written_out(i, np.exp(t) * m), bounds=(-2, 2), method="bounded",
                    options={"xatol": 1e-9},
                )  # fmt: skip
                total += float(at.fun)
        return total

    check(problem, loss)


@pytest.mark.parametrize("layout", ["vertex", "texture"])
def test_total_variation(layout: str, tmp_path: Path) -> None:
    """Neighbours written out: texels that share a side; vertices of the 4 x 4 grid and its diagonals."""
    weights = {"eps_r": 3.0, "rms_height_m": 7.0, "specular_fraction": 0.5}
    scene = tiny_scene(tmp_path, layout=layout)
    problem = FitProblem(scene, devices.resolve_device("cpu"), total_variation=weights)

    def rough(difference: np.ndarray) -> float:
        return float(np.sum(np.sqrt(difference**2 + ROUNDING**2) - ROUNDING))

    def price(x: np.ndarray) -> float:
        total = 0.0
        for key, weight in weights.items():
            block = problem.surface.block("soil", key)
            field = x[block.start : block.stop].reshape((3, 4) if layout == "texture" else (5, 5))
            total += weight * (rough(np.diff(field, axis=0)) + rough(np.diff(field, axis=1)))
            if layout == "vertex":
                total += weight * rough(field[1:, 1:] - field[:-1, :-1])
        return total

    assert price(problem.x0) > 1.0
    check(problem, lambda x: misfit(problem, x), price)


@pytest.mark.parametrize("tau", [0.02, 0.3, 0.95])
def test_validity_penalty(tau: float, uniform: Scene) -> None:
    """Corrected equations 9, 12 and 19, written out from docs/physics.md; h and l violate every one of them."""
    values = {**NUMBERS, "rms_height_m": 0.004, "specular_fraction": tau}
    scene = replace(uniform, materials={"soil": Material(learn=KEYS, **values)})
    strength = 200.0
    problem = FitProblem(scene, devices.resolve_device("cpu"), validity=strength)

    def beyond(ratio: Any) -> Any:
        return np.maximum(np.log(ratio), 0.0) ** 2

    def loss(x: np.ndarray) -> float:
        total = misfit(problem, x)
        h, length, t = np.exp(x[1]), np.exp(x[2]), 1 / (1 + np.exp(-x[3]))
        for one in problem.views:
            hits = one.render.hits
            k = hits.geometry.wavenumber
            wavelength = 2 * np.pi / k
            cos, area = hits.cos_incidence.numpy().astype(float), hits.weight.numpy().astype(float)
            spm = beyond(k * h / 0.3) + beyond(np.sqrt(2) * h / length / 0.3)
            ka = beyond(np.sqrt(10) / 2 / (k * h * cos)) + beyond(6 / (k * length))
            ka = ka + beyond(2.76 * h * wavelength / length**2)
            total += strength * float(np.sum(area * ((1 - t) * spm + t * ka)) / area.sum())
        return total

    check(problem, loss)


@pytest.mark.cuda
@pytest.mark.parametrize("layout", ["uniform", "vertex", "texture"])
def test_cuda_gradient_is_the_cpu_one(layout: str, tmp_path: Path) -> None:
    """To float32 sums in another order: 1e-4 of the largest element."""
    scene = tiny_scene(tmp_path, layout=layout)
    weights = {} if layout == "uniform" else {"eps_r": 1.0}
    found = []
    for device in ("cpu", "cuda"):
        problem = FitProblem(scene, devices.resolve_device(device), total_variation=weights, validity=5.0)
        found.append(problem.gradient(problem.x0))
    (value, gradient), (cuda_value, cuda_gradient) = found
    assert cuda_value == pytest.approx(value, rel=1e-4)
    np.testing.assert_allclose(cuda_gradient, gradient, rtol=1e-3, atol=1e-4 * np.abs(gradient).max())
