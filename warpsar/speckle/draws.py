"""Draws of speckle, white or correlated from pixel to pixel, for a parametric bootstrap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import fft2, ifft2, next_fast_len

from warpsar.speckle.compared import Compared
from warpsar.speckle.law import Law


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
        # quantiles of power over those of the normal distribution, once for every law
        self._normal = np.linspace(-7.0, 7.0, 4001)
        self._power: dict[Law, np.ndarray] = {}
        if not self.white:
            lags = autocovariance.shape[0] // 2
            correlation = autocovariance / autocovariance[lags, lags]
            for seen in self.observations:
                inside = _box(seen.interior)
                kernel = np.zeros([next_fast_len(n + lags) for n in inside.shape])
                if seen.law not in self._power:
                    self._power[seen.law] = seen.law.quantiles(self._normal)
                at = np.arange(-lags, lags + 1)
                np.add.at(
                    kernel,
                    (at[:, None] % kernel.shape[0], at % kernel.shape[1]),
                    self._underlying(correlation, seen.law),
                )
                spectrum = np.sqrt(np.maximum(fft2(kernel).real, 0.0))
                if spectrum.any():
                    spectrum /= np.sqrt(np.mean(spectrum**2))
                self.spectra.append((inside, spectrum.astype(np.float32)))

    def __call__(self, random: np.random.Generator, draws: int) -> np.ndarray:
        """Draws of sqrt(L) (I / mu - 1), shape (n, draws), float32: rounding is a millionth of what speckle varies by.

        They are scaled up where the residual varies more than speckle.
        """
        sizes = [int(seen.interior.sum()) for seen in self.observations]
        drawn = np.empty((sum(sizes), draws), np.float32)
        for index, part in enumerate(np.split(drawn, np.cumsum(sizes)[:-1])):
            looks, law = self.observations[index].looks, self.observations[index].law
            if self.white:
                part[:] = law.draw(random, part.shape)
            else:
                part[:] = self._power_of(self._field(random, index, draws), law)
            part -= np.float32(1.0)
            part *= np.float32(np.sqrt(looks) * max(self.sd, 1.0))
        return drawn

    def _field(self, random: np.random.Generator, index: int, draws: int) -> np.ndarray:
        """Correlated normal variables of unit variance on the compared pixels of one image, shape (pixels, draws).

        White complex noise under a real symmetric spectrum: real and imaginary part are two independent fields.
        """
        inside, spectrum = self.spectra[index]
        pairs = -(-draws // 2)
        noise = random.standard_normal((pairs, *spectrum.shape, 2), np.float32).view(np.complex64)[..., 0]
        noise *= spectrum
        field = ifft2(noise, norm="ortho", overwrite_x=True)[:, : inside.shape[0], : inside.shape[1]][:, inside]
        return np.ascontiguousarray(field.T).view(np.float32)[:, :draws]

    def _power_of(self, normal: np.ndarray, law: Law) -> np.ndarray:
        """The table of quantiles at `normal`, interpolated: its steps are equal, so that no step has to be searched."""
        table = self._power[law].astype(np.float32)
        first, step = np.float32(self._normal[0]), np.float32(self._normal[1] - self._normal[0])
        at = np.clip((normal - first) / step, np.float32(0.0), np.float32(table.size - 1.0))
        below = at.astype(np.int32)
        at -= below
        return table.take(below) + at * np.diff(table, append=table[-1]).take(below)

    def _underlying(self, correlation: np.ndarray, law: Law) -> np.ndarray:
        """Correlations of normal variables whose gamma ones have `correlation` (not negative), any shape.

        The transform's Hermite coefficients c_k make it sum(c_k^2 rho^k) / sum(c_k^2) (Lancaster, 1957).
        """
        z, w = np.polynomial.hermite_e.hermegauss(120)
        power = np.interp(z, self._normal, self._power[law])
        order = np.arange(1, 25)
        hermite = np.polynomial.hermite_e.hermevander(z, order[-1])[:, 1:]
        shares = ((w * power) @ hermite) ** 2 / np.cumprod(order.astype(float))
        rho = np.linspace(0.0, 1.0, 201)
        return np.interp(correlation, (rho[:, None] ** order) @ shares / shares.sum(), rho)


def _box(interior: np.ndarray) -> np.ndarray:
    """The part of a mask about all its pixels."""
    rows, cols = np.nonzero(interior)
    return interior[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1] if rows.size else interior[:1, :1]
