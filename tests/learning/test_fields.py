"""Standard deviations of parameter fields against Jacobians by brute force, node by node."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning_scenes import bumpy, measured, views_at
from worlds import SOIL, plate, scene_of

from warpsar.io.images import read_channel, write_exr
from warpsar.learning.fields import field_uncertainty, node_weights
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.surface.samples import image_pixels
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Material

pytestmark = pytest.mark.unit

KEYS = ("eps_r", "rms_height_m")


def written(problem: FitProblem, x: np.ndarray, folder: Path) -> dict[str, Any]:
    """The fields' uncertainty, in files of a folder; its summary."""
    return {name: one.write(folder) for name, one in field_uncertainty(problem, x).items()}


def scene_with_fields(layout: str, folder: Path, effects: dict[str, Any] | None = None, **more: Any) -> Scene:
    """Tilted facets, eps_r and h as fields of 4 x 4 texels or 25 vertices, two views of 16 looks; one corner of the
    surface lies outside the images."""
    views = views_at((10.0, 40.0), (120.0, 50.0))
    mesh = bumpy(size=6.0)
    scene = scene_of(mesh, views, shape=(14, 14), spacing_m=(0.4, 0.4), polarizations=("HH", "VV"), rays_per_pixel=32.0)
    values: dict[str, Any] = {"eps_r": "eps", "rms_height_m": "h"}
    if layout == "texture":
        random = np.random.default_rng(4)
        for key, number in (("eps_r", 6.0), ("rms_height_m", 0.001)):
            values[key] = str(folder / f"start_{key}.exr")
            write_exr(values[key], {key: number * random.uniform(0.8, 1.25, (4, 4))})
    material = Material(**{**SOIL, **values, "layout": layout, "learn": KEYS})
    scene = replace(scene, materials={"soil": material}, effects=effects or {}, reference_point_m=(0.8, 0.8, 0.0))
    return measured(scene, folder, **more)


