"""The benchmark of what is possible at best: its algebra against the program's own, and against draws of speckle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from conftest import benchmark

from warpsar.speckle.own import LAGS
from warpsar.speckle.residual import residual_autocovariance

LOOKS = 4.0


@pytest.fixture(scope="module")
def limits() -> Any:
    return benchmark("limits")


@pytest.fixture(scope="module")
def gained(limits: Any, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Views whose gains differ: the three numbers that count move every pixel of a view alike."""
    effects = {"view_gain": {"gain_db": {"v0": 0.3, "v1": -0.3, "v2": 0.2, "v3": -0.2}}}
    return limits.NoiseFree(
        benchmark("diagnosis_rates").truth(), effects, wp.get_device("cpu"), tmp_path_factory.mktemp("images")
    )


def test_sum_of_autocovariances_is_the_programs(limits: Any, gained: Any) -> None:
    residuals = np.random.default_rng(0).standard_normal((gained.truth.mu.size, 3))
    residuals[1:] += 0.6 * residuals[:-1]
    expected = [
        residual_autocovariance(list(zip(gained.seen, gained.split(one), strict=True))).sum() for one in residuals.T
    ]
    assert limits.covariance_sum(gained.seen, residuals) == pytest.approx(expected, rel=1e-9)


def test_correlated_autocovariance_is_that_of_the_draws(limits: Any) -> None:
    """Of gamma speckle whose fields have a Gaussian point-spread function."""
    random = np.random.default_rng(1)
    diagnosis_rates = benchmark("diagnosis_rates")
    power = diagnosis_rates.speckle(random, (1024, 1024), 1, True) - 1.0
    known = limits.correlated(benchmark("towns").CORRELATION_PX)
    for row, col in ((0, 0), (0, 1), (1, 1), (2, 0), (0, 3)):
        measured = float((power * np.roll(power, (row, col), (0, 1))).mean())
        # standard deviation of a covariance over 2^20 pixels: below 3 / 2^10, as the correlation area is 2.2
        assert measured == pytest.approx(known[LAGS + row, LAGS + col], abs=0.012)


def test_gain_at_the_truth(limits: Any, gained: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """About the truth itself, speckle alone gains chi-squared: as many units of 2 ln L as there are parameters."""
    monkeypatch.setattr(limits, "REACH", 200.0)  # a linear model: no bounds
    model = gained.truth
    surface = limits.Model.of(gained.setup, gained.scene).size
    held = limits.Model(
        model.scene, model.mu, model.jacobian * ~model.parts["view_gain"].own, {}, surface, model.labels
    )
    random = np.random.default_rng(2)
    beta0 = model.mu[:, None] * random.gamma(LOOKS, 1.0 / LOOKS, (model.mu.size, 400))
    gain = limits.gains(gained, beta0, LOOKS, model, held)
    assert model.size - surface == 3
    assert gain.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(2.0 * 3.0 / gain.size))
    assert gain.min() > -1e-3  # nested models; the reach is bounded after all


def test_expected_gain_is_the_mean_of_the_likelihood(limits: Any, gained: Any) -> None:
    """2 (ln L of the truth less that of another model), without any fit, averaged over speckle."""
    model, base = gained.truth, limits.Model.of(gained.setup, gained.scene)
    random = np.random.default_rng(3)
    beta0 = model.mu[:, None] * random.gamma(LOOKS, 1.0 / LOOKS, (model.mu.size, 400))
    lost = [gained.lost(beta0, one.mu, LOOKS).sum(axis=0) for one in (base, model)]
    difference = 2.0 * (lost[0] - lost[1])
    error = difference.std() / np.sqrt(difference.size)
    assert difference.mean() == pytest.approx(LOOKS * limits.expected_gain(model, base), abs=4.0 * error)
