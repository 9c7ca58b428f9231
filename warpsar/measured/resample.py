"""Complex or detected images onto points: interpolated without aliasing, as linear power."""

from __future__ import annotations

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import ImageChip

_MARGIN = 16  # [pixels] around what is needed: the interpolation's reach
_COINCIDENT = 1e-6  # [pixels]: grids that differ by less are the same grid


def sample_power(chip: ImageChip, pixel: np.ndarray) -> np.ndarray:
    """Power of `chip` at fractional (row, column) pixel centres (..., 2), float64; NaN outside the image.

    Squared magnitude has twice the bandwidth of a complex image: it is taken on a grid twice as fine, made by zero padding
    the spectrum, and then interpolated by cubic splines. Detected images are squared, or taken as they are, and
    interpolated linearly, which keeps them positive. A point on a pixel centre is that pixel, untouched.
    """
    rows, cols = chip.samples.shape
    inside = (
        np.isfinite(pixel).all(-1)
        & (pixel >= -_COINCIDENT).all(-1)
        & (pixel[..., 0] <= rows - 1 + _COINCIDENT)
        & (pixel[..., 1] <= cols - 1 + _COINCIDENT)
    )
    power = np.full(pixel.shape[:-1], np.nan)
    if not inside.any():
        return power
    wanted = pixel[inside]
    low = np.maximum(np.floor(wanted.min(axis=0)).astype(int) - _MARGIN, 0)
    high = np.minimum(np.ceil(wanted.max(axis=0)).astype(int) + 1 + _MARGIN, (rows, cols))
    samples = np.asarray(chip.samples[slice(low[0], high[0]), slice(low[1], high[1])])
    bad = ~np.isfinite(samples)
    if bad.all():
        raise InputError(f"{chip.source}: every pixel under the view's grid is NaN or infinite")
    if chip.quantity == "power" and (samples[~bad] < 0).any():
        raise InputError(f"{chip.source}: negative values, down to {samples[~bad].min():g}; linear power has none")
    power[inside] = _interpolated(np.where(bad, 0, samples), bad, wanted - low, chip.quantity)
    if chip.gain is not None:
        power *= chip.gain(pixel)
    return power


def _interpolated(samples: np.ndarray, bad: np.ndarray, at: np.ndarray, quantity: str) -> np.ndarray:
    from scipy.ndimage import map_coordinates

    nearest = np.rint(at).astype(int)
    if np.abs(at - nearest).max() < _COINCIDENT:
        values = _power(samples[nearest[:, 0], nearest[:, 1]], quantity)
        return np.where(bad[nearest[:, 0], nearest[:, 1]], np.nan, values)
    if quantity == "complex":
        fine = _power(_twice(samples), quantity)
        values = np.maximum(map_coordinates(fine, 2.0 * at.T, order=3, mode="mirror"), 0.0)
    else:
        values = map_coordinates(_power(samples, quantity), at.T, order=1, mode="nearest")
    if bad.any():  # a pixel that is not known is no part of any sum
        values[map_coordinates(bad.astype(np.float64), at.T, order=1, mode="nearest") > _COINCIDENT] = np.nan
    return values


def _power(samples: np.ndarray, quantity: str) -> np.ndarray:
    return samples.astype(np.float64) if quantity == "power" else np.abs(samples).astype(np.float64) ** 2


def _twice(samples: np.ndarray) -> np.ndarray:
    """The image on a grid twice as fine, (2 rows, 2 cols), up to phase: each axis' spectrum is centred first."""
    from scipy import fft

    for axis in (0, 1):
        count = samples.shape[axis]
        moved = np.moveaxis(samples, axis, 0)
        centroid = np.angle(np.vdot(moved[:-1], moved[1:])) if count > 1 else 0.0
        index = np.arange(count).reshape(-1, *(1,) * (samples.ndim - 1))
        spectrum = fft.fftshift(fft.fft(moved * np.exp(-1j * centroid * index), axis=0), axes=0)
        padded = np.zeros((2 * count, *spectrum.shape[1:]), np.complex64)
        first = count - count // 2
        padded[first : first + count] = spectrum
        samples = np.moveaxis(2.0 * fft.ifft(fft.ifftshift(padded, axes=0), axis=0), 0, axis)
    return samples


def averaged(fine: np.ndarray, looks: tuple[int, int]) -> np.ndarray:
    """Means over blocks of `looks` samples, in linear power; NaN samples spoil their pixel."""
    rows, cols = fine.shape[0] // looks[0], fine.shape[1] // looks[1]
    return fine.reshape(rows, looks[0], cols, looks[1]).mean(axis=(1, 3))
