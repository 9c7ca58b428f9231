"""Linear power of a complex or detected image between its pixels, and complex samples, without aliasing."""

from __future__ import annotations

import numpy as np
from scipy import fft
from scipy.ndimage import map_coordinates

from warpsar.errors import InputError
from warpsar.formats.base.data import ImageChip
from warpsar.io.images import LARGEST_IMAGE

_MARGIN = 32  # [pixels] around the wanted ones, in which the samples fade for the Fourier transform
_UNFADED = 8  # [pixels] of it, next to the wanted ones, that stay as they are
_FINER = 3  # times as fine a grid for the power of complex samples
_COINCIDENT = 1e-6  # [pixels]: grids that differ by less are the same grid


def sample_power(chip: ImageChip, pixel: np.ndarray) -> np.ndarray:
    """Power of `chip` at fractional (row, column) pixel centres (..., 2), float64; NaN outside the image.

    The power of a complex image has twice its bandwidth. So it is taken on a grid three times as fine, made by zero
    padding the spectrum, and is then interpolated by splines. Detected images become power first and are interpolated
    linearly, which keeps them positive. A point on a pixel centre gets that pixel's value. A point in the outer half of
    a border pixel gets the border's value. Raises InputError for an image without a usable pixel under the grid.
    """
    power = np.full(pixel.shape[:-1], np.nan)
    found = _under(chip, pixel)
    if found is None:
        return power
    inside, at, samples, bad = found
    if chip.quantity == "power" and (samples[~bad] < 0).any():
        raise InputError(f"{chip.source}: negative values, down to {samples[~bad].min():g}; linear power has none")
    with np.errstate(all="ignore"):  # what overflows is infinite, and no power
        power[inside] = _interpolated(np.where(bad, 0, samples), bad, at, chip.quantity)
        if chip.gain is not None:
            power *= chip.gain(pixel)
    power[~np.isfinite(power)] = np.nan
    return power


def sample_complex(chip: ImageChip, pixel: np.ndarray) -> np.ndarray:
    """Samples of a complex `chip` at fractional (row, column), complex64: |s|^2 is beta0 where it is calibrated.

    NaN outside the image, and where a sample that is not finite has a part. The spectrum of each axis, wherever it
    lies, is centred and made three times as fine, interpolated by splines, and put back. On the image's own pixels the
    samples come back as they are.
    """
    values = np.full(pixel.shape[:-1], np.nan, np.complex64)
    found = _under(chip, pixel)
    if found is None:
        return values
    inside, at, samples, bad = found
    samples = np.where(bad, 0, samples)
    nearest = np.rint(at).astype(int)
    with np.errstate(all="ignore"):  # what overflows is infinite, and no sample
        if np.abs(at - nearest).max() < _COINCIDENT:
            own, spoilt = samples[nearest[:, 0], nearest[:, 1]], bad[nearest[:, 0], nearest[:, 1]]
        else:
            fine, turns = _finer(samples * _faded_both(samples.shape, at))
            places = _FINER * at.T
            parts = [map_coordinates(part, places, order=5, mode="mirror") for part in (fine.real, fine.imag)]
            own = (parts[0] + 1j * parts[1]) * np.exp(1j * (at @ np.array(turns)))
            spoilt = map_coordinates(bad.astype(np.float64), at.T, order=1, mode="nearest") > _COINCIDENT
        own = np.where(spoilt, np.nan, own)
        if chip.gain is not None:
            own = own * np.sqrt(chip.gain(pixel[inside]))
        values[inside] = own
    values[~np.isfinite(values)] = np.nan
    return values


