"""The power law about its pivot."""

from typing import Any

import numpy as np
import pytest
from effect_worlds import ROUNDING, Case, pair, refusal
from worlds import box, ground, mesh_of, scene_of, view

pytestmark = pytest.mark.unit

WORKING = [
    Case({"exponent": 0.8}),
    Case({"exponent": 0.8, "pivot": 0.02}),
]


@pytest.mark.parametrize("pivot", ["median", 0.02])
@pytest.mark.parametrize("exponent", [0.7, 1.3])
def test_saturation_about_its_pivot(exponent: float, pivot: Any) -> None:
    mesh = mesh_of(soil=ground(14.0), wall=box((-2, -2, 0), (2, 2, 3)))
    scene = scene_of(mesh, view(20.0, 40.0), shape=(41, 47), rays_per_pixel=16.0)
    without, with_it = pair(scene, "saturation", {"exponent": exponent, "pivot": pivot})
    p = np.median(without[without > 0]) if pivot == "median" else pivot
    assert with_it == pytest.approx(p * (without / p) ** exponent, rel=ROUNDING)


def test_a_pivot_of_zero_is_refused() -> None:
    assert 'a positive beta0 or "median"' in refusal("saturation", {"pivot": 0.0})
