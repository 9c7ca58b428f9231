"""Measured against modelled power: losses, their values for pure speckle, and the metrics that are reported.

I: measured beta0; mu: modelled beta0; L: looks. The intensity of one channel at L looks is gamma distributed about mu
(docs/learn.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc, gammaln, polygamma

from warpsar.speckle.law import Law

TINY = 1e-12  # a clipped pixel that is modelled far over its level bends the loss no more
LOSSES = {"gamma": 0, "mse": 1, "log": 2}  # codes of kernels/loss.py


def expected_deviance(looks: float) -> float:
    """E[d] = 2 L (ln L - psi(L)), the deviance of one pixel of pure speckle."""
    return Law(looks).expected_deviance


def log_bias(looks: float) -> float:
    """E[ln(I / mu)] = psi(L) - ln L."""
    return Law(looks).log_mean


def deviance(measured: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """d = 2 L (I / mu - 1 - ln(I / mu)) per pixel, any shape."""
    ratio = measured / modelled
    return 2.0 * looks * (ratio - 1.0 - np.log(ratio))


def scaled_deviance(measured: np.ndarray, modelled: np.ndarray, law: Law) -> np.ndarray:
    """d / E[d] of each pixel, any shape: 1 on average where the law alone is left."""
    return deviance(measured, modelled, law.equivalent_looks) / law.expected_deviance


@dataclass(frozen=True)
class Curvature:
    """A loss as weighted least squares in ln mu; both arrays have a value for each pixel.

    Its gradient is -sum(weight * residual * d ln mu), and its Hessian is near sum(weight * d ln mu * d ln mu).
    """

    residual: np.ndarray
    weight: np.ndarray


def bounded(terms: np.ndarray, bound: float) -> np.ndarray:
    """b ln(1 + t / b) of gamma losses t (half deviances), any shape; t itself where the bound b is 0.

    A pixel that the model misses a thousandfold costs thousands. A few such pixels decide where everything else lies.
    The logarithm takes that from them, and its slope still says which way is better: Cauchy's function of the deviance
    residual sqrt(2 t) (Holland and Welsch, Communications in Statistics A6, 1977). It moves the estimate of pure
    speckle's mean in second order of 1 / b alone, since E[(r - 1) (r - 1 - ln r)] = 0 for r of the gamma distribution.
    """
    return bound * np.log1p(terms / bound) if bound > 0 else terms


def _shares(terms: np.ndarray, bound: float) -> np.ndarray:
    """What `bounded` leaves of every pixel's slope: 1 / (1 + t / b)."""
    return 1.0 / (1.0 + terms / bound) if bound > 0 else np.ones(terms.shape)


def curvature(
    loss: str,
    measured: np.ndarray,
    modelled: np.ndarray,
    looks: float,
    weight: float,
    bound: float = 0.0,
    top: float = np.inf,
) -> Curvature:
    """Fisher scoring for the gamma likelihood, Gauss-Newton for the other two; `weight` as in `loss_weight`.

    Where the gamma loss has a `bound`, every pixel's weight is its share of the slope (reweighted least squares).
    Pixels that measured `top` or more are clipped, as in `loss_terms`; their curvature is exact.
    """
    if loss == "gamma" and (clipped := measured >= top).any():
        shares = _shares(loss_terms(loss, measured, modelled, looks, top=top), bound)
        residual, weights = measured / modelled - 1.0, np.full(measured.shape, float(looks))
        above = modelled[clipped]  # few pixels are clipped, and a survival costs as much as fifty deviances
        level = np.full(above.shape, top)
        slope = hazard(level, above, looks)
        weights[clipped] = np.maximum(survival_curvature(slope, level, above, looks), TINY)
        residual[clipped] = slope / weights[clipped]
        return Curvature(residual, weight * shares * weights)
    if loss == "gamma":
        shares = _shares(0.5 * deviance(measured, modelled, looks), bound)
        return Curvature(measured / modelled - 1.0, weight * looks * shares)
    if loss == "mse":
        return Curvature(measured / modelled - 1.0, weight * modelled**2)
    return Curvature(np.log(measured / modelled) - log_bias(looks), np.full(measured.shape, weight))


def residual_sd(loss: str, looks: float) -> float:
    """Standard deviation that speckle alone gives the residual of `curvature`."""
    return float(np.sqrt(polygamma(1, looks) if loss == "log" else 1.0 / looks))


def loss_weight(loss: str, looks: float, mean_square: float) -> float:
    """The factor that makes a pixel's loss about a log-likelihood.

    gamma: 1. mse (constant variance, equation 38): 1 / mean(I^2), the images' common scale. log: 1 / psi'(L), the
    variance of ln I.
    """
    if loss == "mse":
        return 1.0 / mean_square
    return 1.0 if loss == "gamma" else float(1.0 / polygamma(1, looks))


