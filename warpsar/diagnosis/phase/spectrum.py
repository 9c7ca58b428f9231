"""The azimuth spectrum of a complex image, and how well locally constant power explains it under a phase.

The samples of a row are circular Gaussian speckle, whose power is constant over a window of some cells. The likelihood
of that, with the mean power of the window in place of the true one, is -ln of this mean, summed over the samples.
Beside a power that is constant along the row it is the contrast of the row, ln(mean I) - mean ln I, with I smoothed
over the window. Points and edges that are sharp leave much of the image dark, and raise it. Speckle of a homogeneous
ground has the same distribution under any phase: there the contrast says nothing.
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

    @classmethod
    def of(
        cls,
        image: NDArray[np.complex64],
        spacing_m: tuple[float, float],
        cells_m: tuple[float, float],
        aside: F64 | None = None,
    ) -> AzimuthSpectrum:
        """Of an image (rows, columns), zero where nothing was measured. `cells_m`: of the whole band in range, and of
        the whole aperture in azimuth, whose band is 1 / cell. Rows without power are left out."""
        border = int(np.ceil(BORDER_CELLS * cells_m[1] / spacing_m[1]))
        length = fft.next_fast_len(image.shape[1] + border)
        place = -2.0 * cells_m[1] * fft.fftfreq(length, spacing_m[1])
        index = np.flatnonzero(np.abs(place) <= 1.0)
        found = fft.fft(image, length, axis=1)[:, index].astype(np.complex64)
        some = (np.abs(found) ** 2).sum(axis=1) > 0.0
        found, told = found[some], np.zeros(len(image)) if aside is None else aside
        rows, columns = (2 * int(0.5 * WINDOW_CELLS * c / s) + 1 for c, s in zip(cells_m, spacing_m, strict=True))
        return cls(
            found, place[index], index, length, slice(border, image.shape[1] - border), (rows, columns), told[some]
        )

    def __len__(self) -> int:
        return len(self.spectrum)

    def with_spectrum(self, spectrum: NDArray[np.complex64]) -> AzimuthSpectrum:
        return replace(self, spectrum=spectrum)

    @staticmethod
    def joined(parts: Sequence[AzimuthSpectrum]) -> AzimuthSpectrum:
        """The rows of all, one part after the other."""
        both = parts[0].with_spectrum(np.concatenate([one.spectrum for one in parts]))
        return replace(both, aside=np.concatenate([one.aside for one in parts]))

    def turned(self, phase: F64) -> AzimuthSpectrum:
        """With a phase (frequencies,) or (rows, frequencies) [rad] added."""
        return self.with_spectrum(self.spectrum * np.exp(1j * phase).astype(np.complex64))

    def speckle(self, random: np.random.Generator) -> AzimuthSpectrum:
        """Homogeneous speckle in place of the rows, with their mean power spectra in range and in azimuth."""
        drawn = random.standard_normal((*self.spectrum.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        power = (np.abs(self.spectrum) ** 2).mean(axis=1, keepdims=True)
        across = fft.fft(self.spectrum / np.sqrt(power), axis=0)  # else the brightest rows say how rows depend
        weights = np.sqrt((np.abs(across) ** 2).mean(axis=1, keepdims=True))
        along = np.sqrt((np.abs(self.spectrum) ** 2).mean(axis=0))
        return self.with_spectrum((fft.ifft(weights * fft.fft(drawn, axis=0), axis=0) * along).astype(np.complex64))

    def image(self, factor: NDArray[Any]) -> NDArray[np.complex64]:
        """The samples of the rows, their spectrum times a factor (frequencies,), or one of each row."""
        whole = np.zeros((len(self), self.length), np.complex64)
        whole[:, self.index] = self.spectrum * factor.astype(np.complex64)
        found: NDArray[np.complex64] = fft.ifft(whole, axis=1)
        return found


def contrast(lines: AzimuthSpectrum, factor: NDArray[Any]) -> F64:
    """Of each row under a factor on its spectrum, (rows,)."""
    smooth, mean = _smoothed(lines, np.abs(lines.image(factor)) ** 2)
    return np.asarray(np.log(mean) - np.log(smooth).mean(axis=1))


def corrected(lines: AzimuthSpectrum, phase: F64) -> F64:
    """The contrast of each row with a phase [rad] taken off, (rows,)."""
    return contrast(lines, np.exp(-1j * phase))


def mean_contrast_and_slope(lines: AzimuthSpectrum, phase: F64) -> tuple[float, F64]:
    """The mean over the rows with a phase taken off, and its derivative with the phase at each frequency.

    The derivative is (frequencies,), or (rows, frequencies) where each row has a phase of its own.

    The adjoint takes one transform forward and one back, however many numbers the phase has.
    """
    factor = np.exp(-1j * phase)
    field = lines.image(factor)
    smooth, mean = _smoothed(lines, np.abs(field) ** 2)
    value = np.log(mean) - np.log(smooth).mean(axis=1)
    of_smooth = np.zeros(field.shape, np.float32)
    of_smooth[:, lines.inside] = (1.0 / mean[:, None] - 1.0 / smooth) / smooth.size
    back = fft.fft((2.0 * _over_window(lines, of_smooth)) * field, axis=1)[:, lines.index] / lines.length
    slope = (back.conj() * (lines.spectrum * factor)).imag
    return float(value.mean()), np.asarray(slope if phase.ndim == 2 else slope.sum(axis=0), np.float64)


def _smoothed(lines: AzimuthSpectrum, power: NDArray[np.float32]) -> tuple[F64, F64]:
    """Power over the window at the columns that count, (rows, columns), and its mean along each row."""
    smooth = _over_window(lines, power)[:, lines.inside].astype(np.float64)
    smooth += DARKEST * smooth.mean()
    return smooth, smooth.mean(axis=1)


def _over_window(lines: AzimuthSpectrum, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean over the window; it is its own adjoint for odd windows."""
    found: NDArray[np.float32] = uniform_filter(values, lines.window, mode="constant")
    return found
