"""Reflectors without a prediction are compared with themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from warpsar.calibration.attitude import SHAPES, Facing, Shape, trihedral_rcs_m2, turn_that_loses_deg
from warpsar.calibration.explain import explain
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.point import PointMeasurement, interval
from warpsar.calibration.sites import ReflectorSite
from warpsar.calibration.unpredicted import FALSE_RATE, USUAL_SCATTER_DB, Unpredicted, unpredicted
from warpsar.products.product import ImagedPoint

pytestmark = pytest.mark.unit
CLUTTER = 2.0


def observed(name: str, day: int, level_dbsm: float, polarization: str = "VV") -> ReflectorObservation:
    toward = np.array([0.6, 0.0, 0.8])
    target = float(10 ** (level_dbsm / 10))
    low, high = interval(target, CLUTTER, CLUTTER**2, 1.6449)
    point = PointMeasurement(
        100.0, 200.0, (0.1, 0.1), target, low, high, target, target / CLUTTER, 1.0, 100.0, 0.9, 0.0, None, True
    )
    site = ReflectorSite(name, 46.0, 12.0, 0.0, (), "triangular", None)
    date = np.datetime64("2024-01-01T06:00:00", "us") + np.timedelta64(day, "D")
    return ReflectorObservation(
        site, f"day {day}", "S1A", polarization, date, "measured",
        expected=ImagedPoint(0.0, 8e5, 100.0, 200.0, toward), spacing_m=(10.0, 2.0), point=point,
    )  # fmt: skip


def series(level: Callable[[int], float], days: Sequence[int], scatter: float, seed: int) -> Unpredicted:
    rng = np.random.default_rng(seed)
    found = unpredicted([observed("A", day, level(day) + scatter * rng.normal()) for day in days])
    assert found is not None
    return found


def test_a_fall_over_three_dates_is_said_with_what_could_stand_for_it() -> None:
    some = [observed("A", day, level) for day, level in ((0, 37.0), (12, 35.5), (24, 31.0))]
    explained = explain(some)
    assert explained.unpredicted is not None
    (fall,) = explained.unpredicted.uneven
    assert (fall.brightest, fall.weakest[0]) == (("2024-01-01", pytest.approx(37.0)), "2024-01-25")
    assert fall.chance < 1e-6
    assert fall.words in explained.words
    assert "6.0 dB less on 2024-01-25" in fall.words
    assert "A turn (by 31 deg in azimuth" in fall.words


def test_scatter_alone_is_no_change() -> None:
    """500 series of a reflector that stays the same: as many are said to change as `FALSE_RATE` asks for, 5; more than
    12 would be there by chance in 2 of 1000 cases."""
    days = range(0, 48, 12)
    named = sum(bool(series(lambda day: 36.0, days, USUAL_SCATTER_DB, seed).uneven) for seed in range(500))
    assert named <= 12
    assert FALSE_RATE == 0.01
    assert series(lambda day: 36.0, days, 0.0, 0).words == (
        "No prediction, and no change of RCS beyond clutter and 0.33 dB: A.",
    )


def test_a_step_is_found_without_a_prediction() -> None:
    found = series(lambda day: 36.0 - 2.0 * (day > 120), range(0, 240, 12), 0.3, 1)
    assert found.joint is not None
    (step,) = found.joint.causes
    assert step.cause.name == "step of A"
    assert step.values[1] - step.values[0] == pytest.approx(-2.0, abs=0.4)
    assert "after 2024-04-30 and not later than 2024-05-12" in step.cause.title


def test_polarizations_and_reflectors_are_not_compared_with_each_other() -> None:
    some = [observed("A", day, 36.0 + 4.0 * (pol == "HH"), pol) for day in (0, 12, 24) for pol in ("HH", "VV")]
    some += [observed("B", day, 30.0) for day in (0, 12, 24)]
    found = unpredicted(some)
    assert found is not None
    assert found.uneven == ()
    assert found.words[0].endswith(": A, B.")


def test_one_date_and_a_prediction_say_nothing() -> None:
    assert unpredicted([observed("A", 0, 36.0)]) is None
    assert unpredicted([]) is None
    assert unpredicted([replace(observed("A", day, 30.0 + day), closed_form_m2=9.0) for day in (0, 12)]) is None


@pytest.mark.parametrize("shape", SHAPES)
def test_a_turned_reflector_loses_what_was_asked(shape: Shape) -> None:
    """By turning the reflector instead of the look; 0.01 dB is what the grid of turns leaves."""
    toward = Facing(40.0).boresight()
    for loss in (0.5, 3.0, 6.0):
        turned = Facing(40.0 - turn_that_loses_deg(shape, loss))
        areas = [float(trihedral_rcs_m2(shape, 1.0, one, toward, 0.05)) for one in (Facing(40.0), turned)]
        assert 10 * np.log10(areas[0] / areas[1]) == pytest.approx(loss, abs=0.01)
    assert np.isnan(turn_that_loses_deg(shape, 60.0))
