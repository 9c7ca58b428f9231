"""Intervals by profile likelihood."""

from __future__ import annotations

import numpy as np
import pytest

from warpsar.curves.shape import jump, on_grid, profiles

pytestmark = pytest.mark.unit


def test_a_gaussian_has_its_own_interval() -> None:
    axes = {"a": np.linspace(-3.0, 5.0, 97), "b": np.linspace(-4.0, 4.0, 97)}
    covariance = np.array([[1.0, 0.6], [0.6, 0.5]])
    inverse, middle = np.linalg.inv(covariance), np.array([0.9, -0.3])

    def twice_log(x: dict[str, float]) -> float:
        d = np.array([x["a"], x["b"]]) - middle
        return float(-d @ inverse @ d)

    found = profiles(axes, on_grid(axes, twice_log))
    for k, name in enumerate(axes):
        half = 1.96 * np.sqrt(covariance[k, k])
        # the grid has steps of 0.08: the profile is taken at points of the other axis, and lines are drawn between
        assert found[name].value == pytest.approx(middle[k], abs=0.06)
        assert (found[name].low, found[name].high) == pytest.approx((middle[k] - half, middle[k] + half), abs=0.12)
        assert not found[name].open


def test_jumps_widen_an_interval() -> None:
    rng = np.random.default_rng(0)
    axis = np.linspace(-8.0, 8.0, 201)
    rough = profiles({"a": axis}, -(axis**2) + 2.0 * rng.normal(size=201))["a"]
    smooth = profiles({"a": axis}, -(axis**2))["a"]
    assert jump(2.0 * rng.normal(size=2000)) == pytest.approx(2.0, rel=0.1)
    assert rough.low < smooth.low < -1.9
    assert rough.high > smooth.high > 1.9


def test_what_the_grid_does_not_hold_is_said() -> None:
    axes = {"a": np.linspace(0.0, 1.0, 11)}
    assert profiles(axes, on_grid(axes, lambda x: -0.1 * x["a"]))["a"].open
