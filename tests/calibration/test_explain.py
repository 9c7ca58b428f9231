"""Causes of a difference: each is found where it was put, and what the data cannot tell apart is said to be tied."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.explain import ALIKE, Explanation, explain
from warpsar.calibration.geolocation import geolocation
from warpsar.calibration.measure import ReflectorObservation, Status
from warpsar.calibration.point import PointMeasurement, interval
from warpsar.calibration.sites import ReflectorSite
from warpsar.products.product import ImagedPoint

WAVELENGTH, LEG, CELL = 0.0555, 1.2, 2.0
EAST, WEST = Facing(95.0, 10.0), Facing(265.0, 10.0)


def look(azimuth_deg: float, incidence_deg: float) -> np.ndarray:
    a, i = np.deg2rad([azimuth_deg, incidence_deg])
    return np.array([np.sin(a) * np.sin(i), np.cos(a) * np.sin(i), np.cos(i)])


def observed(
    name: str,
    day: int,
    azimuth: float,
    incidence: float,
    off_db: float,
    *,
    offset: tuple[float, float] = (0.0, 0.0),
    status: Status = "measured",
) -> ReflectorObservation:
    site = ReflectorSite(name, 46.0, 12.0, 0.0, (EAST, WEST), "triangular", LEG)
    toward = look(azimuth, incidence)
    facing = site.facing(toward)
    assert facing is not None
    predicted = float(trihedral_rcs_m2("triangular", LEG, facing, toward, WAVELENGTH))
    target = predicted * 10 ** (off_db / 10)
    low, high = interval(target, CELL, CELL**2, 1.6449)
    point = PointMeasurement(
        100.0 + offset[0], 200.0 + offset[1], (0.1, 0.1), target, low, high, target, target / CELL, 1.0, 100.0, 0.9,
        0.0, None, status == "measured",
    )  # fmt: skip
    date = np.datetime64("2024-01-01T06:00:00", "us") + np.timedelta64(day, "D")
    return ReflectorObservation(
        site, "made", "S1A", "VV", date, status, expected=ImagedPoint(0.0, 8e5, 100.0, 200.0, toward),
        spacing_m=(10.0, 2.0), point=point, facing=facing, closed_form_m2=predicted,
    )  # fmt: skip


PASSES = ((98.0, 38.0), (262.0, 44.0))
Off = Callable[[str, int, float, float], float]


def stack(off: Off, names: Sequence[str] = ("A", "B", "C"), days: int = 12, seed: int = 0) -> Explanation:
    """Three reflectors, two passes, a value every 24 days, 0.3 dB of scatter."""
    rng = np.random.default_rng(seed)
    return explain(
        [
            observed(name, 24 * k, azimuth, incidence, off(name, 24 * k, azimuth, incidence) + 0.3 * rng.normal())
            for name in names
            for k in range(days)
            for azimuth, incidence in PASSES
        ]
    )


def turned(name: str, day: int, azimuth: float, incidence: float) -> float:
    """A turned by 6 and tilted by -8 degrees, as its passes see it."""
    if name != "A":
        return 0.0
    toward = look(azimuth, incidence)
    facing = min((EAST, WEST), key=lambda one: one.off_boresight_deg(toward))
    share = np.cos(np.deg2rad(facing.azimuth_deg - EAST.azimuth_deg))  # a rigid body: one side rises, the other sinks
    wrong = Facing(facing.azimuth_deg + 6.0, facing.tilt_deg - 8.0 * float(share))
    areas = [float(trihedral_rcs_m2("triangular", LEG, one, toward, WAVELENGTH)) for one in (wrong, facing)]
    return float(10 * np.log10(areas[0] / areas[1]))


CASES: dict[str, tuple[Off, str, str | None, float, float]] = {
    "constant": (lambda n, d, a, i: -1.0, "calibration constant", "constant [dB]", -1.0, 0.2),
    "pattern": (lambda n, d, a, i: 0.2 * (i - 41.0), "antenna pattern", "slope [dB/deg]", 0.2, 0.05),
    "drift": (lambda n, d, a, i: -2.0 * d / 365.25, "gain drift", "drift [dB/year]", -2.0, 0.5),
    "loss": (lambda n, d, a, i: -1.5 if n == "B" else 0.0, "loss at B", "loss [dB]", 1.5, 0.3),
    "size": (lambda n, d, a, i: 1.5 if n == "B" else 0.0, "size of B", "leg [m]", LEG * 10 ** (1.5 / 40), 0.02),
    "fading": (
        lambda n, d, a, i: -4.0 * d / 365.25 if n == "C" else 0.0, "fading of C", "change [dB/year]", -4.0, 0.8,
    ),
    "step": (lambda n, d, a, i: -3.0 if n == "C" and d > 100 else 0.0, "step of C", "after [dB]", -3.0, 0.4),
    "attitude": (turned, "attitude of A", None, 0.0, 0.0),
    "none": (lambda n, d, a, i: 0.0, "none", None, 0.0, 0.0),
}  # fmt: skip


@pytest.mark.full
@pytest.mark.parametrize("case", CASES)
def test_a_cause_is_found_where_it_was_put(case: str) -> None:
    """It is the best one, or at odds better than 1 to 10; its value lies within four standard errors."""
    off, cause, parameter, value, tolerance = CASES[case]
    found = stack(off)
    best = next(one for one in found.fitted if one.cause.name != "levels")
    named = next(one for one in found.fitted if one.cause.name == cause)
    assert named.bic <= best.bic + ALIKE
    if parameter is not None:
        k = named.cause.parameters.index(parameter)
        assert named.values[k] == pytest.approx(value, abs=tolerance)
        assert named.low[k] <= named.values[k] <= named.high[k]
    assert named.held_log_likelihood is not None


@pytest.mark.full
def test_one_reflector_from_one_side_ties_what_it_must() -> None:
    rng = np.random.default_rng(0)
    found = explain([observed("A", 12 * k, 98.0, 38.0, -1.5 + 0.3 * rng.normal()) for k in range(10)])
    pairs = {frozenset((one.first, one.second)): one for one in found.tied}
    tie = pairs[frozenset(("calibration constant", "loss at A"))]
    assert "another reflector" in tie.decided_by
    assert tie.apart_db == pytest.approx(1.5, abs=0.3)
    assert "cleaned" in pairs[frozenset(("loss at A", "size of A"))].decided_by or "tape" in (
        pairs[frozenset(("loss at A", "size of A"))].decided_by
    )
    assert any("cannot be told here from" in words for words in found.words)


@pytest.mark.full
def test_a_second_reflector_breaks_the_tie() -> None:
    """The loss is one reflector's alone: with two others in the image it is no calibration constant."""
    found = stack(lambda n, d, a, i: -1.5 if n == "B" else 0.0)
    pairs = [{one.first, one.second} for one in found.tied]
    assert {"calibration constant", "loss at B"} not in pairs


