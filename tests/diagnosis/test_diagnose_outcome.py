"""What a diagnosis says of every effect in a turn: why it was added, or was not."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from test_diagnose import scene_with

from warpsar.diagnosis.found import Candidate, Confirmed, DiagnoseOptions, Turn
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.left_out import ViewsLeftOut
from warpsar.diagnosis.search.confirmation import Confirmation
from warpsar.diagnosis.search.outcome import confirmation_lines, outcome, turn_lines
from warpsar.diagnosis.search.procedure import DiagnosisForecast, forecast
from warpsar.runtime import devices
from warpsar.runtime.forecast import LONG_S
from warpsar.simulation.rays import Rays
from warpsar.speckle.scan import Spot
from warpsar.surface.stage import Stage

pytestmark = pytest.mark.unit

FITTED = Candidate("point_spread", "testable", minus_log_p=50.0, refit_gain=1234.56, refit_size=2)


def turn_of(*candidates: Candidate, added: str | None = None, **more: Any) -> Turn:
    table = {"point_spread": {"range_fwhm_m": 1.23456, "window": "gaussian"}}
    fitted = SimpleNamespace(scene=SimpleNamespace(effects=table)) if added else None
    turn = Turn(list(candidates), added, Spot(1.0, 0, 0, 0, (3, 3)), 1.0, 0.5, 8.0, base=cast(Any, None), **more)
    return replace(turn, fitted=cast(Any, fitted))


@pytest.mark.parametrize(
    ("candidate", "said"),
    [
        (Candidate("point_spread", "absent", note="this scene has no place for it"), "no place for it in this scene"),
        (Candidate("point_spread", "not_testable", eta=1e-4), "not testable here"),
        (Candidate("point_spread", "testable", minus_log_p=3.21), "-ln p 3.2 is not over the threshold of 8.0"),
        (Candidate("point_spread", "testable", minus_log_p=-1e-9), "-ln p 0.0 is not over the threshold of 8.0"),
        (Candidate("point_spread", "testable", minus_log_p=9.0), "the limit of added effects was reached"),
        (
            replace(FITTED, refused="it gains less than its parameters cost", refit_gain=4.0, refit_size=1),
            "2 ln L +4.0 for 1 parameter; it gains less than its parameters cost",
        ),
        (
            replace(FITTED, refused="view_gain is likelier", note="rows 3 to 5; its fit was given up, far behind"),
            "2 ln L +1,234.6 for 2 parameters; view_gain is likelier; rows 3 to 5; its fit was given up, far behind",
        ),
        (
            replace(FITTED, refused="it does not help", left_out=ViewsLeftOut(1.234, 0.95, 3)),
            "2 ln L +1,234.6 for 2 parameters; views left out gain 1.23 +- 0.95 in ln L; it does not help",
        ),
        (
            Candidate("point_spread", "testable", minus_log_p=90.0, refused="9 of 90 dark pixels measure exactly 0",
                      note="9 of 90 dark pixels measure exactly 0"),
            "9 of 90 dark pixels measure exactly 0",
        ),
    ],
)  # fmt: skip
def test_why_an_effect_was_not_added(candidate: Candidate, said: str) -> None:
    assert outcome(candidate, turn_of(candidate)) == said


def test_an_effect_that_others_kept_from_a_fit() -> None:
    passing = Candidate("view_gain", "testable", minus_log_p=9.0)
    assert outcome(passing, turn_of(FITTED, passing)) == "others looked likelier after a few iterations"


def test_an_effect_that_was_added() -> None:
    held = replace(FITTED, left_out=ViewsLeftOut(120.34, 11.2, 3), note="")
    assert (
        outcome(held, turn_of(held, added="point_spread"))
        == "2 ln L +1,234.6 for 2 parameters; views left out gain 120 +- 11 in ln L"
    )
    alone = replace(FITTED, left_out=ViewsLeftOut(0.0, 0.0, 1))
    assert outcome(alone, turn_of(alone, added="point_spread")) == "2 ln L +1,234.6 for 2 parameters"
    back = replace(held, refused="it gains less than its parameters cost")
    assert outcome(back, turn_of(back, added="point_spread")).endswith(
        "120 +- 11 in ln L; taken back at the end: it gains less than its parameters cost"
    )


def test_what_was_asked_of_every_effect_beside_the_others() -> None:
    asked = [
        Confirmed("registration", 3.0, 2, refused="it gains less than its parameters cost"),
        Confirmed("point_spread", 1234.56, 2, ViewsLeftOut(120.34, 11.2, 3)),
        Confirmed("noise_floor", -5.0, 1, notes=["the dark pixels need it"]),
    ]
    assert confirmation_lines(Confirmation(cast(Any, None), asked)) == [
        "every added effect beside all the others:",
        "  taken back: registration: 2 ln L +3.0 for 2 parameters; it gains less than its parameters cost",
        "  holds: point_spread: 2 ln L +1,234.6 for 2 parameters; views left out gain 120 +- 11 in ln L",
        "  holds: noise_floor: 2 ln L -5.0 for 1 parameter; the dark pixels need it",
    ]


def test_a_turn_on_the_console() -> None:
    """What was added comes first, whatever it scored."""
    held = replace(FITTED, left_out=ViewsLeftOut(120.34, 11.2, 3))
    other = replace(FITTED, effect="registration", minus_log_p=99.0, refit_gain=7.0, refused="point_spread is likelier")
    low = Candidate("range_loss", "testable", minus_log_p=2.0)
    blind = Candidate("vegetation", "not_testable")
    turn = turn_of(low, blind, other, held, added="point_spread", dropped=["view_gain"])
    assert turn_lines(turn, 1) == [
        "turn 2: added on trial: point_spread",
        "  point_spread: range_fwhm_m 1.235, window gaussian",
        "  dropped: view_gain, needless beside point_spread",
        "  not added: registration: 2 ln L +7.0 for 2 parameters; point_spread is likelier",
        "  not over the threshold of 8.0: range_loss 2.0",
        "  not testable: vegetation",
    ]


# ---- how long it will take ----


def test_two_times_are_announced(tmp_path: Path) -> None:
    """What is long is announced: the time if nothing is missing, and that of each effect."""
    scene = scene_with({}, tmp_path)
    device = devices.resolve_device("cpu")
    rays = Rays(Stage.of(scene, device), 64.0, 1)
    setup = replace(one := FitSetup(device, rays, {}), observations=frozen(one, one, scene))
    long = forecast(setup, scene, DiagnoseOptions(starts=10**5))
    assert long is not None
    assert long.effect_s > long.nothing_s > LONG_S
    assert str(DiagnosisForecast(20.0, 300.0)).startswith(
        "about 20 s if nothing is missing, and about 5 min more for each effect"
    )
