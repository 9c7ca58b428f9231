"""The receiver's noise: complex Gaussian numbers of the mean power that the focused image asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from warpsar.collection.history import Collected
from warpsar.collection.plan import Plan
from warpsar.collection.response import band_weights
from warpsar.collection.slc import Slc
from warpsar.world.taper import taper

F64 = NDArray[np.float64]


def with_noise(made: Collected, seed: int) -> Collected:
    """The phase history with noise whose mean power in the focused image is the plan's."""
    plan = made.plan
    levels = np.array([plan.noise_of(name) for name in made.polarizations])
    if not levels.any():
        return made
    band = band_weights(plan.windows[0], plan.frequencies)
    # An image is the weighted mean of its samples over sqrt(response): noise falls as sum w^2 / (sum w)^2.
    mean = (band**2).sum() * (plan.azimuth_taper**2).sum() / (band.sum() * plan.azimuth_weights.sum()) ** 2
    power = levels * plan.response_m2 / mean
    random = np.random.default_rng([seed, 1])
    shape = (*made.samples.shape, 2)
    drawn = random.standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]
    scale = np.sqrt(0.5 * power).astype(np.float32)
    return replace(made, samples=made.samples + scale[:, None, None] * drawn)


def with_image_noise(made: Slc, seed: int) -> Slc:
    """A direct image with the same noise: as wide in frequency as the tapers let through."""
    plan = made.plan
    levels = {name: plan.noise_of(name) for name in made.images}
    if not any(levels.values()):
        return made
    random = np.random.default_rng([seed, 1])
    weights = [_weights(plan, axis, place) for axis, place in enumerate((made.range_m, made.azimuth_m))]
    images = {}
    for name, image in made.images.items():
        drawn = random.standard_normal((*image.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        coloured = fft.ifft2(fft.fft2(drawn) * (weights[0][:, None] * weights[1]).astype(np.float32))
        images[name] = image + np.float32(np.sqrt(0.5 * levels[name])) * coloured
    return replace(made, images=images)


def lines(plan: Plan, azimuth_m: F64, rows: int, random: np.random.Generator) -> NDArray[np.complex64]:
    """Gaussian numbers of mean power 1, (rows, columns): rows are independent, columns as wide in frequency as the
    aperture's taper lets through."""
    drawn = random.standard_normal((rows, len(azimuth_m), 2), dtype=np.float32).view(np.complex64)[..., 0]
    weights = (np.sqrt(0.5) * _weights(plan, 1, azimuth_m)).astype(np.float32)
    found: NDArray[np.complex64] = fft.ifft(fft.fft(drawn, axis=1) * weights, axis=1)
    return found


def _weights(plan: Plan, axis: int, place_m: F64) -> F64:
    """The taper of band or aperture at the frequencies of an axis of an image, of a mean square of 1."""
    at = fft.fftfreq(len(place_m), place_m[1] - place_m[0]) * plan.cells_m[axis]
    weight = np.where(np.abs(at) <= 0.5, taper(plan.windows[axis], at), 0.0)
    return np.asarray(weight / np.sqrt((weight**2).mean()))