def test_bad_dates_are_set_aside() -> None:
    rng = np.random.default_rng(0)
    values = 0.3 * rng.normal(size=12)
    values[4] -= 4.0
    observations = [observed("A", 12 * k, 98.0, 38.0, float(v)) for k, v in enumerate(values)]
    observations[7] = observed("A", 84, 98.0, 38.0, -20.0, status="not seen")
    found = explain(observations)
    assert [one.date for one in found.bad_dates] == ["2024-02-18", "2024-03-25"]
    assert "not seen" in found.bad_dates[1].words
    assert found.used == 10


def test_nothing_to_explain() -> None:
    assert explain([]).words == ("No difference can be explained: no reflector is measured and predicted.",)


def test_geolocation_and_a_reflector_that_moved() -> None:
    rng = np.random.default_rng(0)
    observations = [
        observed(
            name, 12 * k, 98.0, 38.0, 0.0, offset=(0.1 + 0.02 * rng.normal(), 1.5 + 0.02 * rng.normal() + (name == "C"))
        )
        for name in ("A", "B", "C")
        for k in range(8)
    ]
    found = geolocation(observations)
    assert found is not None
    assert found.azimuth.mean_m == pytest.approx(1.0, abs=0.2)
    assert found.sites["A"][1].mean_m == pytest.approx(3.0, abs=0.05)
    assert found.moved == ("C",)
    assert found.azimuth.low_m < found.azimuth.mean_m < found.azimuth.high_m
