"""How the power of a pixel scatters about its mean: gamma speckle, times gamma texture where there is any.

The intensity of L looks is gamma distributed of shape L. Where the mean itself varies from pixel to pixel by a gamma
law of shape nu, the product is K distributed (Jakeman and Pusey, IEEE Trans. Antennas Propag. 24, 1976). The law is
symmetric in L and nu.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import digamma, gammainc, gammaincc, gammainccinv, gammaincinv, gammaln, kve, ndtr, ndtri, polygamma

_NODES = 400  # of the texture's quantiles, over which speckle is averaged


def looks_of_second(second: float) -> float:
    """The looks of a gamma law whose logarithm has the variance `second`: psi'(looks) is that."""
    return float(np.exp(np.interp(-np.log(second), *_looks_by_second())))


@cache
def _looks_by_second() -> tuple[np.ndarray, np.ndarray]:
    """-ln of the second log-cumulant, ascending, and ln of the looks that have it."""
    tried = np.geomspace(1e-2, 1e6, 6001)
    return -np.log(polygamma(1, tried)), np.log(tried)


@dataclass(frozen=True)
class Law:
    """Intensity of mean 1: `looks` of speckle, and `texture`, the shape of the mean's gamma law (infinite: none)."""

    looks: float
    texture: float = math.inf

    @classmethod
    def of_equivalent(cls, equivalent_looks: float, texture: float = math.inf) -> Law:
        """The law with that texture whose mean^2 / variance is `equivalent_looks`."""
        if math.isinf(texture):
            return cls(equivalent_looks)
        left = (1.0 + 1.0 / equivalent_looks) / (1.0 + 1.0 / texture) - 1.0
        return cls(1.0 / left if left > 0 else math.inf, texture)

    @classmethod
    def of_second_cumulant(cls, second: float, texture: float = math.inf) -> Law:
        """The law with that texture whose logarithm has the variance `second`; without texture where it has less."""
        left = second - (0.0 if math.isinf(texture) else float(polygamma(1, texture)))
        return cls(looks_of_second(second)) if left <= 0 else cls(looks_of_second(left), texture)

    @property
    def equivalent_looks(self) -> float:
        """Mean^2 / variance: the looks that a gamma law of this variance has."""
        return 1.0 / ((1.0 + 1.0 / self.looks) * (1.0 + 1.0 / self.texture) - 1.0)

    @property
    def log_mean(self) -> float:
        """E[ln I], the first log-cumulant: psi(L) - ln L, and the same of the texture."""
        return float(sum(digamma(shape) - np.log(shape) for shape in self._shapes))

    def log_cumulant(self, order: int) -> float:
        """The log-cumulant of an order from 2 on: the polygamma function of order - 1, summed over speckle and texture
        (Nicolas, Traitement du Signal 19, 2002)."""
        return float(sum(polygamma(order - 1, shape) for shape in self._shapes))

    @property
    def median(self) -> float:
        """The intensity that half of all pixels exceed."""
        if math.isinf(self.texture):
            return float(gammaincinv(self.looks, 0.5) / self.looks)
        return float(self.quantiles(np.zeros(1))[0])

    @property
    def expected_deviance(self) -> float:
        """E[d] of one pixel about its mean, d = 2 L (I - 1 - ln I) with L the equivalent looks."""
        return -2.0 * self.equivalent_looks * self.log_mean

    @property
    def deviance_variance(self) -> float:
        """Variance of d: I and ln I of a product have the covariance 1 / shape, summed over speckle and texture."""
        looks = self.equivalent_looks
        shared = sum(1.0 / shape for shape in self._shapes)
        return 4.0 * looks**2 * (1.0 / looks + self.log_cumulant(2) - 2.0 * shared)

    def log_density(self, intensity: np.ndarray) -> np.ndarray:
        """ln of the density of intensities > 0 of mean 1, any shape: gamma, or K (Jakeman and Pusey, as above).

        Texture so weak that the Bessel function is beyond a double leaves the gamma law of the equivalent looks.
        """
        gamma_part = sum(shape * np.log(shape) - gammaln(shape) for shape in self._shapes)
        if math.isinf(self.texture):
            return np.asarray(gamma_part + (self.looks - 1.0) * np.log(intensity) - self.looks * intensity)
        order, mean = self.texture - self.looks, 0.5 * (self.looks + self.texture)
        product = self.looks * self.texture
        x = 2.0 * np.sqrt(product * intensity)
        bessel = kve(order, x)
        powers = 0.5 * order * np.log(self.looks / self.texture) + (mean - 1.0) * np.log(intensity)
        with np.errstate(invalid="ignore"):
            found = math.log(2.0) + gamma_part + powers + np.log(bessel) - x
        plain = Law(self.equivalent_looks).log_density(intensity)
        return np.asarray(np.where(np.isfinite(bessel), found, plain))

    def draw(self, random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
        """Independent intensities, float64."""
        drawn = np.ones(shape)
        for one in self._shapes:
            drawn *= random.standard_gamma(one, shape) / one
        return drawn

    def quantiles(self, normal: np.ndarray) -> np.ndarray:
        """The intensities whose chances are those of the normal deviates `normal`, ascending, shape (n,)."""
        if math.isinf(self.texture):
            below = gammaincinv(self.looks, ndtr(normal))
            above = gammainccinv(self.looks, ndtr(-normal))
            return np.asarray(np.where(normal < 0, below, above) / self.looks)
        means = gammaincinv(self.texture, (np.arange(_NODES) + 0.5) / _NODES) / self.texture
        tried = np.exp(np.linspace(-40.0, 8.0, 4001))
        x = self.looks * tried[:, None] / means
        below, above = (np.mean(f(self.looks, x), axis=1) for f in (gammainc, gammaincc))
        # each tail by itself: near 1 a chance has no digits left
        at = np.where(below < 0.5, ndtri(np.maximum(below, 1e-300)), -ndtri(np.maximum(above, 1e-300)))
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(at)) > 0])
        return np.exp(np.interp(normal, at[keep], np.log(tried[keep])))

    @property
    def _shapes(self) -> list[float]:
        return [self.looks] if math.isinf(self.texture) else [self.looks, self.texture]