def brute_force(problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
    """sd, shape (nodes, kinds), and views per node, from d ln(mu) of every node."""
    jacobian = problem.jacobian(problem.x0)
    size = problem.x0.size // 2
    information = np.zeros((size, 2, 2))
    seen_in: dict[str, np.ndarray] = {}
    for seen, j in zip(problem.observations, jacobian, strict=True):
        both = j.reshape(len(j), 2, size)
        information += seen.looks * np.einsum("pan,pbn->nab", both, both)
        lit = (np.abs(j) > 1e-4).any(axis=0).reshape(2, size).any(axis=0)
        seen_in[seen.view.name] = seen_in.get(seen.view.name, np.zeros(size, bool)) | lit
    sd = np.full((size, 2), np.inf)
    for node, block in enumerate(information):
        if np.linalg.eigvalsh(block)[0] > 1e-6 * np.linalg.eigvalsh(block)[1]:
            sd[node] = np.sqrt(np.diag(np.linalg.inv(block)))
    return sd, np.sum(list(seen_in.values()), axis=0)


def read_back(layout: str, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    sds, views = [], []
    for key in KEYS:
        if layout == "texture":
            sds.append(read_channel(folder / f"soil_{key}_sd.exr", "sd").ravel())
            views.append(read_channel(folder / f"soil_{key}_sd.exr", "views").ravel())
        else:
            columns = np.load(folder / f"soil_{key}_sd.npy")
            sds.append(columns[:, 0])
            views.append(columns[:, 1])
    np.testing.assert_array_equal(views[0], views[1])
    return np.stack(sds, 1), views[0]


@pytest.mark.parametrize("effects", [{}, {"noise_floor": {"level": 0.002}}, {"antenna_pattern": {"beamwidth_m": 6.0}}])
@pytest.mark.parametrize("layout", ["texture", "vertex"])
def test_uncertainty_is_that_of_the_jacobian(layout: str, effects: dict[str, Any], tmp_path: Path, device: str) -> None:
    """1 %: the brute force differences float32 images over 0.01. A node that a single hit grazes, with a weight of
    1e-4, is seen by one and not by the other; so nodes count that are known to better than a factor e^3."""
    scene = scene_with_fields(layout, tmp_path, {})
    problem = FitProblem(replace(scene, effects=effects), devices.resolve_device(device))
    if problem.effect_coordinates:  # the brute force is that of the surface's nodes alone
        problem.effect_coordinates = []
        problem.x0 = problem.x0[: problem.learned.size]
    summary = written(problem, problem.x0, tmp_path)
    expected, views = brute_force(problem)
    sd, seen_in = read_back(layout, tmp_path)
    known = expected.max(axis=1) < 3.0
    assert known.sum() > 0.6 * len(known)
    np.testing.assert_allclose(sd[known], expected[known], rtol=0.01)
    np.testing.assert_array_equal(seen_in[known], views[known])
    assert (sd[~known].max(axis=1) > 2.9).all()
    for index, key in enumerate(KEYS):
        said = summary[f"soil.{key}"]
        assert said["nodes"] == len(sd)
        assert said["seen"] == np.count_nonzero(seen_in)
        assert said["determined"] == np.count_nonzero(sd[:, index] < 0.5)


def test_a_node_that_no_pixel_sees_is_infinite(tmp_path: Path) -> None:
    """Texels over a corner that no view looks at; views counted, 0 of them."""
    scene = scene_with_fields("texture", tmp_path)
    views = [v.model_copy(update={"mask": tmp_path / "mask.exr"}) for v in scene.views]
    mask = np.zeros((14, 14))
    mask[:, :5] = 1.0
    write_exr(tmp_path / "mask.exr", {"Y": mask})
    problem = FitProblem(replace(scene, views=views[:1]), devices.resolve_device("cpu"))
    written(problem, problem.x0, tmp_path)
    sd, seen_in = read_back("texture", tmp_path)
    assert 0 < np.count_nonzero(seen_in) < 16
    assert np.isinf(sd[seen_in == 0]).all()
    assert set(np.unique(seen_in)) == {0.0, 1.0}


def test_one_polarization_cannot_tell_two_parameters(tmp_path: Path) -> None:
    """A node lit at one angle alone: eps_r and h are one number, and both deviations infinite. The facets are one
    plane here, and of one material to begin with."""
    vertices, faces = plate((-3, -3, 0), (6, 0, 0), (0, 6, 0), 2)
    uv = (vertices[:, :2] / 6 + 0.5).astype(np.float32)
    mesh = Mesh(vertices, faces.astype(np.int32), np.zeros(len(faces), np.int32), ("soil",), uv)
    scene = scene_with_fields("texture", tmp_path)
    for key, number in (("eps_r", 6.0), ("rms_height_m", 0.001)):
        write_exr(tmp_path / f"start_{key}.exr", {key: np.full((4, 4), number)})
    views = [v.model_copy(update={"images": {"HH": v.images["HH"]}}) for v in scene.views[:1]]
    problem = FitProblem(replace(scene, mesh=mesh, views=views), devices.resolve_device("cpu"))
    written(problem, problem.x0, tmp_path)
    sd, seen_in = read_back("texture", tmp_path)
    assert seen_in.max() == 1
    assert np.isinf(sd).all()


@pytest.mark.parametrize("layout", ["texture", "vertex"])
def test_weights_add_up_to_one(layout: str, tmp_path: Path) -> None:
    problem = FitProblem(scene_with_fields(layout, tmp_path), devices.resolve_device("cpu"))
    block = problem.surface.block("soil", "eps_r")
    for index, view in enumerate(problem.views):
        weights = node_weights(problem, block, index)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
        # the kernel's own interpolation, float32
        problem.modelled(problem.x0)
        nodes = problem.x0[: block.size]
        np.testing.assert_allclose(weights @ nodes, view.render.zeta.numpy()[:, 0], atol=1e-5)


def test_hits_in_finer_bins_fall_into_their_pixels(tmp_path: Path) -> None:
    """A declared registration error has hits binned finer than the image, with a margin; moved by nothing, each lies
    in the pixel where it lay."""
    scene = scene_with_fields("texture", tmp_path)
    plain = FitProblem(scene, devices.resolve_device("cpu"))
    moved = FitProblem(
        replace(scene, effects={"registration": {"range_m": 0.0, "azimuth_m": 0.0}}), devices.resolve_device("cpu")
    )
    for index in range(2):
        assert moved.views[index].render.hits.grid.shape != plain.views[index].render.hits.grid.shape
        fine, coarse = moved.views[index].render.shaded, plain.views[index].render.shaded
        pixel = image_pixels(fine, scene.grid.shape)
        inside = pixel >= 0
        np.testing.assert_array_equal(image_pixels(coarse, scene.grid.shape), coarse.pixel.numpy())
        found = np.bincount(pixel[inside], fine.weight.numpy()[inside], 14 * 14)
        expected = np.bincount(coarse.pixel.numpy(), coarse.weight.numpy(), 14 * 14)
        # a ray's footprint is shared out among finer bins: what crosses a pixel's edge differs by its sampling
        np.testing.assert_allclose(found.sum(), expected.sum(), rtol=0.02)
        assert np.corrcoef(found, expected)[0, 1] > 0.99
    written(moved, moved.x0, tmp_path)
    sd, _ = read_back("texture", tmp_path)
    written(plain, plain.x0, tmp_path)
    expected_sd, _ = read_back("texture", tmp_path)
    known = expected_sd.max(axis=1) < 1.0
    # a node at the interior's edge has few hits, and their pixels are those a footprint's share falls into
    ratio = sd[known] / expected_sd[known]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)
    assert (np.abs(np.log(ratio)) < 0.3).all()


def test_names_that_no_file_may_have(tmp_path: Path) -> None:
    scene = scene_with_fields("texture", tmp_path)
    mesh = replace(scene.mesh, materials=("wall/north side",))
    scene = replace(scene, mesh=mesh, materials={"wall/north side": scene.materials["soil"]})
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    found = learned_scene(problem, problem.x0, tmp_path)
    written(problem, problem.x0, tmp_path)
    assert Path(str(found.materials["wall/north side"].eps_r)).name == "wall_north_side_0_eps_r.exr"
    assert (tmp_path / "wall_north_side_0_eps_r_sd.exr").exists()
