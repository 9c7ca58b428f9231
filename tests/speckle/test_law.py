"""The law of speckle with texture against numerical integration of the K distribution, and against draws of it."""

import math

import numpy as np
import pytest
from scipy import integrate, special, stats

from warpsar.speckle.law import Law, looks_of_second

LAWS = [Law(1.0), Law(4.0), Law(1.0, 2.0), Law(4.0, 1.5), Law(16.0, 6.0)]


def density(intensity: float, law: Law) -> float:
    """Of the K distribution (Jakeman and Pusey 1976) with mean 1; of the gamma law without texture."""
    if math.isinf(law.texture):
        return float(stats.gamma.pdf(intensity, law.looks, scale=1.0 / law.looks))
    shape, order = law.looks + law.texture, law.texture - law.looks
    x = law.looks * law.texture * intensity
    constant = 2.0 / (special.gamma(law.looks) * special.gamma(law.texture) * intensity)
    return float(constant * x ** (shape / 2.0) * special.kv(order, 2.0 * math.sqrt(x)))


def expectation(function: object, law: Law) -> float:
    """The integral over ln I, where the density has no singularity."""
    found, _ = integrate.quad(
        lambda z: function(z) * density(math.exp(z), law) * math.exp(z),  # type: ignore[operator]
        -30.0,
        6.0,
        points=[-8.0, -3.0, 0.0, 2.0],
        limit=400,
    )
    return found


@pytest.mark.parametrize("law", LAWS)
def test_moments_are_those_of_the_density(law: Law) -> None:
    assert expectation(lambda z: 1.0, law) == pytest.approx(1.0, rel=1e-7)
    assert expectation(math.exp, law) == pytest.approx(1.0, rel=1e-6)
    assert 1.0 / (expectation(lambda z: math.exp(2.0 * z), law) - 1.0) == pytest.approx(law.equivalent_looks, rel=1e-5)
    mean = expectation(lambda z: z, law)
    assert mean == pytest.approx(law.log_mean, rel=1e-6)
    second, third = expectation(lambda z: (z - mean) ** 2, law), expectation(lambda z: (z - mean) ** 3, law)
    assert (second, third) == pytest.approx((law.log_cumulant(2), law.log_cumulant(3)), rel=1e-5)
    looks = law.equivalent_looks
    deviance = expectation(lambda z: 2.0 * looks * (math.exp(z) - 1.0 - z), law)
    assert law.expected_deviance == pytest.approx(deviance, rel=1e-5)
    square = expectation(lambda z: (2.0 * looks * (math.exp(z) - 1.0 - z) - deviance) ** 2, law)
    assert law.deviance_variance == pytest.approx(square, rel=1e-4)


@pytest.mark.parametrize("law", [*LAWS, Law(4.0, 400.0)])
def test_log_density_is_that_of_the_law(law: Law) -> None:
    intensity = np.array([1e-4, 0.03, 0.5, 1.0, 4.0])
    if law.texture > 100.0:  # the Bessel function overflows for dim pixels; texture of 400 is next to none
        expected = stats.gamma.logpdf(intensity, law.equivalent_looks, scale=1.0 / law.equivalent_looks)
        assert law.log_density(intensity) == pytest.approx(expected, abs=0.2)
    else:
        expected = [math.log(density(one, law)) for one in intensity]
        assert law.log_density(intensity) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_quantiles_are_those_of_the_density(law: Law) -> None:
    normal = np.array([-2.5, -1.0, 0.0, 1.0, 2.5])
    found = law.quantiles(np.linspace(-7.0, 7.0, 4001))
    at = np.interp(normal, np.linspace(-7.0, 7.0, 4001), np.log(found))
    for chance, level in zip(stats.norm.cdf(normal), at, strict=True):
        below, _ = integrate.quad(lambda z: density(math.exp(z), law) * math.exp(z), -40.0, float(level), limit=400)
        # speckle is averaged over 400 quantiles of the texture: 1 % of the chance of a tail
        assert below == pytest.approx(chance, rel=0.03)
    assert law.median == pytest.approx(float(np.exp(at[2])), rel=1e-3)


def test_draws_have_the_law() -> None:
    drawn = Law(4.0, 3.0).draw(np.random.default_rng(0), (400_000,))
    assert stats.kstest(np.log(drawn), lambda z: np.interp(z, *_cdf(Law(4.0, 3.0)))).pvalue > 1e-3


def _cdf(law: Law) -> tuple[np.ndarray, np.ndarray]:
    z = np.linspace(-9.0, 4.0, 3001)
    values = np.array([density(math.exp(one), law) * math.exp(one) for one in z])
    return z, integrate.cumulative_trapezoid(values, z, initial=0.0)


def test_a_law_by_its_equivalent_looks() -> None:
    for law in (Law(3.0), Law(16.0, 6.0), Law(1.0, 0.7)):
        again = Law.of_equivalent(law.equivalent_looks, law.texture)
        assert again.looks == pytest.approx(law.looks, rel=1e-12)
    # texture alone scatters more than that: nothing is left for speckle
    assert math.isinf(Law.of_equivalent(9.0, 6.0).looks)


def test_a_law_by_its_second_cumulant() -> None:
    for looks in (0.5, 1.0, 7.3, 200.0):
        assert looks_of_second(float(special.polygamma(1, looks))) == pytest.approx(looks, rel=1e-5)
    law = Law(5.0, 3.0)
    assert Law.of_second_cumulant(law.log_cumulant(2), 3.0).looks == pytest.approx(5.0, rel=1e-4)
    assert math.isinf(Law.of_second_cumulant(0.1, 3.0).texture)  # texture of 3 alone has more
