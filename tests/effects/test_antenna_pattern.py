"""The beam against its closed form, in a plane wave and in a strip-map."""

import math
from typing import Any

import numpy as np
import pytest
from effect_worlds import ROUNDING, STRIP_MAP, Case, gains, plane, refusal, render_of, street, with_effect

from warpsar.effects.base.trial import Context
from warpsar.effects.registry import declared, get

pytestmark = pytest.mark.unit

WORKING = [
    Case({"beamwidth_m": 20.0, "boresight_m": 2.0}),
    Case({"beamwidth_deg": 3.0, "boresight_deg": 0.4}, STRIP_MAP),
]


def test_antenna_in_a_plane_wave() -> None:
    gain, render = gains(plane(), "antenna_pattern", {"beamwidth_m": 15.0, "boresight_m": 2.0})
    x = render.hits.point.numpy().astype(float) @ render.geometry.v
    assert gain == pytest.approx(np.exp(-4 * np.log(2) * (x - 2.0) ** 2 / 15.0**2) ** 2, rel=ROUNDING)
    # one way the power is half at half the width
    assert np.exp(-4 * np.log(2) * 7.5**2 / 15.0**2) == pytest.approx(0.5)


def test_antenna_in_a_strip_map() -> None:
    gain, render = gains(plane(slant_range_m=200.0), "antenna_pattern", {"beamwidth_deg": 4.0, "boresight_deg": -0.5})
    x = render.hits.point.numpy().astype(float)
    track = x - (x @ render.geometry.u)[:, None] * render.geometry.u + 200.0 * render.geometry.d
    phi = np.rad2deg(np.arctan2(track @ render.geometry.v, track @ render.geometry.d))
    assert gain == pytest.approx(np.exp(-4 * np.log(2) * (phi + 0.5) ** 2 / 16.0) ** 2, rel=ROUNDING)
    # steeper is nearer to the track's foot: larger phi at shorter horizontal distance
    assert np.corrcoef(phi, x @ render.geometry.s)[0, 1] > 0.9


def test_linear_and_square_step_of_the_antenna_are_that() -> None:
    """(I+ - I-) / (2 size I) is x for the linear step, (I+ - I0) / (size I0) is -x^2 for the square one."""
    scene = street()
    linear, square = get("antenna_pattern").trials(Context(scene, 0.01))[0].steps
    render = render_of(scene)
    x = render.hits.point.numpy() @ render.geometry.v

    def gain(table: Any) -> np.ndarray:
        return np.exp(-8 * math.log(2) * ((x - table["boresight_m"]) / table["beamwidth_m"]) ** 2)

    # second order in the step: 0.04 at the edge
    assert (gain(linear.plus) - gain(linear.minus)) / (2 * linear.size) == pytest.approx(x, rel=0.06, abs=1e-9)
    assert (gain(square.plus) - 1) / square.size == pytest.approx(-(x**2), rel=0.03, abs=1e-9)


def test_trials_are_of_the_scenes_kind() -> None:
    step = get("antenna_pattern").trials(Context(street(**STRIP_MAP), 0.01))[0].steps[0]
    assert "beamwidth_deg" in step.plus


def test_degrees_are_refused_in_a_plane_wave() -> None:
    said = refusal("antenna_pattern", {"beamwidth_deg": 20.0})
    assert "allowed there are beamwidth_m and boresight_m" in said


def test_infinite_width_may_be_written() -> None:
    scene = with_effect(street(), "antenna_pattern", {"beamwidth_m": math.inf, "boresight_m": 1.0})
    assert declared(scene, scene.views[0]) == []
