"""The Jacobian of a fit, in forward mode, against differences of images."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import cases_of, street, with_effect, working
from learning_scenes import measured
from test_fields import scene_with_fields

from warpsar.errors import InputError
from warpsar.learning.optimise import begin, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.world.tables import Material

WORKING = working()
IDS = [f"{name}-{'-'.join(map(str, table.values()))}"[:60] for name, table, _ in WORKING]
LEARN = ("eps_r", "rms_height_m", "correlation_length_m")
PAIRS = [
    ({"point_spread": {"range_fwhm_m": 1.1, "azimuth_fwhm_m": 0.9}}, {"noise_floor": {"level": 0.002}}),
    ({"point_spread": {"range_fwhm_m": 1.1, "azimuth_fwhm_m": 0.9}}, {"saturation": {"exponent": 0.7}}),
    ({"multibounce": {"strength": 1.0}}, {"range_loss": {"per_m": 0.03}}),
    ({"multibounce": {"strength": 1.0}}, {"registration": {"range_m": 0.31, "azimuth_m": -0.17}}),
    ({"multibounce": {"strength": 1.0}}, {"eps_gradient": {"per_m_east": 0.03, "per_m_north": 0.01}}),
    ({"registration": {"range_m": 0.31, "azimuth_m": -0.17}}, {"azimuth_ambiguity": {"level": 0.1, "offset_m": 3.1}}),
    ({"two_scale": {"slope_variance": 0.02}}, {"vegetation": {"optical_depth": 0.3, "albedo": 0.05}}),
    ({"exponential_spectrum": {"weight": 0.5}}, {"antenna_pattern": {"beamwidth_m": 20.0, "boresight_m": 2.0}}),
    ({"edge_diffraction": {"strength": 3.0}}, {"view_gain": {"gain_db": {"v0": 1.0, "v1": -1.0}}}),
]


CUDA = [
    {"multibounce": {"strength": 1.0}, "point_spread": {"range_fwhm_m": 1.1, "azimuth_fwhm_m": 0.9}},
    {"registration": {"range_m": 0.31, "azimuth_m": -0.17}, "view_gain": {"gain_db": {"v0": 1.0, "v1": -1.0}}},
    {"two_scale": {"slope_variance": 0.02}, "saturation": {"exponent": 0.7, "pivot": 0.05}},
]


def learning(scene: Scene, folder: Path, polarizations: tuple[str, ...] = ("HH", "VV")) -> FitProblem:
    """`scene` with images of its own, and every parameter of both materials learned, tau on the way to 1."""
    materials = {
        name: Material(**{**material.model_dump(), "learn": (*LEARN, "specular_fraction"), "specular_fraction": 0.3})
        for name, material in scene.materials.items()
    }
    radar = scene.radar.model_copy(update={"polarizations": polarizations})
    return FitProblem(measured(replace(scene, materials=materials, radar=radar), folder), devices.resolve_device("cpu"))


def differences(problem: FitProblem, x: np.ndarray) -> list[np.ndarray]:
    """d ln(mu) / dx by central differences over 0.02 and 0.04, extrapolated: what is left is of the fourth order."""
    found = []
    for column in range(x.size):
        slopes = []
        for step in (0.02, 0.04):
            ends = []
            for sign in (1.0, -1.0):
                at = x.copy()
                at[column] += sign * step
                ends.append(problem.modelled(at))
            slopes.append([np.log(a / b) / (2.0 * step) for a, b in zip(*ends, strict=True)])
        found.append([(4.0 * near - far) / 3.0 for near, far in zip(*slopes, strict=True)])
    return [np.stack(columns, axis=1) for columns in zip(*found, strict=True)]


def hold_together(problem: FitProblem, x: np.ndarray, tolerance: float = 3e-4) -> None:
    """Nodes against extrapolated differences; effects' parameters against those that they are, of full images.

    `tolerance`: float32 images are good to 1e-7 to 1e-6, which is 1e-5 to 1e-4 of a derivative over 0.02.
    """
    nodes = problem.learned.size
    before = problem.modelled(x)
    found, expected, plain = problem.jacobian(x), differences(problem, x), problem._differences(x, range(x.size))
    for one, other, same in zip(found, expected, plain, strict=True):
        assert one.shape == other.shape
        np.testing.assert_allclose(one[:, :nodes], other[:, :nodes], rtol=0, atol=tolerance)
        np.testing.assert_allclose(one[:, nodes:], same[:, nodes:], rtol=0, atol=1e-12)  # of the same images
    assert np.abs(found[0][:, :nodes]).max() > 0.1
    for one, other in zip(problem.jacobian(x), found, strict=True):  # whatever was run before
        np.testing.assert_array_equal(one, other)
    for one, other in zip(problem.modelled(x), before, strict=True):  # and images come out the same after it
        np.testing.assert_array_equal(one, other)


@pytest.mark.full
@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_every_effect(name: str, table: dict[str, Any], radar: Mapping[str, Any], tmp_path: Path) -> None:
    problem = learning(with_effect(street(**radar), name, table), tmp_path)
    hold_together(problem, problem.x0)


@pytest.mark.full
@pytest.mark.parametrize("pair", PAIRS, ids=["+".join(k for one in pair for k in one) for pair in PAIRS])
def test_pairs_of_effects(pair: tuple[dict[str, Any], ...], tmp_path: Path) -> None:
    scene = street()
    for one in pair:
        for name, table in one.items():
            scene = with_effect(scene, name, table)
    problem = learning(scene, tmp_path)
    # a median jumps from pixel to pixel: differences over 0.01 and 0.02 see other jumps
    hold_together(problem, problem.x0, 1e-2 if "saturation" in scene.effects else 3e-4)


@pytest.mark.parametrize("name", ["multibounce", "two_scale", "vegetation", "edge_diffraction"])
def test_cross_polarizations(name: str, tmp_path: Path) -> None:
    """Effects that do not act in HV, or in another way."""
    scene = with_effect(street(), name, next(case.table for case in cases_of(name)))
    problem = learning(scene, tmp_path, ("HV", "VV", "VH"))
    hold_together(problem, problem.x0)


def test_columns_and_bounds(tmp_path: Path) -> None:
    """Some columns alone, an element on its bound, and gains that are unknown."""
    problem = learning(with_effect(street(), "noise_floor", {"level": 0.002}), tmp_path)
    x = problem.x0.copy()
    whole = problem.jacobian(x)
    for one, other in zip(problem.jacobian(x, [8, 1, 5]), whole, strict=True):
        np.testing.assert_array_equal(one, other[:, [8, 1, 5]])
    moving = np.arange(x.size) % 2 == 0
    for one, other in zip(problem.linearised(x, moving)[1], whole, strict=True):
        np.testing.assert_array_equal(one, np.where(moving, other, 0.0))
    x[1] = problem.bounds[1][1]
    beside = x - 1e-3 * (np.arange(x.size) == 1)
    for one, other in zip(problem.jacobian(x), problem.jacobian(beside), strict=True):
        np.testing.assert_allclose(one[:, 1], other[:, 1], atol=0.02)


@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: "-".join(name for one in pair for name in one))
def test_images_that_stand_are_not_made_again(pair: tuple[dict[str, Any], ...], tmp_path: Path) -> None:
    """Where the last run was at x, or at its surface, the Jacobian is to the bit that of a run that makes all anew; so
    are images after it."""
    scene = street()
    for one in pair:
        for name, table in one.items():
            scene = with_effect(scene, name, table)
    problem = learning(scene, tmp_path)
    x = problem.x0 + 0.01
    beside = x.copy()
    beside[problem.learned.size :] -= 0.02  # effects alone
    elsewhere = problem.modelled(x + 0.01)
    problem.gradient(x)  # after which no image stands
    expected = problem.jacobian(x)
    for before in (x, beside):
        problem.modelled(before)
        for one, other in zip(problem.jacobian(x), expected, strict=True):
            np.testing.assert_array_equal(one, other)
    for mu, other in zip(problem.modelled(x + 0.01), elsewhere, strict=True):
        np.testing.assert_array_equal(mu, other)


def test_unknown_gains_are_projected_out(tmp_path: Path) -> None:
    scene = learning(street(), tmp_path).scene
    scene = replace(scene, grid=scene.grid.model_copy(update={"calibrated": False}))
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    weights = [c.weight for c in problem.curvatures(problem.modelled(problem.x0))]
    plain = differences(problem, problem.x0)
    for one, other, weight in zip(problem.jacobian(problem.x0), plain, weights, strict=True):
        np.testing.assert_allclose(one, other - np.average(other, axis=0, weights=weight), atol=3e-4)


@pytest.mark.full
@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"multibounce": {"strength": 1.0}},
        {"registration": {"range_m": 0.11, "azimuth_m": -0.07}},
        {"point_spread": {"range_fwhm_m": 0.8, "azimuth_fwhm_m": 0.6}, "noise_floor": {"level": 0.002}},
        {"antenna_pattern": {"beamwidth_m": 6.0}, "azimuth_ambiguity": {"level": 0.1, "offset_m": 1.3}},
    ],
    ids=lambda effects: "+".join(effects) or "none",
)
@pytest.mark.parametrize("layout", ["texture", "vertex"])
def test_fields_sparse_and_dense(layout: str, effects: dict[str, Any], tmp_path: Path) -> None:
    """`sparse_jacobian` against differences of images, node by node; it leaves out 1e-6 of a column's largest."""
    scene = scene_with_fields(layout, tmp_path, {})
    for name, table in effects.items():
        scene = with_effect(scene, name, table)
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    nodes = problem.learned.size
    sparse, dense = problem.sparse_jacobian(problem.x0), problem.jacobian(problem.x0)
    for one, other, plain in zip(sparse, dense, problem._differences(problem.x0, range(nodes)), strict=True):
        assert one.shape == other.shape
        assert one.nnz < 0.7 * one.shape[0] * nodes
        np.testing.assert_allclose(one.toarray()[:, :nodes], plain, atol=3e-4)
        np.testing.assert_allclose(one.toarray()[:, :nodes], other[:, :nodes], atol=1e-4)  # where mu is dark
        assert one[:, nodes:].nnz == 0


