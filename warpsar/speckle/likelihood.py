"""Losses and metrics between measured and modelled power, and the values that speckle alone gives them.

I: measured beta0; mu: modelled beta0; L: looks. Intensity of L looks is gamma distributed about mu (docs/physics.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import digamma, polygamma

LOSSES = {"gamma": 0, "mse": 1, "log": 2}  # codes of kernels/loss.py


def expected_deviance(looks: float) -> float:
    """E[d] = 2 L (ln L - psi(L)), the deviance of one pixel of pure speckle."""
    return float(2.0 * looks * (np.log(looks) - digamma(looks)))


def log_bias(looks: float) -> float:
    """E[ln(I / mu)] = psi(L) - ln L."""
    return -expected_deviance(looks) / (2.0 * looks)


def deviance(measured: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """d = 2 L (I / mu - 1 - ln(I / mu)) per pixel, any shape."""
    ratio = measured / modelled
    return 2.0 * looks * (ratio - 1.0 - np.log(ratio))


@dataclass(frozen=True)
class Curvature:
    """A loss as weighted least squares in ln mu; both arrays have a value for each pixel.

    Its gradient is -sum(weight * residual * d ln mu), and its Hessian is near sum(weight * d ln mu * d ln mu).
    """

    residual: np.ndarray
    weight: np.ndarray


def curvature(loss: str, measured: np.ndarray, modelled: np.ndarray, looks: float, weight: float) -> Curvature:
    """Fisher scoring for the gamma likelihood, Gauss-Newton for the other two; `weight` as in `loss_weight`."""
    if loss == "gamma":
        return Curvature(measured / modelled - 1.0, np.full(measured.shape, weight * looks))
    if loss == "mse":
        return Curvature(measured / modelled - 1.0, weight * modelled**2)
    return Curvature(np.log(measured / modelled) - log_bias(looks), np.full(measured.shape, weight))


def residual_sd(loss: str, looks: float) -> float:
    """Standard deviation that speckle alone gives the residual of `curvature`."""
    return float(np.sqrt(polygamma(1, looks) if loss == "log" else 1.0 / looks))


def loss_weight(loss: str, looks: float, mean_square: float) -> float:
    """The factor on a pixel's loss that makes it about a negative log-likelihood.

    gamma: 1. mse (constant variance, equation 38): 1 / mean(I^2), the images' common scale. log: 1 / psi'(L), the
    variance of ln I.
    """
    if loss == "mse":
        return 1.0 / mean_square
    return 1.0 if loss == "gamma" else float(1.0 / polygamma(1, looks))


def best_gain(loss: str, measured: np.ndarray, modelled: np.ndarray, looks: float) -> float:
    """The factor on `modelled` that minimises the loss, in closed form."""
    if loss == "gamma":
        return float(np.mean(measured / modelled))
    if loss == "mse":
        return float(np.sum(measured * modelled) / np.sum(modelled**2))
    return float(np.exp(np.mean(np.log(measured / modelled)) - log_bias(looks)))


def loss_terms(loss: str, measured: np.ndarray, modelled: np.ndarray, looks: float) -> np.ndarray:
    """Loss of every pixel in float64: what kernels/loss.py adds up, without the weight."""
    if loss == "mse":
        return 0.5 * (measured - modelled) ** 2
    if loss == "gamma":
        return 0.5 * deviance(measured, modelled, looks)
    return 0.5 * (np.log(measured / modelled) - log_bias(looks)) ** 2


def metrics_of(moments: np.ndarray, pixels: int, looks: float) -> dict[str, float]:
    """`metrics` of `pixels` pixels from the sums of kernels/metrics.py, shape (9,), float64."""
    i, ii, mu, mumu, imu, error = moments[:6] / pixels
    both, logarithm, excess = moments[6:]
    spread = np.sqrt(max(ii - i**2, 0.0) * max(mumu - mu**2, 0.0))
    rmse = float(np.sqrt(error))
    return {
        "rmse": rmse,
        "nrmse": rmse / float(np.sqrt(ii)),
        "rmse_db": float(10.0 / np.log(10.0) * np.sqrt(logarithm / both)),
        "deviance": float(2.0 * looks * excess / both / expected_deviance(looks)),
        "correlation": float((imu - i * mu) / spread) if spread > 0 else float("nan"),
    }


METRICS = ("rmse", "nrmse", "rmse_db", "deviance", "correlation")


def metrics(measured: np.ndarray, modelled: np.ndarray, looks: float) -> dict[str, float]:
    """rmse (beta0), nrmse = rmse / rms(I), rmse_db and deviance / E[d] over pixels where both are positive, and
    correlation, of flat arrays of the pixels that are compared (docs/evaluate.md)."""
    error = measured - modelled
    positive = (measured > 0) & (modelled > 0)
    i, mu = measured[positive], modelled[positive]
    rmse = float(np.sqrt(np.mean(error**2)))
    spread = measured.std() * modelled.std()
    covariance = np.mean((measured - measured.mean()) * (modelled - modelled.mean()))
    return {
        "rmse": rmse,
        "nrmse": rmse / float(np.sqrt(np.mean(measured**2))),
        "rmse_db": float(np.sqrt(np.mean((10.0 * np.log10(i / mu)) ** 2))),
        "deviance": float(np.mean(deviance(i, mu, looks)) / expected_deviance(looks)),
        "correlation": float(covariance / spread) if spread > 0 else float("nan"),
    }
