"""Small scenes with effects, and what the tests of all effects and of each of them share."""

import dataclasses
import runpy
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import warp as wp
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.effects.registry import check, declared, names, validate
from warpsar.errors import InputError
from warpsar.render.render import ViewRender
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.rays import trace_view
from warpsar.surface.stage import Stage

# float32 through a handful of operations
ROUNDING = 1e-5


class Case(NamedTuple):
    """An effect at work in `street`, whose views are `v0` and `v1`: its table, and what `[radar]` says besides.

    Values lie away from the kinks of piecewise linear interpolation: the tests take derivatives there.
    """

    table: dict[str, Any]
    radar: Mapping[str, Any] = {}


STRIP_MAP: Mapping[str, Any] = {"slant_range_m": 300.0}


@cache
def module_of_tests(name: str) -> dict[str, Any]:
    """What tests/effects/test_<name>.py holds; empty where there is no such file."""
    path = Path(__file__).parent / "effects" / f"test_{name}.py"
    return runpy.run_path(str(path)) if path.exists() else {}


def cases_of(name: str) -> list[Case]:
    """The list `WORKING` of tests/effects/test_<name>.py."""
    found: list[Case] = module_of_tests(name).get("WORKING", [])
    return found


def working() -> list[tuple[str, dict[str, Any], Mapping[str, Any]]]:
    """Name, table and radar of every effect at work."""
    return [(name, *case) for name in names() for case in cases_of(name)]


def street(**radar: Any) -> Scene:
    """A block on a plane, turned so that its walls mirror the radar's rays into the ground; 16 x 16 pixels."""
    mesh = mesh_of(soil=ground(18.0), brick=box((-2.0, -2.5, 0.0), (3.0, 1.0, 3.0)))
    return scene_of(
        mesh,
        [view(2.0, 42.0, name="v0"), view(80.0, 50.0, name="v1")],
        shape=(16, 16),
        spacing_m=(0.75, 0.75),
        rays_per_pixel=16.0,
        materials={"soil": SOIL, "brick": BRICK},
        polarizations=("HH", "VV"),
        **radar,
    )


def with_effect(scene: Scene, name: str, table: dict[str, Any]) -> Scene:
    return dataclasses.replace(scene, effects={**scene.effects, name: validate(name, table, f"effects.{name}")})


def render_of(scene: Scene, *, neutral: bool = False) -> ViewRender:
    """The first view with its effects; those at neutral too where asked."""
    stage = Stage.of(scene, devices.resolve_device("cpu"))
    effects = declared(scene, scene.views[0], neutral=neutral)
    hits = trace_view(scene, stage, scene.views[0], seed=3, effects=effects)
    return ViewRender(stage, scene.views[0], hits, scene.grid.shape, scene.radar.polarizations, effects)


def gradients_of(render: ViewRender, seed: np.ndarray) -> dict[str, np.ndarray]:
    """d (sum of seed * images) to the nodes and to every effect's parameters."""
    render.program.forward()
    render.program.backward({image: seed.ravel().astype(np.float32) for image in render.images.values()})
    effects = {name: values.grad.numpy().astype(float) for name, values in render.effect_values.items()}
    return {"nodes": render.nodes.grad.numpy().astype(float), **effects}


def refusal(name: str, table: dict[str, Any]) -> str:
    """What is said where `street` declares an effect that it should not: one line."""
    with pytest.raises(InputError) as refused:
        check(with_effect(street(), name, table))
    assert "\n" not in str(refused.value)
    return str(refused.value)


def plane(**more: Any) -> Scene:
    """Flat soil that ends well inside an image of 40 x 48 pixels of 0.5 m."""
    more = {"shape": (40, 48), "rays_per_pixel": 16.0} | more
    return scene_of(mesh_of(soil=ground(14.0)), more.pop("views", view(20.0, 40.0)), **more)


def pair(scene: Scene, name: str, table: dict[str, Any], polarization: str = "HH") -> tuple[np.ndarray, np.ndarray]:
    """beta0 of the first view without and with an effect, float64."""
    without = simulate(scene, device="cpu")[0].beta0[polarization]
    return without.astype(float), simulate(with_effect(scene, name, table), device="cpu")[0].beta0[polarization].astype(
        float
    )


def hits_of(scene: Scene, name: str, table: dict[str, Any]) -> tuple[ViewRender, np.ndarray, np.ndarray]:
    """A render with one gain or surface effect, sigma0 of its hits without and with it."""
    render, bare = render_of(with_effect(scene, name, table)), render_of(scene)
    render.forward(), bare.forward()
    return render, bare.sigma["HH"].numpy().astype(float), render.sigma["HH"].numpy().astype(float)


def gains(scene: Scene, name: str, table: dict[str, Any]) -> tuple[np.ndarray, ViewRender]:
    """What happens to the power of each hit, from images in which one hit in ten is left."""
    render, bare = render_of(with_effect(scene, name, table)), render_of(scene)
    found = []
    for one in (render, bare):
        pixel = np.zeros(one.hits.count, np.int32)
        pixel[:] = np.arange(one.hits.count) % (one.shape[0] * one.shape[1])
        # hits of their own: what was derived from the first ones does not go for these
        spread = dataclasses.replace(
            one.hits, pixel=wp.array(pixel, dtype=int, device=one.hits.pixel.device), derived={}
        )
        again = ViewRender(one.stage, one.view, spread, one.shape, tuple(one.images), one._effects)
        found.append(again.forward()["HH"].astype(float).ravel()[: one.hits.count])
    assert render.hits.count <= render.shape[0] * render.shape[1]
    return found[0] / found[1], render