@pytest.mark.full
def test_hits_that_are_not_at_hand(tmp_path: Path) -> None:
    """Bands: differences of images for the Jacobian, and a plain refusal of the sparse one."""
    scene = learning(street(), tmp_path).scene
    banded = FitProblem(scene, devices.resolve_device("cpu"), max_memory_gib=1e-9)
    kept = FitProblem(scene, devices.resolve_device("cpu"))
    assert banded.bands
    for one, other in zip(banded.jacobian(kept.x0), kept.jacobian(kept.x0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-3)  # truncation over 0.01
    with pytest.raises(InputError, match="max-memory"):
        banded.sparse_jacobian(kept.x0)


@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("loss", ["gamma", "mse", "log"])
def test_the_jacobian_gives_the_gradient(loss: str, calibrated: bool, tmp_path: Path) -> None:
    """-sum(weight * residual * d ln mu) is what the adjoint finds: to 1e-3 of the largest, where the effect's parameter
    is a difference over 0.01."""
    scene = learning(with_effect(street(), "noise_floor", {"level": 0.002}), tmp_path).scene
    scene = replace(scene, grid=scene.grid.model_copy(update={"calibrated": calibrated}))
    problem = FitProblem(scene, devices.resolve_device("cpu"), loss=loss)
    assert problem.slopes_tell_all
    x = problem.x0 + 0.05
    modelled, jacobians = problem.linearised(x)
    pairs = zip(jacobians, problem.curvatures(modelled), strict=True)
    found = -sum(j.T @ (c.weight * c.residual) for j, c in pairs)
    expected = problem.gradient(x)[1]
    np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
    for one, other in zip(modelled, problem.modelled(x), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.cuda
@pytest.mark.parametrize("effects", CUDA, ids="+".join)
def test_cuda_is_the_cpu(effects: dict[str, dict[str, Any]], tmp_path: Path) -> None:
    """Dense and sparse Jacobian and a step of the fit; float32 images differ by 1e-6, differences over 0.02 by 1e-4."""
    scene = street()
    for name, table in effects.items():
        scene = with_effect(scene, name, table)
    kept = learning(scene, tmp_path)
    seen = {view.view.name: view.observations for view in kept.views}
    other = FitProblem(kept.scene, devices.resolve_device("cuda"), observations=seen)
    for kind in ("jacobian", "sparse_jacobian"):
        for one, two in zip(getattr(kept, kind)(kept.x0), getattr(other, kind)(kept.x0), strict=True):
            one, two = (j if isinstance(j, np.ndarray) else j.toarray() for j in (one, two))
            np.testing.assert_allclose(two, one, atol=2e-3)
    ends = [levenberg_marquardt(problem, begin(problem, 0, 0)) for problem in (kept, other)]
    assert ends[1].loss == pytest.approx(ends[0].loss, rel=1e-4)
