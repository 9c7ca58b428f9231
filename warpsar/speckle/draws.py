"""Draws of speckle, white or correlated from pixel to pixel, for a parametric bootstrap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import gamma, norm

from warpsar.speckle.compared import Compared


class Speckle:
    """Standardised gamma speckle on the compared pixels of `observations`; `autocovariance` has shape (lags, lags).

    Correlated: a Gaussian field taken to the gamma distribution quantile by quantile, which lowers correlations (0.72
    to 0.65 at one look); the field's own are as much higher.
    """

    def __init__(self, observations: Sequence[Compared], autocovariance: np.ndarray) -> None:
        self.observations = observations
        self.white = np.count_nonzero(autocovariance) == 1
        self.sd = float(np.sqrt(autocovariance.max()))
        self.spectra = []
        # gamma quantiles over those of the normal distribution, once for every number of looks
        self._normal = np.linspace(-7.0, 7.0, 4001)
        self._power: dict[float, np.ndarray] = {}
        if not self.white:
            lags = autocovariance.shape[0] // 2
            correlation = autocovariance / autocovariance[lags, lags]
            for seen in self.observations:
                kernel = np.zeros([n + 2 * lags for n in seen.interior.shape])
                if seen.looks not in self._power:
                    self._power[seen.looks] = self._quantiles(seen.looks)
                kernel[: 2 * lags + 1, : 2 * lags + 1] = self._underlying(correlation, seen.looks)
                kernel = np.roll(kernel, (-lags, -lags), (0, 1))
                self.spectra.append((kernel.shape, np.sqrt(np.maximum(np.fft.rfft2(kernel).real, 0.0))))

    def __call__(self, random: np.random.Generator, draws: int) -> np.ndarray:
        """Draws of sqrt(L) (I / mu - 1), shape (n, draws); scaled up where the residual varies more than speckle."""
        parts = []
        for index, seen in enumerate(self.observations):
            looks = seen.looks
            if self.white:
                power = random.standard_gamma(looks, (int(seen.interior.sum()), draws)) / looks
            else:
                shape, spectrum = self.spectra[index]
                noise = np.fft.rfft2(random.standard_normal((draws, *shape)))
                rows, cols = seen.interior.shape
                field = np.fft.irfft2(noise * spectrum, shape)[:, :rows, :cols][:, seen.interior].T
                field /= np.sqrt(np.mean(spectrum**2)) if spectrum.any() else 1.0
                power = np.interp(field, self._normal, self._power[looks])
            parts.append(np.sqrt(looks) * (power - 1.0))
        return np.concatenate(parts) * max(self.sd, 1.0)

    def _quantiles(self, looks: float) -> np.ndarray:
        below = gamma.ppf(norm.cdf(self._normal), looks)
        above = gamma.isf(norm.sf(self._normal), looks)
        return np.where(self._normal < 0, below, above) / looks

    def _underlying(self, correlation: np.ndarray, looks: float) -> np.ndarray:
        """Correlations of normal variables whose gamma ones have `correlation` (not negative), any shape.

        The transform's Hermite coefficients c_k make it sum(c_k^2 rho^k) / sum(c_k^2) (Lancaster, 1957).
        """
        z, w = np.polynomial.hermite_e.hermegauss(120)
        power = np.interp(z, self._normal, self._power[looks])
        order = np.arange(1, 25)
        hermite = np.polynomial.hermite_e.hermevander(z, order[-1])[:, 1:]
        shares = ((w * power) @ hermite) ** 2 / np.cumprod(order.astype(float))
        rho = np.linspace(0.0, 1.0, 201)
        return np.interp(correlation, (rho[:, None] ** order) @ shares / shares.sum(), rho)
