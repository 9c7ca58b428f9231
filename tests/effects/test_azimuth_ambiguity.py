"""Copies in azimuth against the image shifted in NumPy."""

import pytest
from effect_worlds import ROUNDING, Case, pair, plane

pytestmark = pytest.mark.unit

WORKING = [Case({"level": 0.05, "offset_m": 2.9})]


def test_azimuth_ambiguity_is_two_shifted_copies() -> None:
    without, with_it = pair(plane(), "azimuth_ambiguity", {"level": 0.1, "offset_m": 4.75})
    expected = without.copy()
    for pixels, share in ((9, 0.5), (10, 0.5)):  # 4.75 m are 9.5 pixels
        expected[:, pixels:] += 0.1 * share * without[:, :-pixels]
        expected[:, :-pixels] += 0.1 * share * without[:, pixels:]
    assert with_it == pytest.approx(expected, rel=ROUNDING, abs=1e-9)
