"""The receiver's noise: complex Gaussian numbers of the mean power that the focused image asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import fft

from warpsar.collection.history import Collected
from warpsar.collection.response import band_weights
from warpsar.collection.slc import Slc
from warpsar.formats.base.taper import taper


def with_noise(made: Collected, seed: int) -> Collected:
    """The phase history with noise whose mean power in the focused image is `noise_beta0`."""
    plan = made.plan
    level = plan.table.noise_beta0
    if level == 0.0:
        return made
    band = band_weights(plan.windows[0], plan.frequencies)
    # An image is the weighted mean of its samples over sqrt(response): noise falls as sum w^2 / (sum w)^2.
    mean = (band**2).sum() * (plan.azimuth_taper**2).sum() / (band.sum() * plan.azimuth_weights.sum()) ** 2
    power = level * plan.response_m2 / mean
    random = np.random.default_rng([seed, 1])
    shape = (*made.samples.shape, 2)
    drawn = random.standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]
    return replace(made, samples=made.samples + np.float32(np.sqrt(0.5 * power)) * drawn)


def with_image_noise(made: Slc, seed: int) -> Slc:
    """A direct image with the same noise: as wide in frequency as the tapers let through."""
    plan = made.plan
    level = plan.table.noise_beta0
    if level == 0.0:
        return made
    random = np.random.default_rng([seed, 1])
    spacing = [axis[1] - axis[0] for axis in (made.range_m, made.azimuth_m)]
    weights = []
    for count, step, cell, window in zip(
        (len(made.range_m), len(made.azimuth_m)), spacing, plan.cells_m, plan.windows, strict=True
    ):
        place = fft.fftfreq(count, step) * cell
        weight = np.where(np.abs(place) <= 0.5, taper(window, place), 0.0)
        weights.append(weight / np.sqrt((weight**2).mean()))
    images = {}
    for name, image in made.images.items():
        drawn = random.standard_normal((*image.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
        coloured = fft.ifft2(fft.fft2(drawn) * (weights[0][:, None] * weights[1]).astype(np.float32))
        images[name] = image + np.float32(np.sqrt(0.5 * level)) * coloured
    return replace(made, images=images)
