"""Clipped pixels: their loss against closed forms and SciPy, its derivatives, and what it repairs."""

import numpy as np
import pytest
import warp as wp
from scipy import stats
from scipy.optimize import minimize_scalar

from warpsar.kernels import loss as loss_kernels
from warpsar.runtime.structs import fill
from warpsar.speckle.likelihood import best_gain, curvature, hazard, loss_terms, minus_log_survival, survival_curvature

pytestmark = pytest.mark.unit

RATIOS = np.exp(np.linspace(-4.0, 6.0, 41))  # of level over model


@pytest.mark.parametrize("looks", [0.7, 1.0, 2.0, 4.5, 16.0])
def test_loss_is_scipys_survival(looks: float) -> None:
    near = RATIOS[looks * RATIOS < 600.0]  # SciPy's survival is 0 beyond
    expected = -stats.gamma(looks, scale=1.0 / looks).logsf(near)
    np.testing.assert_allclose(minus_log_survival(near, np.ones(near.size), looks), expected, rtol=1e-9, atol=1e-15)


def test_closed_forms_of_one_and_two_looks() -> None:
    """Q(1, x) = e^-x and Q(2, x) = (1 + x) e^-x, also where both are 0 in floating point."""
    x = np.concatenate([RATIOS, [1e4, 1e6]])
    one = np.ones(x.size)
    np.testing.assert_allclose(minus_log_survival(x, one, 1.0), x, rtol=1e-12)
    np.testing.assert_allclose(minus_log_survival(x, 2.0 * one, 2.0), x - np.log1p(x), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(hazard(x, one, 1.0), x, rtol=1e-12)
    np.testing.assert_allclose(hazard(x, 2.0 * one, 2.0), x**2 / (1.0 + x), rtol=1e-9)


@pytest.mark.parametrize("looks", [0.7, 1.0, 3.3, 16.0])
def test_slope_and_curvature_are_differences(looks: float) -> None:
    """To ln mu; second differences of a loss of up to 6000 are good to 1e-16 * 6000 / step^2."""
    one = np.ones(RATIOS.size)

    def loss(t: float) -> np.ndarray:
        return minus_log_survival(RATIOS, np.exp(t) * one, looks)

    slope = hazard(RATIOS, one, looks)
    np.testing.assert_allclose(-slope, (loss(1e-5) - loss(-1e-5)) / 2e-5, rtol=1e-6, atol=1e-9)
    second = (loss(1e-3) - 2.0 * loss(0.0) + loss(-1e-3)) / 1e-6
    np.testing.assert_allclose(survival_curvature(slope, RATIOS, one, looks), second, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("bound", [0.0, 5.0])
@pytest.mark.parametrize("looks", [0.8, 1.0, 4.0])
def test_kernel_adds_up_the_same_and_has_its_slope(looks: float, bound: float) -> None:
    """float32 losses; a level of up to 40 times the model, where Q is e^-40 and less."""
    random = np.random.default_rng(1)
    mu = random.uniform(0.05, 2.0, 50)
    measured = np.minimum(mu * random.gamma(looks, 1.0 / looks, 50), 1.0)
    measured[:10] = 1.0
    from scipy.special import gammaln

    values = {"requires_grad": True, "device": "cpu"}
    image = wp.array(mu.astype(np.float32), dtype=float, **values)
    total = wp.zeros(int(loss_kernels.PARTIALS), dtype=wp.float64, **values)
    constants = fill(
        loss_kernels.LossConstants,
        kind=0,
        looks=looks,
        weight=1.0,
        bound=bound,
        top=1.0,
        log_gamma=float(gammaln(looks)),
    )
    observed = fill(
        loss_kernels.ObservedPixels,
        pixel=wp.array(np.arange(50), dtype=int, device="cpu"),
        measured=wp.array(measured, dtype=float, device="cpu"),
        darkest=wp.array([1e-18], dtype=float, device="cpu"),
    )
    inputs = [constants, observed, image, wp.ones(1, dtype=float, device="cpu"), 0]
    with wp.Tape() as tape:
        wp.launch(loss_kernels.loss_kernel, 50, inputs, outputs=[total], device="cpu")
    tape.backward(grads={total: wp.ones(total.size, dtype=wp.float64, device="cpu")})
    terms = loss_terms("gamma", measured, mu, looks, bound, top=1.0)
    assert total.numpy().sum() == pytest.approx(terms.sum(), rel=2e-5)
    found = curvature("gamma", measured, mu, looks, 1.0, bound, top=1.0)
    np.testing.assert_allclose(image.grad.numpy() * mu, -found.weight * found.residual, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("looks", [0.8, 1.0, 4.0])
@pytest.mark.parametrize("bound", [0.0, 0.5, 20.0])
@pytest.mark.parametrize("top", [4.0, np.inf])
def test_the_gain_minimises_the_loss(looks: float, bound: float, top: float) -> None:
    """By SciPy's search of the same loss, which sums ever so little more a millionth beside it."""
    random = np.random.default_rng(2)
    mu = random.uniform(0.5, 2.0, 400)
    measured = np.minimum(3.0 * mu * random.gamma(looks, 1.0 / looks, 400), top)
    gain = best_gain("gamma", measured, mu, looks, bound, top)
    found = minimize_scalar(
        lambda x: loss_terms("gamma", measured, np.exp(x) * mu, looks, bound, top).sum(),
        bounds=(np.log(gain) - 0.5, np.log(gain) + 0.5),
        method="bounded",
        options={"xatol": 1e-9},
    )
    assert np.log(gain) == pytest.approx(found.x, abs=1e-6)


def test_a_clip_taken_for_a_measurement_makes_everything_dark() -> None:
    """40000 pixels of one look and power 1, clipped at 1: censored they tell the power, as measured they do not.

    Of the estimate the standard deviation is near 1 / sqrt(pixels that were not clipped) = 0.6 %.
    """
    random = np.random.default_rng(3)
    measured = np.minimum(random.gamma(1.0, 1.0, 40000), 1.0)
    mu = np.ones(measured.size)
    assert best_gain("gamma", measured, mu, 1.0, top=1.0) == pytest.approx(1.0, abs=0.03)
    assert best_gain("gamma", measured, mu, 1.0) < 0.7


def test_without_a_level_nothing_changes() -> None:
    measured, mu = RATIOS, np.ones(RATIOS.size)
    assert np.array_equal(loss_terms("gamma", measured, mu, 2.0), loss_terms("gamma", measured, mu, 2.0, top=1e9))
