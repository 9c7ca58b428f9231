"""The water-cloud model in closed form."""

import numpy as np
import pytest
from effect_worlds import ROUNDING, Case, hits_of, plane

pytestmark = pytest.mark.unit

WORKING = [Case({"optical_depth": 0.2, "albedo": 0.1})]


def test_vegetation_is_a_water_cloud() -> None:
    _, without, with_it = hits_of(plane(), "vegetation", {"optical_depth": 0.2, "albedo": 0.1})
    cos = np.cos(np.deg2rad(40.0))
    t = np.exp(-0.4 / cos)
    assert with_it == pytest.approx(0.1 * cos * (1 - t) + t * without, rel=ROUNDING)
