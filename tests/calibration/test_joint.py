"""Causes together: found beside each other, confirmed by later dates, tied where they must be; and bad dates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_explain import PASSES, Off, observed

from warpsar.calibration.causes import causes
from warpsar.calibration.differences import Differences, bad_dates
from warpsar.calibration.explain import explain
from warpsar.calibration.geolocation import geolocation
from warpsar.calibration.joint import CauseModel, Trials, asked_again, fit_model, joint
from warpsar.calibration.measure import ReflectorObservation
from warpsar.calibration.scatter import ErrorCovariance, ExtraScatter
from warpsar.calibration.turns import attitude_solutions, over_attitudes


def made(off: Off, names: str = "ABC", days: int = 12, seed: int = 0, image_db: float = 0.15) -> Differences:
    """0.3 dB from value to value, and a gain of each image's own."""
    rng, found = np.random.default_rng(seed), []
    for day in range(0, 24 * days, 24):
        for azimuth, incidence in PASSES:
            gain = image_db * rng.normal()
            for name in names:
                level = off(name, day, azimuth, incidence) + gain + 0.3 * rng.normal()
                found.append(replace(observed(name, day, azimuth, incidence, level), source=f"{day}, {azimuth}"))
    return Differences.of(found)


def test_three_causes_at_once() -> None:
    """Constant -1, a loss of 1.5 at B, a fall of 3 dB at C: each within three standard errors, later dates agree.

    With A, B and C alone, a constant of -2.5 and a larger A would say the same, as C has a level of its own.
    """
    data = made(lambda n, d, a, i: -1.0 - 1.5 * (n == "B") - 3.0 * (n == "C" and d > 60), "ABCD")
    found = joint(data, causes)
    named = {one.cause.name: one for one in found.causes}
    assert set(named) == {"calibration constant", "loss at B", "step of C"}
    for name, k, value in (("calibration constant", 0, -1.0), ("loss at B", 0, 1.5), ("step of C", 1, -3.0)):
        one = named[name]
        assert abs(one.values[k] - value) < 3 * (one.high[k] - one.low[k]) / (2 * 1.645)
        assert one.held_gain is not None
        assert one.held_gain > 0.0
    assert found.held_dates == 4
    assert found.without > 100.0
    assert {one.other for one in found.stands if one.cause == "loss at B"} >= {"size of B"}


@pytest.mark.parametrize("first", ["fading of C", "size of C"])
def test_a_cause_that_a_later_one_makes_needless_goes(first: str) -> None:
    """A step of C alone: what was taken before it says nothing beside it, and the step stays as it is asked again."""
    data = made(lambda n, d, a, i: -3.0 * (n == "C" and d > 130))
    trials = Trials(data, causes(data))
    chosen = {one.name: one for one in trials.causes}
    fit = fit_model(CauseModel((chosen[first], chosen["step of C"])), data)
    left = asked_again(fit, fit.model.causes, trials, lambda step: step.chance <= 0.05)
    assert [one.name for one in left.model.causes] == ["step of C"]


def test_another_cause_takes_the_place_of_one_that_fits_worse() -> None:
    """A loss of B that was first taken for its fading."""
    data = made(lambda n, d, a, i: -1.5 * (n == "B"))
    trials = Trials(data, causes(data))
    fading = next(one for one in trials.causes if one.name == "fading of B")
    fit = fit_model(CauseModel((fading,)), data)
    left = asked_again(fit, fit.model.causes, trials, lambda step: step.chance <= 0.05)
    assert [one.name for one in left.model.causes] in (["loss at B"], ["size of B"])
    kept = asked_again(fit, fit.model.causes, trials, lambda step: step.chance <= 0.05, {"fading of B"})
    assert [one.name for one in kept.model.causes] == ["fading of B"]


@pytest.mark.full
def test_nothing_is_named_where_nothing_is_off() -> None:
    """Of 5 worlds at most one has a cause (`python benchmarks/reflectors_causes.py --worlds 200`: 2 of 200)."""
    assert sum(bool(joint(made(lambda n, d, a, i: 0.0, seed=k), causes).causes) for k in range(5)) <= 1


@pytest.mark.full
def test_what_later_dates_deny_is_no_cause() -> None:
    """A drift of the earlier two thirds that turns back afterwards: no gain drift is kept from them alone."""
    data = made(lambda n, d, a, i: -6.0 * d / 365.25 if d < 192 else 0.0)
    found = joint(data, causes)
    drift = next((one for one in found.causes if one.cause.name == "gain drift"), None)
    assert drift is None or drift.held_gain is None