def _under(chip: ImageChip, pixel: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Which points are inside; where they lie in a window of the image, (n, 2); the window, and which of it is bad."""
    last = np.array(chip.samples.shape) - 1
    inside = np.asarray((np.abs(pixel - last / 2.0) <= last / 2.0 + 0.5).all(-1))  # false for NaN
    if not inside.any():
        return None
    wanted = np.clip(pixel[inside], 0, last)
    low = np.maximum(np.floor(wanted.min(axis=0)).astype(int) - _MARGIN, 0)
    high = np.minimum(np.ceil(wanted.max(axis=0)).astype(int) + _MARGIN, last) + 1
    if np.prod(high - low) > LARGEST_IMAGE:
        raise InputError(
            f"{chip.source}: the view's grid lies on {high[0] - low[0]} x {high[1] - low[1]} of its pixels; at most "
            f"{LARGEST_IMAGE} can be resampled at once"
        )
    samples = np.asarray(chip.samples[slice(low[0], high[0]), slice(low[1], high[1])])
    bad = ~np.isfinite(samples)
    if bad.all():
        raise InputError(f"{chip.source}: every pixel under the view's grid is NaN or infinite")
    return inside, wanted - low, samples, bad


def _interpolated(samples: np.ndarray, bad: np.ndarray, at: np.ndarray, quantity: str) -> np.ndarray:
    nearest = np.rint(at).astype(int)
    if np.abs(at - nearest).max() < _COINCIDENT:
        values = _power(samples[nearest[:, 0], nearest[:, 1]], quantity)
        return np.where(bad[nearest[:, 0], nearest[:, 1]], np.nan, values)
    if quantity == "complex":
        fine = _power(_finer(samples * _faded_both(samples.shape, at))[0], quantity)
        values = np.maximum(map_coordinates(fine, _FINER * at.T, order=5, mode="mirror"), 0.0)
    else:
        values = map_coordinates(_power(samples, quantity), at.T, order=1, mode="nearest")
    if bad.any():  # a pixel that is not finite spoils all values that it has a part in
        values[map_coordinates(bad.astype(np.float64), at.T, order=1, mode="nearest") > _COINCIDENT] = np.nan
    return values


def _power(samples: np.ndarray, quantity: str) -> np.ndarray:
    return samples.astype(np.float64) if quantity == "power" else np.abs(samples).astype(np.float64) ** 2


def _faded_both(shape: tuple[int, ...], at: np.ndarray) -> np.ndarray:
    """`_faded` of rows times that of columns."""
    return np.outer(*(_faded(n, at[:, axis]) for axis, n in enumerate(shape)))


def _faded(count: int, at: np.ndarray) -> np.ndarray:
    """Weights: 1 where samples are wanted, falling to 0 outside; a cut edge is a step to a Fourier transform."""
    index = np.arange(count)
    before, after = max(int(np.floor(at.min())), 0), count - 1 - min(int(np.ceil(at.max())), count - 1)
    weight = np.ones(count)
    for margin, distance in ((before, index), (after, index[::-1])):
        ramp = np.clip((distance + 1) / max(margin - _UNFADED, 1), 0.0, 1.0)
        weight *= np.sin(np.pi / 2 * ramp) ** 2
    return weight


def _finer(samples: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """The image on a grid `_FINER` times as fine, its spectrum centred; and the phase from pixel to pixel of each axis
    that was taken away for it [rad]."""
    turns = []
    for axis in (0, 1):
        moved = np.moveaxis(samples, axis, 0)
        count = moved.shape[0]
        centroid = np.angle(np.vdot(moved[:-1], moved[1:])) if count > 1 else 0.0
        turns.append(float(centroid))
        index = np.arange(count)[:, None]
        spectrum = fft.fftshift(fft.fft(moved * np.exp(-1j * centroid * index), axis=0), axes=0)
        padded = np.zeros((_FINER * count, spectrum.shape[1]), np.complex64)
        first = _FINER * count // 2 - count // 2  # zero frequency stays zero frequency
        padded[first : first + count] = spectrum
        samples = np.moveaxis(_FINER * fft.ifft(fft.ifftshift(padded, axes=0), axis=0), 0, axis)
    return samples, turns


def averaged(fine: np.ndarray, looks: tuple[int, int]) -> np.ndarray:
    """Means over blocks of `looks` samples, in linear power; NaN samples spoil their pixel."""
    rows, cols = fine.shape[0] // looks[0], fine.shape[1] // looks[1]
    return fine.reshape(rows, looks[0], cols, looks[1]).mean(axis=(1, 3))
