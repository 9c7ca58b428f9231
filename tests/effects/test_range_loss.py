"""The loss against its closed form, in a plane wave and in a strip-map."""

import numpy as np
import pytest
from effect_worlds import ROUNDING, STRIP_MAP, Case, gains, plane, refusal, street

from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get, validate

pytestmark = pytest.mark.unit

WORKING = [
    Case({"per_m": 0.03}),
    Case({"exponent": 3.0}, STRIP_MAP),
]


def test_range_loss_in_both_kinds_of_scene() -> None:
    gain, render = gains(plane(slant_range_m=200.0), "range_loss", {"exponent": 3.0})
    x = render.hits.point.numpy().astype(float)
    across = x - (x @ render.geometry.u)[:, None] * render.geometry.u
    distance = np.linalg.norm(across + 200.0 * render.geometry.d, axis=1)
    assert gain == pytest.approx((distance / 200.0) ** -3.0, rel=ROUNDING)
    gain, render = gains(plane(), "range_loss", {"per_m": 0.05})
    assert gain == pytest.approx(
        np.exp(-0.05 * render.hits.point.numpy().astype(float) @ render.geometry.d), rel=ROUNDING
    )


def test_trials_are_of_the_scenes_kind() -> None:
    step = get("range_loss").trials(Context(street(**STRIP_MAP), 0.01))[0].steps[0]
    assert "exponent" in step.plus


def test_the_trial_of_a_small_scene_far_away_can_be_asked() -> None:
    """Two per cent over eight metres, ten kilometres off, would be an exponent of 35."""
    effect, scene = get("range_loss"), plane(slant_range_m=1e4)
    (step,) = effect.trials(Context(scene, 0.01))[0].steps
    assert step.plus == {"exponent": 10.0}
    validate("range_loss", step.plus, "effects.range_loss")


def test_an_exponent_is_refused_in_a_plane_wave() -> None:
    assert "allowed there is per_m" in refusal("range_loss", {"exponent": 3.0})
