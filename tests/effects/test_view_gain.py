"""Gains in decibels, without their mean."""

import dataclasses

import pytest
from effect_worlds import ROUNDING, Case, pair, plane, street, with_effect
from worlds import view

from warpsar.effects.base.trial import Context
from warpsar.effects.registry import declared, get

pytestmark = pytest.mark.unit

WORKING = [Case({"gain_db": {"v0": 2.0, "v1": -2.0}})]


def test_view_gain_in_decibels() -> None:
    scene = plane(views=[view(20.0, 40.0), view(110.0, 40.0, name="other")])
    without, with_it = pair(scene, "view_gain", {"gain_db": {"view": 3.0, "other": -3.0}})
    assert with_it == pytest.approx(10**0.3 * without, rel=ROUNDING)


def test_view_gains_have_no_mean() -> None:
    scene = with_effect(street(), "view_gain", {"gain_db": {"v0": 3.0}})
    assert [declared(scene, v)[0].values[0] for v in scene.views] == [1.5, -1.5]


def test_a_view_alone_has_no_trial() -> None:
    scene = dataclasses.replace(street(), views=street().views[:1])
    assert get("view_gain").trials(Context(scene, 0.01)) == []
