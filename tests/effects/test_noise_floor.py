"""The same power in every pixel."""

import pytest
from effect_worlds import Case, pair, plane

WORKING = [Case({"level": 0.003})]


def test_noise_floor_is_everywhere() -> None:
    without, with_it = pair(plane(), "noise_floor", {"level": 0.004})
    assert (without == 0).any()
    assert with_it - without == pytest.approx(0.004, rel=1e-4)
