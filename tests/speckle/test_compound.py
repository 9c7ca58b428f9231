"""The G0 law of few scatterers against its integral, its mean, its limit and its own draws."""

import numpy as np
import pytest
from scipy import integrate, stats

from warpsar.speckle.compound import likeliest_order, minus_log_density

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(("looks", "order"), [(1.0, 2.5), (0.8, 4.0), (4.0, 1.7)])
def test_density_is_one_and_has_its_mean(looks: float, order: float) -> None:
    """By quadrature in ln I; tails of I^-order beyond e^40 hold less than 1e-6 of the mean."""

    def weight(t: float, power: float) -> float:
        value = np.exp(t)
        return float(np.exp(-minus_log_density(np.array(value), np.array(3.0), looks, order)) * value ** (1.0 + power))

    whole = integrate.quad(lambda t: weight(t, 0.0), -60.0, 60.0, limit=400)[0]
    mean = integrate.quad(lambda t: weight(t, 1.0), -60.0, 60.0, limit=400)[0]
    assert whole == pytest.approx(1.0, rel=1e-6)
    assert mean == pytest.approx(3.0, rel=1e-5)


def test_it_is_speckle_about_an_inverse_gamma_mean() -> None:
    """The mixture's integral, worked out by quadrature over the mean."""
    looks, order, power = 2.0, 3.0, 1.4
    texture = stats.invgamma(order, scale=order - 1.0)

    def both(mean: float) -> float:
        return float(stats.gamma(looks, scale=mean / looks).pdf(power) * texture.pdf(mean))

    expected = integrate.quad(both, 0.0, np.inf)[0]
    found = minus_log_density(np.array(power), np.array(1.0), looks, order)
    assert np.exp(-found) == pytest.approx(expected, rel=1e-6)


def test_a_large_order_is_plain_speckle() -> None:
    power = np.exp(np.linspace(-5.0, 2.0, 30))
    gamma = -stats.gamma(1.5, scale=1.0 / 1.5).logpdf(power)
    np.testing.assert_allclose(minus_log_density(power, np.ones(30), 1.5, 1e7), gamma, atol=1e-5)


@pytest.mark.parametrize("order", [1.8, 4.0])
def test_the_order_is_found(order: float) -> None:
    """20000 pixels of one look: the order within some 5 %, the level within 5 %."""
    random = np.random.default_rng(4)
    texture = stats.invgamma(order, scale=order - 1.0).rvs(20000, random_state=random)
    measured = 2.0 * texture * random.gamma(1.0, 1.0, 20000)
    found, factor = likeliest_order(measured, np.ones(20000), 1.0)
    assert found == pytest.approx(order, rel=0.1)
    assert factor == pytest.approx(2.0, rel=0.1)


def test_an_order_of_one_is_refused() -> None:
    with pytest.raises(ValueError, match="must be above 1"):
        minus_log_density(np.ones(1), np.ones(1), 1.0, 1.0)
