"""Tables, learned terms, surfaces and poses in one x: its derivatives, and what taking turns would leave wrong."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import SOIL, ground, mesh_of, scene_of, view

from warpsar import Scene, learn, simulate
from warpsar.learning.device_values import DeviceValues
from warpsar.learning.identify import of_first, of_information
from warpsar.learning.options import LearnOptions
from warpsar.learning.pose import DenseQuadratic, PosedProblem
from warpsar.learning.pose_pixels import compared
from warpsar.learning.pose_search import lit_pixels
from warpsar.learning.problem import FitProblem
from warpsar.learning.sparse_quadratic import SparseQuadratic
from warpsar.learning.table import tables_to_learn
from warpsar.learning.term import with_untrained_terms
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.world import sigma0_table
from warpsar.world.objects.table import Object
from warpsar.world.sigma0_table import Sigma0Table
from warpsar.world.tables import Material

ANGLES = np.arange(20.0, 71.0, 5.0)
GIVEN = Sigma0Table(ANGLES, {"HH": -8.0 - 0.2 * (ANGLES - 20.0)})
TRUE = Sigma0Table(ANGLES, {"HH": GIVEN.sigma0_db["HH"] + 2.5 * np.cos(np.radians(2.0 * ANGLES - 60.0))})
BOX = {"primitive": "box", "name": "box", "size_m": (4.0, 3.0, 2.0), "heading_deg": 20.0, "material": "soil"}
LOOKS = 8.0


def plain(folder: Path) -> Scene:
    """Level ground of the true table in five views."""
    TRUE.write(folder / "true.csv")
    GIVEN.write(folder / "given.csv")
    return scene_of(
        mesh_of(lawn=ground(14.4)),
        [view(70 * k, angle, name=f"v{k}") for k, angle in enumerate((28, 36, 44, 52, 60))],
        shape=(24, 24),
        spacing_m=(0.6, 0.6),
        polarizations=("HH",),
        rays_per_pixel=64.0,
        materials={"lawn": {"model": "facet", "sigma0": folder / "true.csv"}},
    )


def seeing(scene: Scene, truth: Scene, seed: int = 0) -> Scene:
    """The scene with images of the truth, times speckle."""
    random = np.random.default_rng(seed)
    views = []
    for one, clean in zip(truth.views, simulate(truth, device="cpu"), strict=True):
        image = clean.beta0["HH"] * random.gamma(LOOKS, 1 / LOOKS, clean.beta0["HH"].shape)
        views.append(one.model_copy(update={"images": {"HH": image.astype(np.float32)}, "looks": LOOKS}))
    return replace(scene, views=views)


def box_on_lawn(folder: Path, moved: dict[str, Any], table: str, soil: dict[str, Any]) -> Scene:
    lawn = Material(model="facet", sigma0=folder / f"{table}.csv", learn=("sigma0",))
    box = Object.model_validate({**BOX, "position_m": (0.0, 0.0, 0.0), "learn": ("position", "size"), **moved})
    return with_objects(plain(folder), [box], {"lawn": lawn, "soil": Material(**{**SOIL, **soil})})


def begun(folder: Path, device: str) -> FitProblem:
    """A fit of a table, a learned term, a surface's h and the level of a noise floor."""
    truth = box_on_lawn(folder, {"learn": ()}, "true", {})
    start = box_on_lawn(folder, {"learn": ()}, "given", {"learn": ("learned_term",)})
    more = {"lawn": start.materials["lawn"], "soil": start.materials["soil"]}
    scene = seeing(replace(start, materials=more, effects={"noise_floor": {"level": 1e-3}}), truth)
    where = devices.resolve_device(device)
    scene, terms = with_untrained_terms(scene, folder, lambda one: FitProblem(one, where))
    blocks = [one.block(scene, name) for name, one in terms.items()]
    blocks += [one.block(scene, name) for name, one in tables_to_learn(scene, folder / "out", "gamma").items()]
    return FitProblem(scene, where, values=DeviceValues.of(blocks))


