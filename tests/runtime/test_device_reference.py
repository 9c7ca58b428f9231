"""Every device against numbers made once on the CPU, for machines where only one of the two can run.

Refresh with WARPSAR_REFRESH=1 (CPU only) after a change that is meant to change images, and say why in the commit.
"""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from warpsar.effects.registry import declared, validate
from warpsar.io.images import write_exr
from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.optimise import begin, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate, view_render
from warpsar.simulation.rays import Rays, trace_view
from warpsar.surface.stage import Stage
from warpsar.world.tables import Grid, Sampling

pytestmark = pytest.mark.unit

HERE = Path(__file__).resolve().parents[1]
STORED = HERE / "data" / "cpu_reference.npz"
# What the stored numbers were made with: an effect of each stage that works on bins, paths or pixels.
EFFECTS = {
    "multibounce": {"strength": 0.7, "max_bounces": 3, "reflection": "lobe"},
    "registration": {"range_m": 0.4, "azimuth_m": -0.3},
    "point_spread": {"range_fwhm_m": 2.5, "azimuth_fwhm_m": 3.0, "window": "taylor"},
    "noise_floor": {"level": 1e-3},
}


def small(effects: dict[str, Any] | None = None) -> Scene:
    scene = Scene.load(HERE.parent / "data" / "example" / "scene.toml")
    tables = {name: validate(name, table, name) for name, table in (effects or {}).items()}
    grid = Grid(shape=(40, 40), spacing_m=(1.8, 2.0))
    return replace(scene, grid=grid, sampling=Sampling(rays_per_pixel=36.0), effects=tables)


def computed(device: str, folder: Path) -> dict[str, np.ndarray]:
    """Images with and without effects, merged hits, and the gradient of the likelihood to every parameter."""
    where = devices.resolve_device(device)
    found: dict[str, np.ndarray] = {}
    plain = simulate(small(), device=device)
    for view in plain:
        for pol, beta0 in view.beta0.items():
            found[f"{view.name}_{pol}"] = beta0
    scene = small(EFFECTS)
    stage = Stage.of(scene, where)
    for view in scene.views[:1]:
        hits = trace_view(scene, stage, view, seed=3, effects=declared(scene, view))
        found[f"{view.name}_effects"] = view_render(scene, stage, view, hits).forward()["HH"]
        found[f"{view.name}_hit_weight"] = np.array([hits.count, hits.weight.numpy().astype(float).sum()])
    views = []
    for view, image in zip(scene.views, plain, strict=True):
        speckle = np.random.default_rng(5).gamma(4.0, 0.25, image.beta0["HH"].shape)
        path = folder / f"{view.name}.exr"
        write_exr(path, {"HH": (1.2 * image.beta0["HH"] * speckle).astype(np.float32)})
        views.append(view.model_copy(update={"images": {"HH": path}, "looks": 4.0, "role": "train"}))
    scene = replace(scene, views=views)
    problem = FitProblem(scene, where, rays=Rays(stage, seed=3))
    loss, gradient = problem.gradient(problem.x0)
    found["loss"], found["gradient"] = np.array([loss]), gradient
    state = begin(problem, 0, 0)
    found["loss_after_a_step"] = np.array([levenberg_marquardt(problem, state).loss])
    return found


def test_devices_agree_with_the_stored_numbers(device: str, tmp_path: Path) -> None:
    found = computed(device, tmp_path)
    if os.environ.get("WARPSAR_REFRESH") and device == "cpu":
        np.savez_compressed(STORED, **{k: v.astype(np.float32) for k, v in found.items()})
    with np.load(STORED, allow_pickle=False) as stored:
        assert set(stored.files) == set(found)
        for name in stored.files:
            expected, here = stored[name].astype(float), found[name].astype(float)
            # float32 with other orders of summation, fused multiply-adds and libm: 1e-5 of a pixel's own power; a ray
            # in thousands falls on the other side of an edge, and moves its cell (1/36 pixel) to the neighbour.
            if expected.size <= 2:
                # hits, their sum, the loss; and the loss after a step down a bent valley, which makes some hundred of
                # the gradient's 1e-6. After more steps the two need not be at one place: whether a step is taken or a
                # shorter one tried hangs on a comparison.
                np.testing.assert_allclose(here, expected, rtol=1e-3)
                continue
            scale = np.sqrt(np.mean(expected**2))
            difference = np.abs(here - expected)
            assert np.sqrt(np.mean(difference**2)) < 2e-3 * scale, name
            assert np.median(difference) < 1e-5 * scale, name


@pytest.mark.parametrize("name", ["gradient", "north_HH"])
def test_the_stored_numbers_are_not_trivial(name: str) -> None:
    with np.load(STORED, allow_pickle=False) as stored:
        assert np.count_nonzero(stored[name]) > 0.2 * stored[name].size


@pytest.mark.cuda
def test_the_captured_graph_is_the_host_loop(tmp_path: Path) -> None:
    """Both on CUDA: ten iterations of Adam, one by one from the host and as replays of one graph. Adam divides by the
    gradient's own size, so that the rounding of sums in another order grows to 1e-3 of the ten steps of 0.01."""
    computed("cuda", tmp_path)
    where = devices.resolve_device("cuda")
    scene = small()
    views = [
        view.model_copy(update={"images": {"HH": tmp_path / f"{view.name}.exr"}, "looks": 4.0, "role": "train"})
        for view in scene.views
    ]
    ends = []
    for descent in (Adam, GraphAdam):
        problem = FitProblem(replace(scene, views=views), where)
        state = begin(problem, 0, 0)
        run = descent(problem, state, 0.01)
        while state.iteration < GraphAdam.STRIDE:
            state = run.step(state)
        ends.append(state.x)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-3)
    assert np.abs(ends[0] - problem.x0).max() > 0.05