GAIN_TURNS = 30  # of the reweighted mean, at most
SAME_GAIN = 1e-8  # of a logarithm: the loss is level at the best gain, and differs by the square of it
NEAR_GAIN = 1e-2  # the same where another method goes on from there
CONTRACTS = 0.95  # share of a turn's step that the next one takes, up to which the steps are summed to their end


def _settled(turn: Callable[[float], float], start: float, same: float = SAME_GAIN) -> float:
    """Where turns lead to, in the logarithm of a gain: steps shrink by a constant share, so that two of them tell the
    sum of all (Aitken's delta-squared process). They have arrived where a step is no longer than `same`."""
    x = start
    for _ in range(GAIN_TURNS // 2):
        first = turn(x)
        second = turn(first)
        if abs(second - first) <= same:
            return second
        share = (second - first) / (first - x)
        x = first + (second - first) / (1.0 - share) if abs(share) < CONTRACTS else second
    return x


def best_gain(
    loss: str, measured: np.ndarray, modelled: np.ndarray, looks: float, bound: float = 0.0, top: float = np.inf
) -> float:
    """The factor on `modelled` that minimises the loss, in closed form; with a `bound` by reweighted means, and with
    pixels clipped at `top` by Newton's method in its logarithm, from the gain of pixels that nothing clipped."""
    if loss == "gamma":
        ratio = measured / modelled
        clipped = measured >= top
        some = bool(clipped.any())
        x = _bounded_mean(ratio, looks, bound, NEAR_GAIN if some else SAME_GAIN)
        if some:
            x = _settled(_newton(ratio, clipped, top / modelled[clipped], looks, bound), x)
        return float(np.exp(x))
    if loss == "mse":
        return float(np.sum(measured * modelled) / np.sum(modelled**2))
    return float(np.exp(np.mean(np.log(measured / modelled)) - log_bias(looks)))


def _bounded_mean(ratio: np.ndarray, looks: float, bound: float, same: float) -> float:
    """The logarithm of the mean of `ratio`, each pixel weighted by its share of the slope."""
    if bound <= 0:
        return float(np.log(np.mean(ratio)))
    return bounded_level(ratio, np.log(ratio), looks, bound, float(np.log(np.median(ratio))), same)


def bounded_level(
    ratio: np.ndarray, logarithm: np.ndarray, looks: float, bound: float, start: float, same: float = SAME_GAIN
) -> float:
    """The logarithm of the gain of least bounded gamma loss, sought from `start` on. `ratio`: measured over modelled
    power. Its `logarithm` is handed on, because it costs most: many gains are sought of the same pixels."""

    def turn(x: float) -> float:
        shares = _shares(looks * (ratio * np.exp(-x) - (1.0 - x) - logarithm), bound)
        return float(np.log(shares @ ratio / shares.sum()))

    return _settled(turn, start, same)


def _newton(
    ratio: np.ndarray, clipped: np.ndarray, levels: np.ndarray, looks: float, bound: float
) -> Callable[[float], float]:
    """A turn of Newton's method in the logarithm of the gain, as `curvature` has slopes and weights. `levels`: the top
    over what is modelled of the pixels that are `clipped`."""
    free = ratio[~clipped]
    logarithm = np.log(free)
    one = np.ones(levels.shape)

    def turn(x: float) -> float:
        over = free * np.exp(-x)
        weights = looks * _shares(looks * (over - (1.0 - x) - logarithm), bound)
        level = levels * np.exp(-x)
        slope = hazard(level, one, looks)
        bent = np.maximum(survival_curvature(slope, level, one, looks), TINY)
        argument = looks * level
        lost = (
            np.log(slope) - looks * np.log(argument) + argument + gammaln(looks)
        )  # -ln Q, by the hazard's own equation
        shares = _shares(lost, bound)
        total = float(weights @ over - weights.sum() + shares @ slope)
        return x + total / float(weights.sum() + shares @ bent)

    return turn


def loss_terms(
    loss: str,
    measured: np.ndarray,
    modelled: np.ndarray,
    looks: float,
    bound: float = 0.0,
    top: float = np.inf,
) -> np.ndarray:
    """Loss of every pixel, float64, without the weight; kernels/loss.py adds up the same.

    A pixel that measured `top` or more was clipped there. Its gamma loss is -ln P(I >= top), Tobin's censored
    likelihood (Econometrica 26, 1958); `top` has the unit of `measured`.
    """
    if loss == "mse":
        return 0.5 * (measured - modelled) ** 2
    if loss == "gamma":
        terms = 0.5 * deviance(measured, modelled, looks)
        if (clipped := measured >= top).any():
            above = modelled[clipped]
            terms[clipped] = minus_log_survival(np.full(above.shape, top), above, looks)
        return bounded(terms, bound)
    return 0.5 * (np.log(measured / modelled) - log_bias(looks)) ** 2


METRICS = ("rmse", "nrmse", "rmse_db", "deviance", "correlation")


def metrics(measured: np.ndarray, modelled: np.ndarray, law: Law) -> dict[str, float]:
    """How well a modelled image agrees with a measured one, both flat arrays of the pixels compared.

    `rmse` [beta0]; `nrmse` = rmse / rms(I); `correlation`; and over the pixels where both are positive `rmse_db` and
    `deviance`, the mean deviance over E[d].
    """
    positive = (measured > 0) & (modelled > 0)
    i, mu = measured[positive], modelled[positive]
    return _metrics(
        error=np.mean((measured - modelled) ** 2),
        power=np.mean(measured**2),
        rmse_db=np.sqrt(np.mean((10.0 * np.log10(i / mu)) ** 2)),
        deviance=np.mean(scaled_deviance(i, mu, law)),
        covariance=np.mean((measured - measured.mean()) * (modelled - modelled.mean())),
        spread=measured.std() * modelled.std(),
    )


def metrics_of(moments: np.ndarray, pixels: int, law: Law) -> dict[str, float]:
    """`metrics` of `pixels` pixels from the sums of kernels/metrics.py, shape (9,), float64."""
    i, ii, mu, mumu, imu, error = moments[:6] / pixels
    both, logarithm, excess = moments[6:]
    return _metrics(
        error=error,
        power=ii,
        rmse_db=10.0 / np.log(10.0) * np.sqrt(logarithm / both),
        deviance=2.0 * law.equivalent_looks * excess / both / law.expected_deviance,
        covariance=imu - i * mu,
        spread=np.sqrt(max(ii - i**2, 0.0) * max(mumu - mu**2, 0.0)),
    )


def _metrics(
    *, error: float, power: float, rmse_db: float, deviance: float, covariance: float, spread: float
) -> dict[str, float]:
    """Metrics from the mean squares of the error and of I, and the product of both images' standard deviations."""
    rmse = float(np.sqrt(error))
    return {
        "rmse": rmse,
        "nrmse": rmse / float(np.sqrt(power)),
        "rmse_db": float(rmse_db),
        "deviance": float(deviance),
        "correlation": float(covariance / spread) if spread > 0 else float("nan"),
    }


# ---- pixels that a product clipped


_FAR = 200.0  # x from which the asymptotic series is right to rounding for the looks of images; Q is not yet 0 there
_TERMS = 12


def minus_log_survival(level: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """-ln P(I >= level), the loss of clipped pixels; any shape."""
    x = looks * np.asarray(level / modelled, float)
    near, far = np.minimum(x, _far(looks)), np.maximum(x, _far(looks))
    if np.array_equal(x, near):  # the series costs as much as the rest, and is rarely asked for
        return np.asarray(-np.log(gammaincc(looks, near)))
    scaled = far - (looks - 1.0) * np.log(far) + gammaln(looks) - np.log(_tail(far, looks))
    return np.where(x > near, scaled, -np.log(gammaincc(looks, near)))


def hazard(level: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """h = x^L e^-x / (Gamma(L) Q(L, x)): minus the derivative of `minus_log_survival` to ln mu; any shape."""
    x = looks * np.asarray(level / modelled, float)
    near, far = np.minimum(x, _far(looks)), np.maximum(x, _far(looks))
    density = np.exp(looks * np.log(near) - near - gammaln(looks)) / gammaincc(looks, near)
    if np.array_equal(x, near):
        return np.asarray(density)
    return np.where(x > near, far / _tail(far, looks), density)


def survival_curvature(hazards: np.ndarray, level: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """The second derivative of `minus_log_survival` to ln mu, h (L - x + h), never negative; any shape."""
    x = looks * level / modelled
    return np.maximum(hazards * (looks - x + hazards), 0.0)


def _far(looks: float) -> float:
    return max(_FAR, 20.0 * looks)


def _tail(x: np.ndarray, looks: float) -> np.ndarray:
    """Q Gamma(L) e^x x^(1 - L) for large x: 1 + (L - 1) / x + (L - 1)(L - 2) / x^2 + ... (DLMF 8.11.2)."""
    total, term = np.ones_like(x), np.ones_like(x)
    for k in range(1, _TERMS):
        term = term * (looks - k) / x
        total = total + term
    return np.asarray(total)
