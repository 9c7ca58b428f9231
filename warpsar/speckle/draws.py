"""Draws of speckle, white or correlated from pixel to pixel, for a parametric bootstrap."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.fft import fft2, ifft2, next_fast_len
from scipy.special import binom, eval_genlaguerre, gammainc, gammaincc, ndtri, roots_genlaguerre

from warpsar.speckle.compared import ComparedPixels
from warpsar.speckle.law import Law

FIELDS = 4  # complex fields at most
FEW = 4096  # frequencies, under which the noise is drawn as normal variables
TURNS = 30
TABLE = np.linspace(0.0, 10.0, 4001)  # roots of the fields' power, at which the law's quantiles are kept


class Speckle:
    """Standardised gamma speckle on the compared pixels of `observations`; `autocovariance` has shape (lags, lags).

    Correlated: the power of complex Gaussian fields, summed over one for each look, `FIELDS` at most, and taken to the
    law quantile by quantile. About a peak the power of a field falls as its correlation does. A normal variable that is
    taken to the law by itself falls as the square: its peaks are too narrow, and windows too weak.
    """

    def __init__(self, observations: Sequence[ComparedPixels], autocovariance: np.ndarray) -> None:
        self.observations = observations
        self.white = np.count_nonzero(autocovariance) == 1
        self.sd = float(np.sqrt(autocovariance.max()))
        self.spectra = []
        self._power: dict[Law, np.ndarray] = {}  # at `TABLE`
        if not self.white:
            lags = autocovariance.shape[0] // 2
            correlation = autocovariance / autocovariance[lags, lags]
            for seen in self.observations:
                inside = _box(seen.interior)
                kernel = np.zeros([next_fast_len(n + lags) for n in inside.shape])
                if seen.law not in self._power:
                    self._power[seen.law] = _quantiles(seen.law)
                at = np.arange(-lags, lags + 1)
                np.add.at(
                    kernel,
                    (at[:, None] % kernel.shape[0], at % kernel.shape[1]),
                    self._of_fields(correlation, seen.law),
                )
                self.spectra.append((inside, _amplitudes(kernel).astype(np.float32)))

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
                part[:] = self._power_of(self._fields(random, index, draws), law)
            part -= np.float32(1.0)
            part *= np.float32(np.sqrt(looks) * max(self.sd, 1.0))
        return drawn

    def _fields(self, random: np.random.Generator, index: int, draws: int) -> np.ndarray:
        """The root of the fields' power on the compared pixels of one image, shape (pixels, draws).

        White complex noise under a real symmetric spectrum; real and imaginary part have unit variance, and the power
        counts half of their squares.
        """
        inside, spectrum = self.spectra[index]
        power = np.zeros((draws, *inside.shape), np.float32)
        for _ in range(_fields_of(self.observations[index].law)):
            noise = _white(random, (draws, *spectrum.shape))
            noise *= spectrum
            field = ifft2(noise, norm="ortho", overwrite_x=True)[:, : inside.shape[0], : inside.shape[1]]
            squares = np.square(field.view(np.float32))
            one = squares[..., ::2]
            one += squares[..., 1::2]
            one *= np.float32(0.5)
            power += one
        return np.ascontiguousarray(np.sqrt(power[:, inside]).T)

    def _power_of(self, root: np.ndarray, law: Law) -> np.ndarray:
        """The table of quantiles at `root`, interpolated: its steps are equal, so that no step has to be searched."""
        table = self._power[law].astype(np.float32)
        at = root / np.float32(TABLE[1])
        np.minimum(at, np.float32(table.size - 1.0), out=at)
        below = at.astype(np.int32)
        at -= below
        at *= np.diff(table, append=table[-1]).take(below)
        at += table.take(below)
        return at

    def _of_fields(self, correlation: np.ndarray, law: Law) -> np.ndarray:
        """Correlations of fields whose power, taken to the law, has `correlation` (not negative), any shape.

        The Laguerre coefficients c_k of that make it sum(c_k^2 rho^(2 k)) / sum(c_k^2) (Kibble, 1941, in Lancaster,
        1958).
        """
        fields = _fields_of(law)
        x, w = roots_genlaguerre(80, fields - 1)
        power = np.interp(np.sqrt(x), TABLE, self._power[law])
        order = np.arange(1, 25)[:, None]
        laguerre = eval_genlaguerre(order, fields - 1, x) / np.sqrt(binom(order + fields - 1, order))
        shares = (laguerre @ (w / w.sum() * power)) ** 2
        squares = np.linspace(0.0, 1.0, 201)
        return np.sqrt(np.interp(correlation, (squares[:, None] ** order[:, 0]) @ shares / shares.sum(), squares))


def _white(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """White complex noise under a spectrum, complex64, of the shape (draws, rows, columns); parts of unit variance.

    The field of a pixel sums over all frequencies. Over many of them it is normal whatever the noise, and what an image
    has on average scatters by the noise's fourth moment. So three values do, of the normal law's moments up to the
    fifth, which cost a quarter of normal variables.
    """
    if shape[-2] * shape[-1] < FEW:
        return random.standard_normal((*shape, 2), np.float32).view(np.complex64)[..., 0]
    drawn = np.frombuffer(random.bytes(2 * math.prod(shape)), np.uint16)
    return _PAIRS[drawn].reshape(shape)


def _pairs() -> np.ndarray:
    """Both parts of the noise at every number of 16 bits: plus or minus 1.73 in a sixth of all cases each, else 0."""
    end = round(256 / 6)
    values = np.zeros(256, np.float32)
    values[:end], values[-end:] = -math.sqrt(128 / end), math.sqrt(128 / end)
    return (values[:, None] + 1j * values).astype(np.complex64).ravel()


_PAIRS = _pairs()


def correlated_power(random: np.random.Generator, law: Law, amplitudes: np.ndarray) -> np.ndarray:
    """Power of mean 1 whose pixels share speckle, float32, of the shape of `amplitudes`.

    These are the roots of the spectrum of the fields, of mean square 1: the response of a system in the order of
    `scipy.fft.fft2`. So an image has neighbours at its far side. Up to `FIELDS` whole looks it is the mean power of as
    many fields; other laws are reached quantile by quantile.
    """
    power = np.zeros(amplitudes.shape, np.float32)
    for _ in range(_fields_of(law)):
        noise = random.standard_normal((*amplitudes.shape, 2), np.float32).view(np.complex64)[..., 0]
        noise *= amplitudes
        field = ifft2(noise, norm="ortho", overwrite_x=True)
        power += np.float32(0.5) * (field.real**2 + field.imag**2)
    if law.looks == _fields_of(law) and math.isinf(law.texture):
        return power / np.float32(law.looks)
    return np.interp(np.sqrt(power), TABLE, _quantiles(law)).astype(np.float32)


def _amplitudes(kernel: np.ndarray) -> np.ndarray:
    """Roots of a spectrum, of mean square 1, whose correlations are nearly those of `kernel` where it is not 0.

    Correlations that are cut off where they cannot be told from 0 have a spectrum with negative parts. Without these
    all correlations would be too small by up to a fifth. So the lags of no correlation are left free, and spectrum and
    kernel take turns (Papoulis, IEEE Trans. Circuits and Systems 22, 1975).
    """
    found = np.maximum(fft2(kernel).real, 0.0)
    for _ in range(TURNS):
        whole = ifft2(found).real
        whole /= max(whole[0, 0], 1e-30)
        found = np.maximum(fft2(np.where(kernel > 0.0, kernel, whole)).real, 0.0)
    return np.asarray(np.sqrt(found / max(float(found.mean()), 1e-30)))


def _fields_of(law: Law) -> int:
    return int(np.clip(round(law.looks), 1, FIELDS))


def _quantiles(law: Law) -> np.ndarray:
    """The law's power, whose chance is that of the fields', at `TABLE`."""
    power, fields = TABLE**2, _fields_of(law)
    below, above = gammainc(fields, power), gammaincc(fields, power)
    return law.quantiles(np.where(below < 0.5, ndtri(np.maximum(below, 1e-300)), -ndtri(np.maximum(above, 1e-300))))


def _box(interior: np.ndarray) -> np.ndarray:
    """The part of a mask about all its pixels."""
    rows, cols = np.nonzero(interior)
    return interior[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1] if rows.size else interior[:1, :1]