def test_x_holds_tables_and_terms_with_their_derivatives(device: str, tmp_path: Path) -> None:
    """The tape's gradient and the Jacobian are those of differences of losses and images, near the start."""
    problem = begun(tmp_path, device)
    assert problem.labels[0] == "noise_floor.level"
    assert problem.labels[problem.of_values.stop - 1] == "lawn.sigma0[HH 10]"
    assert problem.labels[problem.of_values.start] == "soil.learned_term[HH 0]"
    assert problem.x0.size == problem.of_values.stop == len(problem.labels) == problem.bounds[0].size
    random = np.random.default_rng(0)
    x = problem.x0 + 0.1 * random.normal(size=problem.x0.size)
    _, gradient = problem.gradient(x)
    jacobians = problem.jacobian(x)
    for seed in range(3):
        direction = np.random.default_rng(seed).normal(size=x.size)

        def loss(step: float, direction: np.ndarray = direction) -> float:
            return problem.loss_at(x + step * direction)

        def images(step: float, direction: np.ndarray = direction) -> list[np.ndarray]:
            return [np.log(mu) for mu in problem.modelled(x + step * direction)]

        expected = (8 * (loss(0.02) - loss(-0.02)) - (loss(0.04) - loss(-0.04))) / 0.24
        assert float(gradient @ direction) == pytest.approx(expected, rel=2e-3)  # float32 images
        for j, up, down in zip(jacobians, images(0.01), images(-0.01), strict=True):
            np.testing.assert_allclose(j @ direction, (up - down) / 0.02, atol=2e-3 * np.abs(j @ direction).max())


def test_images_follow_the_values_in_whichever_order_they_are_asked_for(device: str, tmp_path: Path) -> None:
    problem = begun(tmp_path, device)
    moved = problem.x0.copy()
    moved[problem.of_values] += 0.5
    first = problem.modelled(problem.x0)
    there = problem.modelled(moved)
    again = problem.modelled(problem.x0)
    for a, b, c in zip(first, there, again, strict=True):
        np.testing.assert_array_equal(a, c)
        assert np.abs(np.log(b / a)).max() > 0.1
    problem.jacobian(moved)
    for a, c in zip(first, problem.modelled(problem.x0), strict=True):
        np.testing.assert_array_equal(a, c)


@pytest.mark.unit
def test_what_is_said_of_the_first_elements_is_their_part_of_the_whole() -> None:
    random = np.random.default_rng(0)
    f, s = (one @ one.T for one in random.normal(size=(2, 5, 9)))
    whole = of_information([f"a.{k}" for k in range(5)], f, s)
    part = of_first(whole, 2, np.zeros((0, 5)))
    np.testing.assert_allclose(part.covariance, whole.covariance[:2, :2], rtol=1e-9)
    assert part.labels == ["a.0", "a.1"]
    np.testing.assert_allclose(np.linalg.inv(part.information), np.linalg.inv(f)[:2, :2], rtol=1e-9)


@pytest.mark.full
def test_a_pose_and_the_table_of_its_ground_are_found_together(tmp_path: Path) -> None:
    """A box starts half a metre off, with a height and an h that are wrong, on ground whose table is 2.5 dB off.

    A table that is fitted first, with the box where it is not, takes up its shadow: it stays wrong by 0.7 dB
    (docs/learn-method.md). Together all come to the truth, within their intervals.
    """
    truth = box_on_lawn(tmp_path, {}, "true", {})
    moved = {"position_m": (0.5, -0.4, 0.0), "size_m": (4.0, 3.0, 2.6)}
    own = {"rms_height_m": 0.0008, "learn": ("rms_height_m",)}
    scene = seeing(box_on_lawn(tmp_path, moved, "given", own), truth)
    found = learn(scene, device="cpu", folder=tmp_path / "out", options=LearnOptions(starts=1))
    assert not found.doubts
    assert found.objects is not None
    told = found.objects.found.objects["box"]
    off = np.array(told["position_m"]) / np.maximum(told["position_sd_m"], 1e-12)
    assert (np.abs(off) < 4.0).all()
    np.testing.assert_allclose(told["position_m"][:2], 0.0, atol=0.05)
    assert found.scene.materials["soil"].rms_height_m == pytest.approx(SOIL["rms_height_m"], rel=0.05)
    table = found.tables["lawn"]
    seen = (ANGLES >= 25) & (ANGLES <= 60)
    errors = (table.found.sigma0_db["HH"] - TRUE.sigma0_db["HH"])[seen]
    assert np.abs(errors).max() < 0.4
    assert (np.abs(errors / table.sd_db["HH"][seen]) < 4.0).all()
    again = sigma0_table.read(table.file)
    np.testing.assert_array_equal(again.sigma0_db["HH"], table.found.sigma0_db["HH"])
    # a number's interval knows that the table is unknown, and has no row of it
    assert found.identified is not None
    assert found.identified.labels == ["soil.rms_height_m"]


