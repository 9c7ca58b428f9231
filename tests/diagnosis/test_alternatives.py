"""Which measurement tells two explanations apart: closed forms on level ground."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from warpsar.diagnosis.alternatives import _of_another_date, deciding
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, View

pytestmark = pytest.mark.unit

LOOKS = 4.0
SHAPE, STEP_M = (24, 20), 0.5
INCIDENCES_DEG = (35.0, 45.0)


@pytest.fixture(scope="module")
def device() -> wp.Device:
    return wp.get_device("cpu")


def scene(effects: dict) -> Scene:
    """Level ground far beyond the image: beta0 is the same in every pixel."""
    corners = np.array([[-60, -60, 0], [60, -60, 0], [60, 60, 0], [-60, 60, 0]], float)
    return Scene(
        mesh=Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.zeros(2, np.int32), ("ground",)),
        radar=Radar(frequency_hz=9.6e9, polarizations=("HH", "VV")),
        grid=Grid(shape=SHAPE, spacing_m=(STEP_M, STEP_M)),
        materials={"ground": Material(eps_r=6.0, rms_height_m=0.0012, correlation_length_m=0.01)},
        views=[
            View(name=f"v{i}", azimuth_deg=90.0 * i, incidence_deg=at, role="train")
            for i, at in enumerate(INCIDENCES_DEG)
        ],
        effects=effects,
    )


def test_distance_of_a_loss_in_range(device: wp.Device) -> None:
    """exp(-g r): the difference of the logarithms is g r, and its variance over n rows is (n^2 - 1) / 12 steps^2."""
    loss = 0.03
    rows, cols = SHAPE
    expected = LOOKS * cols * rows * (loss * STEP_M) ** 2 * (rows**2 - 1) / 12.0
    found = deciding(scene({"range_loss": {"per_m": loss}}), scene({}), LOOKS, device)
    # every extra image has the same rows; float32 images, sampled at the middle of each pixel
    assert found.all == pytest.approx(dict.fromkeys(found.all, expected), rel=1e-2)
    assert found.decides == (expected > 16.0)
    assert "range_loss" in found.sentence


def test_a_gain_of_all_pixels_tells_nothing(device: wp.Device) -> None:
    """Two surfaces of level ground differ by a gain alone, which is free."""
    other = scene({})
    rougher = other.materials["ground"].model_copy(update={"rms_height_m": 0.0015})
    other.materials["ground"] = rougher
    found = deciding(scene({}), other, LOOKS, device)
    assert found.distance < 1e-3
    assert not found.decides


def test_gains_of_single_views_do_not_come_again(device: wp.Device) -> None:
    """Two views, +g and -g dB: half their pixels lie g above the mean, half below."""
    gain_db = 1.5
    one = scene({"view_gain": {"gain_db": {"v0": gain_db, "v1": -gain_db}}})
    expected = LOOKS * 2 * np.prod(SHAPE) * (gain_db * np.log(10.0) / 10.0) ** 2
    assert _of_another_date(one, LOOKS, device) == pytest.approx(expected, rel=1e-3)
    found = deciding(one, scene({"range_loss": {"per_m": 0.001}}), LOOKS, device)
    assert found.measurement == "the same views on another date"
    assert found.distance == pytest.approx(expected, rel=1e-3)
