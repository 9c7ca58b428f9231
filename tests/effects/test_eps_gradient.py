"""Permittivity across the scene against sigma0 in closed form."""

import numpy as np
import pytest
import worlds
from effect_worlds import ROUNDING, Case, hits_of, plane

pytestmark = pytest.mark.unit

WORKING = [Case({"per_m_east": 0.03, "per_m_north": -0.02})]


def test_eps_gradient_is_zero_at_the_reference_point() -> None:
    scene = plane()
    render, _, with_it = hits_of(scene, "eps_gradient", {"per_m_east": 0.05, "per_m_north": -0.03})
    x = render.hits.point.numpy().astype(float)
    eps = 1 + 5.0 * np.exp(0.05 * x[:, 0] - 0.03 * x[:, 1])
    assert with_it == pytest.approx(worlds.sigma0(np.deg2rad(40.0), eps_r=eps), rel=ROUNDING)
