"""Losses, their constants and metrics against scipy's distributions, numbers of physics.md and brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, stats

from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import (
    best_gain,
    curvature,
    deviance,
    expected_deviance,
    log_bias,
    loss_terms,
    loss_weight,
    metrics,
    residual_sd,
)

pytestmark = pytest.mark.unit

LOSSES = ("gamma", "mse", "log")
POSITIVE = st.floats(1e-6, 1e6)
LOOKS = st.floats(0.5, 500.0)


def images(size: int = 200, looks: float = 4.0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(0)
    mu = random.lognormal(-3.0, 1.0, size)
    return mu * random.gamma(looks, 1 / looks, size), mu


@given(measured=POSITIVE, mu=POSITIVE, other=POSITIVE, looks=LOOKS)
def test_gamma_loss_is_the_log_likelihood(measured: float, mu: float, other: float, looks: float) -> None:
    """Differences between two models are those of scipy's gamma distribution of shape L and mean mu."""

    def nll(mean: float) -> float:
        return -float(stats.gamma.logpdf(measured, looks, scale=mean / looks))

    one, two = (loss_terms("gamma", np.array([measured]), np.array([m]), looks)[0] for m in (mu, other))
    assert one - two == pytest.approx(
        nll(mu) - nll(other), rel=1e-9, abs=1e-9 * looks * (1 + measured / min(mu, other))
    )


@pytest.mark.parametrize("looks", [1.0, 2.0, 4.0, 8.0, 16.0, 3.7])
def test_expected_deviance_and_bias_by_integration(looks: float) -> None:
    distribution = stats.gamma(looks, scale=1 / looks)
    mean = distribution.expect(lambda i: 2 * looks * (i - 1 - np.log(i)), epsabs=1e-10, epsrel=1e-10)
    assert expected_deviance(looks) == pytest.approx(mean, rel=1e-6)
    assert log_bias(looks) == pytest.approx(distribution.expect(np.log), rel=1e-6)
    assert residual_sd("gamma", looks) == pytest.approx(distribution.std(), rel=1e-9)
    variance = distribution.expect(lambda i: (np.log(i) - log_bias(looks)) ** 2)
    assert residual_sd("log", looks) == pytest.approx(variance**0.5, rel=1e-5)
    assert loss_weight("log", looks, 1.0) == pytest.approx(1 / variance, rel=1e-5)


@pytest.mark.parametrize(("looks", "decibel"), [(1, -2.507), (2, -1.174), (4, -0.565), (8, -0.277), (16, -0.137)])
def test_log_bias_is_that_of_physics(looks: float, decibel: float) -> None:
    assert 10 / np.log(10) * log_bias(looks) == pytest.approx(decibel, abs=6e-4)


@pytest.mark.parametrize("loss", LOSSES)
def test_curvature_is_slope_and_fisher_information(loss: str) -> None:
    """-weight * residual is d loss / d ln mu; the weight, its second derivative where I is what the model expects."""
    measured, mu = images()
    looks, mean_square = 4.0, float(np.mean(measured**2))
    weight = loss_weight(loss, looks, mean_square)
    found = curvature(loss, measured, mu, looks, weight)
    step = 1e-5
    up, down = (weight * loss_terms(loss, measured, mu * np.exp(s * step), looks) for s in (1, -1))
    np.testing.assert_allclose(-found.weight * found.residual, (up - down) / (2 * step), rtol=1e-6, atol=1e-7)
    expected = mu * np.exp(log_bias(looks)) if loss == "log" else mu
    step = 1e-3
    up, middle, down = (weight * loss_terms(loss, expected, mu * np.exp(s * step), looks) for s in (1, 0, -1))
    np.testing.assert_allclose(found.weight, (up - 2 * middle + down) / step**2, rtol=1e-4)


@pytest.mark.parametrize("loss", LOSSES)
def test_best_gain_by_brute_force(loss: str) -> None:
    measured, mu = images()
    found = best_gain(loss, measured, 0.3 * mu, 4.0)
    by_search = optimize.minimize_scalar(
        lambda t: loss_terms(loss, measured, np.exp(t) * 0.3 * mu, 4.0).sum(), bounds=(-3, 3), method="bounded",
        options={"xatol": 1e-10},
    )  # fmt: skip
    assert np.log(found) == pytest.approx(by_search.x, abs=1e-6)


@given(looks=LOOKS)
def test_deviance_is_never_negative(looks: float) -> None:
    ratio = np.exp(np.linspace(-8, 8, 101))
    found = deviance(ratio, np.ones(101), looks)
    assert (found >= 0).all()
    assert found[50] == 0


def test_metrics_written_out() -> None:
    measured, mu = np.array([0.0, 1.0, 2.0, 4.0]), np.array([1.0, 1.0, 1.0, 2.0])
    found = metrics(measured, mu, Law(3.0))
    assert found["rmse"] == pytest.approx(np.sqrt((1 + 0 + 1 + 4) / 4))
    assert found["nrmse"] == pytest.approx(np.sqrt(6 / 4) / np.sqrt(21 / 4))
    assert found["rmse_db"] == pytest.approx(np.sqrt(2 * (10 * np.log10(2)) ** 2 / 3))
    assert found["deviance"] == pytest.approx(2 * 6 * (1 - np.log(2)) / 3 / expected_deviance(3.0))
    assert found["correlation"] == pytest.approx(np.corrcoef(measured, mu)[0, 1])


def test_a_perfect_model_leaves_a_deviance_of_1() -> None:
    """40,000 pixels know it to half a percent; four of those."""
    random = np.random.default_rng(1)
    mu = random.lognormal(0.0, 1.0, 40_000)
    for looks in (1.0, 4.0, 16.0):
        found = metrics(mu * random.gamma(looks, 1 / looks, mu.size), mu, Law(looks))
        assert found["deviance"] == pytest.approx(1.0, abs=0.03)
