"""Which pixels a fit uses (docs/diagnosis-method.md), against the rule written out pixel by pixel."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from learning_scenes import cube_scene, measured, noise_free, views_at
from worlds import ground, mesh_of, scene_of

from warpsar.compare.observation import observe
from warpsar.errors import InputError
from warpsar.io.images import read_channel, write_exr, write_tiff
from warpsar.learning.command import LearnOptions, learn
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.world.pixels import Pixels

pytestmark = pytest.mark.unit

SHAPE = (40, 40)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """A cube with a shadow on a plane that does not fill the image."""
    return measured(cube_scene(views_at((20.0, 55.0)), polarizations=("HH",), shape=40), tmp_path)


def lit_by(scene: Scene) -> np.ndarray:
    problem = FitProblem(scene, devices.resolve_device("cpu"))
    return problem.views[0].render.forward()["HH"] > 0


def by_hand(lit: np.ndarray, measured_image: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    rows, cols = lit.shape
    interior, dark = np.zeros(lit.shape, bool), np.zeros(lit.shape, bool)
    lit_at = np.argwhere(lit)
    zeros = 0
    for i in range(2, rows - 2):
        for j in range(2, cols - 2):
            usable = mask[i, j] and np.isfinite(measured_image[i, j])
            if usable and lit[i - 1 : i + 2, j - 1 : j + 2].all():
                interior[i, j] = measured_image[i, j] > 0
                zeros += measured_image[i, j] == 0
            if usable and np.hypot(*(lit_at - [i, j]).T).min() > 6:
                dark[i, j] = True
    return interior, dark, zeros


def test_less_than_a_trace_in_the_dark_is_nothing(scene: Scene) -> None:
    """The far tail of a response, 70 dB under what is lit, is no power that a model lacks; 50 dB under it, it is."""
    view, lit = scene.views[0], lit_by(scene)
    image = read_channel(view.images["HH"], "HH")
    seen = observe(scene, view, "HH", lit)
    level = float(np.median(image[seen.interior]))
    rows, cols = np.nonzero(seen.dark)
    image[seen.dark] = 1e-7 * level
    image[rows[:9], cols[:9]] = 1e-5 * level
    again = replace(scene, views=[view.model_copy(update={"images": {"HH": Pixels(image)}})])
    found = observe(again, again.views[0], "HH", lit)
    assert np.count_nonzero(found.measured[found.dark]) == 9
    assert found.with_dark().count == seen.count + 9
    np.testing.assert_array_equal(found.values, seen.values)


def test_pixels_by_the_rule(scene: Scene, tmp_path: Path) -> None:
    lit = lit_by(scene)
    assert 0.2 < lit.mean() < 0.9
    view = scene.views[0]
    image = read_channel(view.images["HH"], "HH")
    random = np.random.default_rng(0)
    inside = np.argwhere(lit)
    for value, count in ((0.0, 9), (np.nan, 7), (np.inf, 5)):
        for i, j in random.permutation(inside)[:count]:
            image[i, j] = value
    write_tiff(view.images["HH"], image)
    mask = np.ones(SHAPE)
    mask[25:33, 10:20] = 0.0
    write_exr(tmp_path / "mask.exr", {"Y": mask})
    view = view.model_copy(update={"mask": tmp_path / "mask.exr"})
    found = observe(replace(scene, views=[view]), view, "HH", lit)
    interior, dark, zeros = by_hand(lit, image, mask > 0)
    np.testing.assert_array_equal(found.interior, interior)
    np.testing.assert_array_equal(found.dark, dark)
    assert found.zeros == zeros > 0
    assert found.left_out == 40 * 40 - interior.sum()
    np.testing.assert_array_equal(found.pixels, np.flatnonzero(interior))
    np.testing.assert_array_equal(found.values, image[interior])
    assert dark.any()


@pytest.mark.full
def test_what_is_left_out_changes_nothing_to_the_bit(scene: Scene, tmp_path: Path) -> None:
    """A masked bright target, the edge, the shadow: none of it reaches the fit."""
    view = scene.views[0]
    mask = np.ones(SHAPE)
    mask[15:22, 15:22] = 0.0
    write_exr(tmp_path / "mask.exr", {"Y": mask})
    scene = replace(scene, views=[view.model_copy(update={"mask": tmp_path / "mask.exr"})])
    options = LearnOptions(starts=1)
    before = learn(scene, device="cpu", options=options)
    used = before.problem.observations[0].interior
    image = read_channel(view.images["HH"], "HH")
    image[~used] = np.random.default_rng(1).uniform(0.0, 100.0, np.count_nonzero(~used))
    write_tiff(view.images["HH"], image)
    after = learn(scene, device="cpu", options=options)
    np.testing.assert_array_equal(after.problem.observations[0].interior, used)
    np.testing.assert_array_equal(after.x, before.x)
    assert not used[15:22, 15:22].any()


@pytest.mark.full
def test_a_used_pixel_does_change_the_fit(scene: Scene) -> None:
    view = scene.views[0]
    before = learn(scene, device="cpu", options=LearnOptions(starts=1))
    image = read_channel(view.images["HH"], "HH")
    image.ravel()[before.problem.observations[0].pixels[0]] *= 1.5
    write_tiff(view.images["HH"], image)
    after = learn(scene, device="cpu", options=LearnOptions(starts=1))
    assert (after.x != before.x).any()


def test_looks_are_estimated_where_not_declared(tmp_path: Path) -> None:
    """A plane of 100 x 100 pixels of 9 looks: to 10 %, four standard deviations of an estimate from 9000 pixels."""
    scene = scene_of(mesh_of(ground=ground(200.0)), views_at((0.0, 40.0)), shape=(100, 100), rays_per_pixel=32.0)
    scene = measured(scene, tmp_path, looks=9.0)
    scene = replace(scene, views=[v.model_copy(update={"looks": None}) for v in scene.views])
    (found,) = FitProblem(scene, devices.resolve_device("cpu")).observations
    assert found.looks_estimated
    assert found.looks == pytest.approx(9.0, rel=0.1)


def test_an_image_that_misses_the_mesh_is_refused(scene: Scene) -> None:
    away = replace(scene, reference_point_m=(500.0, 0.0, 0.0))
    with pytest.raises(InputError, match="views v0: no pixel of HH is lit by the model, unmasked and positive"):
        FitProblem(away, devices.resolve_device("cpu"))


def test_nothing_but_zeros_is_refused(scene: Scene) -> None:
    write_tiff(scene.views[0].images["HH"], np.zeros(SHAPE))
    with pytest.raises(InputError, match="no pixel of HH is lit"):
        FitProblem(scene, devices.resolve_device("cpu"))


def test_masks_of_one_model_serve_another(scene: Scene) -> None:
    """Frozen pixels: the same for every model that is compared."""
    first = FitProblem(scene, devices.resolve_device("cpu"))
    frozen = {view.view.name: view.observations for view in first.views}
    lifted = replace(scene, effects={"noise_floor": {"level": 0.01}})
    own = FitProblem(lifted, devices.resolve_device("cpu"))
    shared = FitProblem(lifted, devices.resolve_device("cpu"), observations=frozen)
    assert shared.observations[0] is first.observations[0]
    # noise lights nothing, but the dark pixels tell its level
    lit = own.observations[0].interior & ~own.observations[0].dark
    assert (lit == first.observations[0].interior).all()
    assert len(noise_free(scene)) == 1
