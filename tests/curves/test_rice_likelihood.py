"""Rice's density against closed forms, and against simulated measurements."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest, ncx2

from warpsar.curves.likelihood import distribution, log_density, median, slopes

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(("model", "noise"), [(0.0, 1.0), (2.0, 0.5), (1e-3, 1e-4), (1.0, 1e-4)])
def test_the_density_integrates_to_one_and_has_its_mean(model: float, noise: float) -> None:
    ends = (max(model - 12 * np.sqrt(2 * model * noise), 0.0), model + 12 * np.sqrt(2 * model * noise) + 40 * noise)

    def density(p: float) -> float:
        return float(np.exp(log_density(p, model, noise)))

    assert quad(density, *ends, limit=400)[0] == pytest.approx(1.0, abs=1e-6)
    # E |a + n|^2 = M + s
    assert quad(lambda p: p * density(p), *ends, limit=400)[0] == pytest.approx(model + noise, rel=1e-6)


def test_without_a_model_power_is_exponential() -> None:
    p = np.array([0.0, 0.3, 4.0])
    np.testing.assert_allclose(log_density(p, 0.0, 2.0), -p / 2.0 - np.log(2.0), atol=1e-12)
    np.testing.assert_allclose(distribution(p, 0.0, 2.0), 1.0 - np.exp(-p / 2.0), atol=1e-12)
    assert median(0.0, 2.0) == pytest.approx(2.0 * np.log(2.0))


def test_the_density_is_scipys_noncentral_chi_square() -> None:
    p, m, s = np.array([0.1, 1.0, 3.0]), np.array([0.5, 1.0, 2.0]), np.array([0.2, 1.0, 0.3])
    np.testing.assert_allclose(log_density(p, m, s), ncx2.logpdf(2 * p / s, 2, 2 * m / s) + np.log(2 / s), rtol=1e-9)
    np.testing.assert_allclose(distribution(median(m, s), m, s), 0.5, atol=1e-6)


def test_slopes_are_differences() -> None:
    p, m, s = np.array([0.1, 1.0, 3.0, 0.2]), np.array([0.5, 1.0, 2.0, 0.0]), np.array([0.2, 1.0, 0.3, 0.5])
    to_model, to_noise = slopes(p, m, s)
    step = 1e-6
    up = log_density(p, m + step, s) - log_density(p, np.maximum(m - step, 0.0), s)
    np.testing.assert_allclose(to_model[:3], up[:3] / (2 * step), rtol=1e-5)
    assert to_model[3] == pytest.approx(up[3] / step, rel=1e-4)  # one-sided: power is not below 0
    np.testing.assert_allclose(
        to_noise, (log_density(p, m, s + step) - log_density(p, m, s - step)) / (2 * step), rtol=1e-5
    )


def test_simulated_measurements_have_uniform_p_values() -> None:
    rng = np.random.default_rng(3)
    model, noise = rng.uniform(0.0, 3.0, 1500), rng.uniform(0.1, 1.0, 1500)
    n = np.sqrt(noise / 2) * (rng.normal(size=1500) + 1j * rng.normal(size=1500))
    measured = np.abs(np.sqrt(model) + n) ** 2
    assert kstest(distribution(measured, model, noise), "uniform").pvalue > 0.01
