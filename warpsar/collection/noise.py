"""The receiver's noise: complex Gaussian numbers of the mean power that the focused image asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpsar.collection.history import Collected
from warpsar.collection.response import band_weights


def with_noise(made: Collected, seed: int) -> Collected:
    """The phase history with noise whose mean power in the focused image is `noise_beta0`."""
    plan = made.plan
    level = plan.table.noise_beta0
    if level == 0.0:
        return made
    band, track = band_weights(plan.windows[0], plan.frequencies), plan.azimuth_weights
    # An image is the weighted mean of its samples over sqrt(response): noise falls as sum w^2 / (sum w)^2.
    tapers = track / np.where(plan.beam_gain == 0.0, 1.0, plan.beam_gain)
    mean = (band**2).sum() * (tapers**2).sum() / (band.sum() * track.sum()) ** 2
    power = level * plan.response_m2 / mean
    random = np.random.default_rng([seed, 1])
    shape = (*made.samples.shape, 2)
    drawn = random.standard_normal(shape, dtype=np.float32).view(np.complex64)[..., 0]
    return replace(made, samples=made.samples + np.float32(np.sqrt(0.5 * power)) * drawn)
