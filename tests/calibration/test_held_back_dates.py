"""Later values foretold from earlier dates: against Student's interval in closed form, and by how many lie inside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student
from test_explain import PASSES, observed

from warpsar.calibration.explain import explain
from warpsar.calibration.forecast import forecast
from warpsar.calibration.measure import ReflectorObservation

pytestmark = pytest.mark.unit
SINCE = np.datetime64("2024-04-01", "us")


def unpredicted(day: int, dbsm: float, *, seen: bool = True) -> ReflectorObservation:
    """A reflector of unknown size, in clutter of a thousandth of a decibel."""
    made = observed("A", day, 98.0, 38.0, 0.0, status="measured" if seen else "not seen")
    assert made.point is not None
    area = 10 ** (dbsm / 10)
    point = replace(made.point, rcs_m2=area, low_m2=area * 10**-1e-4, high_m2=area * 10**1e-4)
    return replace(made, closed_form_m2=None, facing=None, point=point)


def test_a_level_is_foretold_by_students_interval() -> None:
    """n values of unknown mean and scatter: mean +- t(n - 1) s sqrt(1 + 1 / n). A prediction is not needed."""
    early = np.array([30.2, 31.0, 29.4, 30.6])
    later = {110: 30.5, 130: 33.0, 150: 27.0}
    made = [unpredicted(24 * k, value) for k, value in enumerate(early)]
    made += [unpredicted(day, value) for day, value in later.items()]
    made.append(unpredicted(170, 25.0, seen=False))
    made.append(unpredicted(190, 35.0, seen=False))
    found = forecast(made, SINCE)
    reach = student.ppf(0.95, 3) * early.std(ddof=1) * np.sqrt(1.25)
    for one in found.values:
        assert one.foretold_dbsm == pytest.approx(early.mean(), abs=1e-3)
        # The scatter is fitted to 1 % of 0.1 dB, or to 0.01 in ln L.
        assert one.low_dbsm == pytest.approx(early.mean() - reach, rel=0.01)
        assert one.high_dbsm == pytest.approx(early.mean() + reach, rel=0.01)
    # Of what is not seen, the bound of 25 dBsm lies below what was foretold; that of 35 denies nothing.
    assert [one.inside for one in found.values] == [True, False, False, False, True]
    assert found.words[0].startswith("Held back from 2024-04-01 on: 2 of 5 values lie in the 90 % interval")


def test_too_few_earlier_values_foretell_nothing() -> None:
    found = forecast([unpredicted(0, 30.0), unpredicted(24, 30.0), unpredicted(120, 30.0)], SINCE)
    assert (found.values, found.not_foretold) == ((), 1)
    assert found.words[0].endswith("their reflector and pass have fewer than 3 earlier values: 1.")


@pytest.mark.full
def test_causes_foretell_later_values() -> None:
    """A calibration constant, 0.3 dB of scatter: 48 values, of which 90 % +- 9 % (two errors) lie inside."""
    rng = np.random.default_rng(3)
    made = [
        observed(name, 24 * k, azimuth, incidence, -1.0 + 0.3 * rng.normal())
        for name in "ABC"
        for k in range(16)
        for azimuth, incidence in PASSES
    ]
    since = np.datetime64("2024-01-01", "us") + np.timedelta64(24 * 8, "D")
    found = forecast(made, since, explain([one for one in made if one.date < since]))
    assert len(found.values) == 48
    assert 39 <= sum(one.inside for one in found.values) <= 47
    widths = [(one.high_dbsm - one.low_dbsm, one.level_high_dbsm - one.level_low_dbsm) for one in found.values]
    assert np.mean(widths, axis=0)[0] < np.mean(widths, axis=0)[1]  # one constant is known better than six levels