def box_on_a_field() -> Scene:
    """A box of known surface, whose place and height start wrong, on a soil whose h is another at each vertex. All its
    nodes start at about half the h: 5 dB too dark. The images are of the truth."""
    mesh = mesh_of(soil=ground(16.0, 8))
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    true = SOIL["rms_height_m"] * np.exp(0.5 * np.sin(0.7 * x) * np.cos(0.6 * y))
    views = [view(70 * k, angle, name=f"v{k}") for k, angle in enumerate((28, 36, 44, 52, 60))]
    field = Material(**{**SOIL, "rms_height_m": "h", "layout": "vertex", "learn": ("rms_height_m",)})
    rock = Material(**{**SOIL, "learn": ()})
    both = []
    for values, moved in (
        (true, {"size_m": (4.0, 3.0, 2.0)}),
        (np.full(len(true), 0.5 * SOIL["rms_height_m"]), {"position_m": (0.5, -0.4, 0.0), "size_m": (4.0, 3.0, 2.6)}),
    ):
        plain = scene_of(
            replace(mesh, vertex_scalars={"h": values}),
            views,
            shape=(24, 24),
            spacing_m=(0.6, 0.6),
            polarizations=("HH",),
            rays_per_pixel=64.0,
            materials={"soil": field.model_dump(exclude_none=True)},
        )
        box = {**BOX, "material": "rock", "position_m": (0.0, 0.0, 0.0), "learn": ("position", "size"), **moved}
        both.append(with_objects(plain, [Object.model_validate(box)], {"soil": field, "rock": rock}))
    truth, start = both
    return seeing(start, truth)


@pytest.mark.full
@pytest.mark.parametrize("blur_m", [0.0, 1.5])
def test_fields_beside_poses_have_the_derivatives_of_the_loss(blur_m: float) -> None:
    """Nodes and poses, or, on blurred images, the field's level and poses: against differences of the loss."""
    scene, cpu = box_on_a_field(), devices.resolve_device("cpu")
    pixels, gains = lit_pixels(scene, cpu, "gamma")
    both = compared(scene, pixels, blur_m, gains)
    problem = PosedProblem(both.scene, cpu, both.observations, smooth=True, forward=blur_m > 0.0)
    x = problem.x0 + 0.02 * np.random.default_rng(1).normal(size=problem.x0.size)
    assert isinstance(problem.quadratic(x, 0.0), DenseQuadratic if blur_m else SparseQuadratic)
    assert ("soil.rms_height_m level" in problem.labels) == (blur_m > 0.0)
    gradient = problem.quadratic(x, problem.value(x)).gradient
    for seed, part in enumerate((slice(0, problem.size), slice(problem.size, None))):
        way = np.zeros(x.size)
        way[part] = np.random.default_rng(seed).normal(size=way[part].size)
        way *= 4e-3 / np.abs(way).max()
        expected = (problem.value(x + way) - problem.value(x - way)) / 2.0
        # poses of blurred images have forward differences, over the step of a pose
        assert float(gradient @ way) == pytest.approx(expected, rel=0.05 if blur_m else 0.02, abs=2e-3)


@pytest.mark.full
def test_a_box_on_a_field_that_starts_wrong_is_found_with_it(tmp_path: Path) -> None:
    """With the field held at its level, the box grew by 11 m to make up for it (docs/learn-method.md)."""
    options = LearnOptions(iterations=100, total_variation={"rms_height_m": 1.0})
    found = learn(box_on_a_field(), device="cpu", folder=tmp_path / "out", options=options)
    assert found.objects is not None
    told = found.objects.found.objects["box"]
    np.testing.assert_allclose(told["position_m"][:2], 0.0, atol=0.06)
    np.testing.assert_allclose(told["size_m"][:2], (4.0, 3.0), atol=0.12)
    assert (np.array(told["size_sd_m"][:2]) < 0.05).all()
    mesh = found.scene.mesh
    own = mesh.vertices[found.scene.parameters["materials.soil.rms_height_m"].used]
    values = found.scene.parameters["materials.soil.rms_height_m"].value
    values = values[found.scene.parameters["materials.soil.rms_height_m"].used]
    true = SOIL["rms_height_m"] * np.exp(0.5 * np.sin(0.7 * own[:, 0]) * np.cos(0.6 * own[:, 1]))
    seen = (np.abs(own).max(axis=1) < 6.0) & (np.abs(own).max(axis=1) > 2.6)
    assert np.sqrt(np.mean(np.log(values / true)[seen] ** 2)) < 0.1
