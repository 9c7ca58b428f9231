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


def test_few_views_against_the_others_are_simpler() -> None:
    """One view that is off has one number, not one for each view: the others then tell the surface's law."""
    gains = {"a": -0.25, "b": 0.95, "c": -0.2, "d": -0.25, "e": -0.25}
    one, two, three = (table["gain_db"] for table in get("view_gain").simpler({"gain_db": gains}))
    assert one == {"b": pytest.approx(1.2)}
    assert two == {"b": pytest.approx(1.2), "c": pytest.approx(0.05)}
    assert len(three) == 3  # four would be as many numbers as five without their mean
    assert get("view_gain").simpler({"gain_db": {"a": 1.0, "b": -1.0}}) == []
