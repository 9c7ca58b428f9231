"""What images that are blurred for a search hold: the power of the sharp ones, wherever it comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from worlds import SOIL, box, ground, mesh_of, scene_of, view

from warpsar.differentiable.geometry import exact_images
from warpsar.effects.registry import validate
from warpsar.learning.pose_pixels import compared
from warpsar.runtime import devices
from warpsar.scene.scene import Scene

CPU = devices.resolve_device("cpu")
BLUR_M = 2.0
WALL = {"eps_r": 1e6, "rms_height_m": 0.0005, "correlation_length_m": 0.05}


def corner(response: dict[str, object]) -> Scene:
    """A metal wall that faces the radar on smooth ground: nearly all power is in the corner at its foot."""
    mesh = mesh_of(ground=ground(40), wall=box((-1.0, -3.0, 0.0), (1.0, 3.0, 4.0)))
    scene = scene_of(
        mesh,
        [view(0.0, 40.0, name="v0")],
        shape=(64, 64),
        spacing_m=(0.5, 0.5),
        materials={"ground": SOIL, "wall": WALL},
    )
    tables = {"multibounce": {"strength": 1.0}, "noise_floor": {"level": 1e-9}, **response}
    return replace(scene, effects={name: validate(name, table, name) for name, table in tables.items()})


@pytest.mark.parametrize(
    "response", [{}, {"point_spread": {"range_fwhm_m": 0.8, "azimuth_fwhm_m": 0.7, "window": "taylor"}}]
)
def test_a_blur_makes_no_corner_brighter(response: dict[str, object]) -> None:
    """Fields of a corner add up in the radar's cell. In a cell as wide as the blur, its power would be several times as
    much. 1 %: of a kernel that is cut off at the image's border, and of rounding."""
    scene = corner(response)
    sharp = exact_images(scene, CPU)["v0"]["HH"].astype(float)
    without = exact_images(replace(scene, effects=response_only(scene)), CPU)["v0"]["HH"].astype(float)
    assert sharp.sum() > 5.0 * without.sum()
    blurred = exact_images(compared(scene, {}, BLUR_M, {}).scene, CPU)["v0"]["HH"].astype(float)
    np.testing.assert_allclose(blurred.sum(), sharp.sum(), rtol=0.01)
    assert blurred.max() < 0.5 * sharp.max()


def response_only(scene: Scene) -> dict[str, dict[str, object]]:
    return {name: table for name, table in scene.effects.items() if name != "multibounce"}