def test_the_errors_of_an_image_are_shared() -> None:
    """Whitening and determinant against the covariance written out: D + s 11' in each image."""
    data = made(lambda n, d, a, i: 0.0, days=2)
    errors = ErrorCovariance(data, ExtraScatter(0.3, 0.5))
    whole = np.diag(data.sd**2 + 0.09) + 0.25 * (data.image[:, None] == data.image)
    white = errors.whitened(np.eye(len(data)))
    np.testing.assert_allclose(white.T @ white, np.linalg.inv(whole), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(errors.whitened(data.value), white @ data.value, atol=1e-12)
    assert errors.log_determinant == pytest.approx(np.linalg.slogdet(whole)[1])


def test_both_scatters_are_found() -> None:
    """0.3 and 0.15 dB, known to some 8 and 30 % from 24 images of 3."""
    data = made(lambda n, d, a, i: 0.0, days=24, seed=3, image_db=0.4)
    fit = fit_model(CauseModel(()), data)
    clutter = float(np.sqrt(np.mean(data.sd**2)))
    assert np.hypot(fit.scatter.value, clutter) == pytest.approx(np.hypot(0.3, 0.0), abs=0.08)
    assert fit.scatter.image == pytest.approx(0.4, abs=0.13)


@pytest.mark.full
def test_two_passes_leave_two_attitudes_and_one_pass_a_ring() -> None:
    """The truth, a turn of 4.5 and a tilt of -6, lies in one of the regions of two passes, and in the ring of one."""
    from test_explain import EAST, LEG, WAVELENGTH, WEST, look

    from warpsar.calibration.attitude import Facing, trihedral_rcs_m2

    def off(name: str, day: int, azimuth: float, incidence: float) -> float:
        if name != "A":
            return 0.0
        toward = look(azimuth, incidence)
        facing = min((EAST, WEST), key=lambda one: one.off_boresight_deg(toward))
        share = float(np.cos(np.deg2rad(facing.azimuth_deg - EAST.azimuth_deg)))
        wrong = Facing(facing.azimuth_deg + 4.5, facing.tilt_deg - 6.0 * share)
        areas = [float(trihedral_rcs_m2("triangular", LEG, one, toward, WAVELENGTH)) for one in (wrong, facing)]
        return float(10 * np.log10(areas[0] / areas[1]))

    data = made(off)
    found = joint(data, causes)
    regions = attitude_solutions(found, data)
    assert regions
    assert {one.passes for one in regions} == {2}
    assert any(
        one.turn_range_deg[0] <= 4.5 <= one.turn_range_deg[1] and one.tilt_range_deg[0] <= -6 <= one.tilt_range_deg[1]
        for one in regions
    )
    (named,) = (one for one in over_attitudes(found, regions).causes if one.cause.name == "attitude of A")
    assert np.all((named.low <= (4.5, -6.0)) & (named.high >= (4.5, -6.0)))
    for one in regions:
        assert named.low[0] <= one.turn_deg <= named.high[0]
        assert named.low[1] <= one.tilt_deg <= named.high[1]
    single = data.part(data.look[:, 0] > 0.0)
    ring = attitude_solutions(joint(single, causes), single)
    assert [one.passes for one in ring] == [1] * len(ring)
    widest = max(ring, key=lambda one: np.ptp(one.turn_range_deg))
    assert np.ptp(widest.turn_range_deg) > 15.0


@pytest.mark.full
def test_timing_atmosphere_and_survey_are_told_apart() -> None:
    """A zenith path of 2.4 m over three incidences, and C surveyed 0.8 m off in range."""
    rng, made_up = np.random.default_rng(100), []
    for k in range(10):
        for azimuth, incidence in ((98.0, 32.0), (98.1, 38.0), (98.0, 44.0)):
            for name in "ABC":
                path = 2.4 / np.cos(np.deg2rad(incidence)) + 0.05 * rng.normal() + 0.8 * (name == "C")
                made_up.append(
                    observed(name, 12 * k, azimuth, incidence, 0.0, offset=(0.05 + 0.01 * rng.normal(), path / 2.0))
                )
    found = geolocation(made_up)
    assert found is not None
    named = {one.cause.name: one for one in found.joint[1].causes}
    assert set(named) == {"atmosphere", "place of C"}
    assert named["atmosphere"].values[0] == pytest.approx(2.4, abs=0.05)
    assert named["place of C"].values[0] == pytest.approx(0.8, abs=0.06)
    assert [one.cause.name for one in found.joint[0].causes] == ["timing"]
    assert found.moved == ("C",)


def series(rng: np.random.Generator, days: int = 30) -> list[ReflectorObservation]:
    return [observed("A", 12 * k, 98.0, 38.0, 0.3 * rng.normal()) for k in range(days)]


@pytest.mark.full
def test_good_dates_are_called_bad_as_seldom_as_is_said() -> None:
    """Of 60 series without a bad date one in 20 may have one; 8 would be 3 standard errors more."""
    rng = np.random.default_rng(0)
    called = sum(bool(bad_dates(Differences.of(series(rng)))[0]) for _ in range(60))
    assert called <= 8


def test_a_bad_date_is_found_and_a_step_is_none() -> None:
    rng = np.random.default_rng(1)
    some = series(rng)
    some[12] = observed("A", 144, 98.0, 38.0, -2.5)
    found = {one.date: one for one in bad_dates(Differences.of(some))[0]}
    assert found["2024-05-24"].chance < 1e-3
    assert len(found) <= 2
    for after in (14, 27):  # the second one leaves two values after the step
        step = [observed("A", 12 * k, 98.0, 38.0, 0.3 * rng.normal() - 5.0 * (k > after)) for k in range(30)]
        assert bad_dates(Differences.of(step))[0] == []
    some = [*series(rng)[:29], observed("A", 348, 98.0, 38.0, -4.0)]
    assert "2024-12-14" in {one.date for one in bad_dates(Differences.of(some))[0]}


@pytest.mark.full
def test_the_explanation_has_it_all() -> None:
    data = made(lambda n, d, a, i: -1.0)
    found = explain(data.observations)
    assert found.joint is not None
    content = found.content()
    assert isinstance(content["joint"], dict)
    assert content["joint"]["causes"][0]["cause"] == "calibration constant"
    assert content["attitudes"] == []
    assert any(words.startswith("Together: the image's calibration constant is off") for words in found.words)
