"""Gradients of the renderer to poses, sizes and vertices: silhouettes, shadows and turned facets, against differences."""

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

EXAMPLE = Path(__file__).resolve().parent.parent / "data" / "example" / "scene.toml"
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
                found[name, at] = STEPS.get(name.partition(".")[2], STEP_M)
    return found


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
