"""Test images beside the mean of train images that is laid on the ground."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import SOIL, ground, mesh_of, scene_of, view

import warpsar
from warpsar.compare.laid import beside_means, laid_mean
from warpsar.measured.ground import pixel_centres, plane_points
from warpsar.scene.scene import Scene
from warpsar.world.world import geometry_of

AZIMUTHS = (88.0, 91.0, 93.0)
LOOKS = 4.0


def field(points: np.ndarray) -> np.ndarray:
    """Power of even ground with soft stripes along north."""
    return 1.0 + 0.8 * np.sin(points[..., 0] / 3.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Two train views and a test view of the stripes, which the scene's own ground does not have."""
    views = [view(azimuth, 45, name=f"v{k}") for k, azimuth in enumerate(AZIMUTHS)]
    plain = scene_of(mesh_of(g=ground(60)), views, shape=(60, 60), spacing_m=(0.5, 0.5), materials={"g": SOIL})
    random, centres = np.random.default_rng(0), pixel_centres((60, 60), (0.5, 0.5), (1, 1))
    seen = []
    for k, one in enumerate(views):
        power = field(plane_points(geometry_of(plain, one), np.zeros(3), *centres))
        image = (power * random.gamma(LOOKS, 1.0 / LOOKS, power.shape)).astype(np.float32)
        role = "test" if k == 2 else "train"
        seen.append(one.model_copy(update={"images": {"HH": image}, "looks": LOOKS, "role": role}))
    return replace(plain, views=seen, grid=plain.grid.model_copy(update={"calibrated": False}))


def test_the_mean_lies_where_the_ground_does(scene: Scene) -> None:
    """What both train views say of a pixel is the stripe under it: speckle of twice the looks is left, or less by the
    interpolation, which averages up to four pixels."""
    images = warpsar.evaluate(scene, device="cpu").images
    found = laid_mean(scene, images[:2], scene.views[2])
    points = plane_points(geometry_of(scene, scene.views[2]), np.zeros(3), *pixel_centres((60, 60), (0.5, 0.5), (1, 1)))
    inside = np.isfinite(found)
    assert 0.8 < inside.mean() < 1.0  # a corner of one image lies outside of another
    ratio = found[inside] / field(points)[inside]
    assert ratio.mean() == pytest.approx(1.0, abs=0.02)
    assert 1.0 / (8.0 * LOOKS) < ratio.var() < 1.0 / (2.0 * LOOKS)


def test_a_mean_that_knows_more_than_the_model_is_ahead(scene: Scene) -> None:
    """Even ground cannot follow stripes. Their mean over 3 x 3 pixels is within the speckle of its 18 pixels."""
    images = warpsar.evaluate(scene, device="cpu").images
    (found,) = beside_means(scene, {"model": images})
    assert found.view == "v2"
    assert found.deviances["mean_3x3"] == pytest.approx(1.0, abs=0.12)
    assert found.deviances["mean_3x3"] < found.deviances["mean"] < found.deviances["model"]
    assert found.ahead < -3.0 * found.error
    assert found.pixels > 2500
    turned = replace(scene, views=[*scene.views[:2], scene.views[2].model_copy(update={"azimuth_deg": 120.0})])
    assert beside_means(turned, {"model": warpsar.evaluate(turned, device="cpu").images}) == []
