"""The chance that values without a cause gain as much: uniform where nothing is off, and small where something is."""

from __future__ import annotations

import numpy as np
import pytest
from test_joint import made

from warpsar.calibration.causes import causes
from warpsar.calibration.differences import Differences
from warpsar.calibration.joint import CauseModel, Trials, best_addition, fit_model

pytestmark = pytest.mark.unit


def chance(data: Differences) -> float:
    """1 where no cause lowers BIC."""
    found = best_addition(fit_model(CauseModel(()), data), Trials(data, causes(data)))
    return 1.0 if found is None else found.chance


@pytest.mark.full
@pytest.mark.parametrize(("days", "names"), [(8, "AB"), (5, "ABCD")])
def test_as_rare_as_it_says_where_nothing_is_off(days: int, names: str) -> None:
    """60 worlds of few images: within three standard errors of the shares that are expected."""
    found = np.array([chance(made(lambda n, d, a, i: 0.0, names, days, seed)) for seed in range(60)])
    assert (found <= 0.05).sum() <= 8  # 3 are expected, with a standard error of 1.7
    assert (found <= 0.2).sum() <= 21  # 12, 3.1


def test_small_where_something_is_off() -> None:
    """The one of 1,001 that is these values' own."""
    assert chance(made(lambda n, d, a, i: -1.0 * (n == "B"))) == pytest.approx(1 / 1001)
