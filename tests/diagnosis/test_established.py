"""Which names are earned where something is left."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from warpsar.compare.judgement import Judgement
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.result import not_established

HELD = [
    "noise_floor",
    "registration",
    "point_spread",
    "object_pose house",
    "object_size shed",
    "absent_object hut",
    "missing_object found_1",
    "view_angles v0",
    "pixel_spacing range",
]
EFFECTS, SENSOR = {"point_spread"}, {"view_angles v0", "pixel_spacing range"}
MOVING = {"object_pose house", "object_size shed", "registration"}


def doubted(findings: list[str], on_trial: list[str] | None = None) -> dict[str, str]:
    """Of a model with all of `HELD`, whose floor and shift alone are confirmed by their own tests."""
    signed = {"noise_floor", "registration"}.__contains__
    found: Any = SimpleNamespace(held=HELD, on_trial=on_trial or [], signed=signed)
    verdicts: Any = {"train": SimpleNamespace(findings=[]), "test": SimpleNamespace(findings=findings)}
    return not_established(cast(Diagnosis, found), cast(dict[str, Judgement], verdicts))


@pytest.mark.parametrize(
    ("findings", "names"),
    [
        ([], set()),
        (["level"], set()),
        (["looks"], set()),
        (["structure"], EFFECTS | SENSOR),
        (["edges"], EFFECTS | SENSOR | MOVING),
        (["structure", "edges", "level"], EFFECTS | SENSOR | MOVING),
    ],
)
def test_what_is_left_takes_names_that_may_stand_in_for_it(findings: list[str], names: set[str]) -> None:
    assert set(doubted(findings)) == names


def test_what_was_left_on_trial_is_no_name() -> None:
    told = doubted([], ["noise_floor", "missing_object found_1"])
    assert set(told) == {"noise_floor", "missing_object found_1"}
    assert all("time was over" in why for why in told.values())
