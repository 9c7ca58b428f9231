"""The azimuth spectrum of a complex image, and how well locally constant power explains it under a phase.

The samples of a row are circular Gaussian speckle, whose power is constant over a window of some cells. The likelihood
of that, with the mean power of the window in place of the true one, is -ln of this mean, summed over the samples.
Beside a power that is constant along the row it is the contrast of the row, ln(mean I) - mean ln I, with I smoothed
over the window. Points and edges that are sharp leave much of the image dark, and raise it. Speckle of a homogeneous
ground has the same distribution under any phase: there the contrast says nothing.

What a window does to the spectrum is taken back in part. A phase turns the ends of the band most, and there a window
leaves the least. Taken back whole, it would raise the sidelobes of bright points, which cover what is dark about them:
the square root of the level is a fair mean (docs/diagnosis-method.md compares).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import uniform_filter

F64 = NDArray[np.float64]
BORDER_CELLS = 8
"""Cells at either end of a row that are left out, as a phase moves power over the ends; and cells of nothing beyond."""
WINDOW_CELLS = 2.5
"""Over which power counts as constant."""
DARKEST = 1e-3
"""Of the mean power of all rows: what is darker is taken for noise."""
LEVEL_SHARE = 0.5
"""Of the level of the amplitude spectrum, as an exponent, that is taken out."""
LEVEL_DEGREE = 6
"""Of the polynomial along the aperture that the logarithm of the mean power spectrum is fitted by."""
_LEAST_LEVEL = 1e-2
"""Of the largest power of the spectrum: a band whose ends hold less is taken to have so much."""
_BLOCK_WINDOWS = 2
"""Of a block of rows."""
_ALIKE = 0.02
"""A range changes the phase of all ranges where the squares of `AzimuthSpectrum.stretch` differ by more."""


@dataclass(frozen=True)
class AzimuthSpectrum:
    """Rows of an image in azimuth frequency."""

    spectrum: NDArray[np.complex64]
    """(rows, frequencies) inside the aperture's band."""
    place: F64
    """Of each frequency along the aperture, (frequencies,), -1 to 1: that of the antenna along azimuth."""
    index: NDArray[np.int64]
    """Of each frequency in the transform, (frequencies,)."""
    length: int
    """Of the transform."""
    inside: slice
    """Columns that count."""
    window: tuple[int, int]
    """Rows and columns of the window."""
    aside: F64
    """Of each row, (rows,): the sine of the angle between its look direction and that of the reference point, over the
    largest of the image, -1 to 1. 0 where it is not known."""
    stretch: F64
    """Of each row, (rows,): how far along the track an azimuth frequency lies, beside where it does at the range of the
    reference point. The antenna is seen under the same angle from further away, so this is the ratio of both ranges."""

    @classmethod
    def of(
        cls,
        image: NDArray[np.complex64],
        spacing_m: tuple[float, float],
        cells_m: tuple[float, float],
        aside: F64 | None = None,
        stretch: F64 | None = None,
    ) -> AzimuthSpectrum:
        """Of an image (rows, columns), zero where nothing was measured. `cells_m`: of the whole band in range, and of
        the whole aperture in azimuth, whose band is 1 / cell. Rows without power are left out.

        The square root of the spectrum's level is taken out. A `stretch` that changes phases by a few hundredths at
        most is left out: it costs time, and an image of polar format has none."""
        border = int(np.ceil(BORDER_CELLS * cells_m[1] / spacing_m[1]))
        length = fft.next_fast_len(image.shape[1] + border)
        place = -2.0 * cells_m[1] * fft.fftfreq(length, spacing_m[1])
        index = np.flatnonzero(np.abs(place) <= 1.0)
        found = fft.fft(image, length, axis=1)[:, index].astype(np.complex64)
        some = (np.abs(found) ** 2).sum(axis=1) > 0.0
        found, ratio = found[some], np.zeros(len(image)) if aside is None else aside
        found /= (_level(found, place[index]) ** LEVEL_SHARE).astype(np.float32)
        known = np.ones(len(image)) if stretch is None or np.ptp(stretch**2) <= _ALIKE else stretch
        rows, columns = (2 * int(0.5 * WINDOW_CELLS * c / s) + 1 for c, s in zip(cells_m, spacing_m, strict=True))
        inside = slice(border, image.shape[1] - border)
        return cls(found, place[index], index, length, inside, (rows, columns), ratio[some], known[some])

    def __len__(self) -> int:
        return len(self.spectrum)

    @property
    def stretched(self) -> bool:
        """Whether the phase that all ranges share changes with range after all."""
        return bool((self.stretch != 1.0).any())

    def row_blocks(self) -> NDArray[np.int64]:
        """The block of neighbours that each row belongs to, (rows,): blocks hardly depend on each other."""
        blocks = max(2, len(self) // (_BLOCK_WINDOWS * self.window[0]))
        return np.arange(len(self)) * blocks // len(self)

    def with_spectrum(self, spectrum: NDArray[np.complex64]) -> AzimuthSpectrum:
        return replace(self, spectrum=spectrum)

    @staticmethod
    def joined(parts: Sequence[AzimuthSpectrum]) -> AzimuthSpectrum:
        """The rows of all, one part after the other."""
        both = parts[0].with_spectrum(np.concatenate([one.spectrum for one in parts]))
        aside, stretch = (np.concatenate([getattr(one, name) for one in parts]) for name in ("aside", "stretch"))
        return replace(both, aside=aside, stretch=stretch)

    def turned(self, phase: F64) -> AzimuthSpectrum:
        """With a phase (frequencies,) or (rows, frequencies) [rad] added."""
        return self.with_spectrum(self.spectrum * turns(phase))

    def speckle(self, random: np.random.Generator) -> AzimuthSpectrum:
        """Homogeneous speckle in place of the rows, with their mean power spectra in range and in azimuth."""
        drawn = random.standard_normal((*self.spectrum.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        power = (np.abs(self.spectrum) ** 2).mean(axis=1, keepdims=True)
        across = fft.fft(self.spectrum / np.sqrt(power), axis=0)  # else the brightest rows say how rows depend
        weights = np.sqrt((np.abs(across) ** 2).mean(axis=1, keepdims=True))
        along = np.sqrt((np.abs(self.spectrum) ** 2).mean(axis=0))
        return self.with_spectrum((fft.ifft(weights * fft.fft(drawn, axis=0), axis=0) * along).astype(np.complex64))

    def first(self, rows: int) -> AzimuthSpectrum:
        """The first rows, as if they lay further apart and reached from the nearest range to the furthest: for speckle,
        whose rows are all alike."""
        if len(self) <= rows:
            return self
        some = np.linspace(0, len(self) - 1, rows).astype(int)
        return replace(self, spectrum=self.spectrum[:rows], aside=self.aside[some], stretch=self.stretch[some])

    def image(self, factor: NDArray[Any]) -> NDArray[np.complex64]:
        """The samples of the rows, their spectrum times a factor (frequencies,), or one of each row."""
        whole = np.zeros((len(self), self.length), np.complex64)
        whole[:, self.index] = self.spectrum * factor.astype(np.complex64)
        found: NDArray[np.complex64] = fft.ifft(whole, axis=1)
        return found


def _level(spectrum: NDArray[np.complex64], place: F64) -> F64:
    """The amplitude that rows have at each frequency in the mean, (frequencies,), all rows alike and smooth."""
    if not len(spectrum):
        return np.ones(len(place))
    power = (np.abs(spectrum) ** 2).astype(np.float64)
    mean = (power / power.mean(axis=1, keepdims=True)).mean(axis=0)
    fitted = np.polynomial.Polynomial.fit(place, np.log(np.maximum(mean, _LEAST_LEVEL * mean.max())), LEVEL_DEGREE)
    return np.asarray(np.exp(0.5 * fitted(place)))


def turns(phase: F64) -> NDArray[np.complex64]:
    """exp(j phase), of a phase [rad] that single precision holds to 1e-5."""
    single, found = phase.astype(np.float32), np.empty(phase.shape, np.complex64)
    found.real, found.imag = np.cos(single), np.sin(single)
    return found


def contrast(lines: AzimuthSpectrum, factor: NDArray[Any]) -> F64:
    """Of each row under a factor on its spectrum, (rows,)."""
    smooth, mean = _smoothed(lines, _power(lines.image(factor)))
    return np.asarray(np.log(mean) - np.log(smooth).mean(axis=1, dtype=np.float64))


def corrected(lines: AzimuthSpectrum, phase: F64) -> F64:
    """The contrast of each row with a phase [rad] taken off, (rows,)."""
    return contrast(lines, turns(-phase))


def mean_contrast_and_slope(lines: AzimuthSpectrum, phase: F64) -> tuple[float, F64]:
    """The mean over the rows with a phase taken off, and its derivative with the phase at each frequency.

    The derivative is (frequencies,), or (rows, frequencies) where each row has a phase of its own.

    The adjoint takes one transform forward and one back, however many numbers the phase has.
    """
    factor = turns(-phase)
    field = lines.image(factor)
    smooth, mean = _smoothed(lines, _power(field))
    value = np.log(mean) - np.log(smooth).mean(axis=1, dtype=np.float64)
    of_smooth = np.zeros(field.shape, np.float32)
    of_smooth[:, lines.inside] = ((1.0 / mean).astype(np.float32)[:, None] - 1.0 / smooth) * (2.0 / smooth.size)
    field *= _over_window(lines, of_smooth)
    back = fft.fft(field, axis=1, overwrite_x=True)[:, lines.index] / np.float32(lines.length)
    turned = lines.spectrum * factor
    slope = back.real * turned.imag - back.imag * turned.real
    return float(value.mean()), np.asarray(slope if phase.ndim == 2 else slope.sum(axis=0), np.float64)


def _power(field: NDArray[np.complex64]) -> NDArray[np.float32]:
    return np.asarray(np.square(field.real) + np.square(field.imag))


def _smoothed(lines: AzimuthSpectrum, power: NDArray[np.float32]) -> tuple[NDArray[np.float32], F64]:
    """Power over the window at the columns that count, (rows, columns), and its mean along each row."""
    smooth = _over_window(lines, power)[:, lines.inside]
    smooth = smooth + np.float32(DARKEST * smooth.mean(dtype=np.float64))
    return smooth, smooth.mean(axis=1, dtype=np.float64)


def _over_window(lines: AzimuthSpectrum, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean over the window; it is its own adjoint for odd windows."""
    found: NDArray[np.float32] = uniform_filter(values, lines.window, mode="constant")
    return found
