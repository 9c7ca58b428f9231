"""One measured image beside its simulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypedDict

import numpy as np

from warpsar.learning.observation import Observation
from warpsar.learning.verdict import Verdict
from warpsar.world.tables import View


class Metrics(TypedDict):
    """How far compared pixels are from the model, as in the JSON files (docs/evaluate.md).

    `rmse` is in beta0, `deviance` in units of its mean under speckle, with its standard error.
    """

    rmse: float
    nrmse: float
    rmse_db: float
    deviance: float
    correlation: float
    deviance_error: float
    pixels: int
    left_out: int
    zeros: int


class WholeMetrics(Metrics):
    """The same, and the deviance over all valid pixels, with a nuisance level added to the model."""

    deviance_all: float
    deviance_all_error: float
    pixels_all: int
    left_out_all: int


class ImageMetrics(WholeMetrics):
    """Of one image; `floor` is the nuisance level [beta0]."""

    floor: float


class PooledMetrics(WholeMetrics):
    """Of the pixels of several images together."""

    images: int


@dataclass(frozen=True)
class EvaluatedImage:
    """One measured image beside the model's; arrays of shape (rows, cols) = (range, azimuth).

    `simulated`: beta0 of the model (linear power, dimensionless), times `gain`. `valid`: finite, unmasked, positive;
    `observation` holds the measured beta0 and the lit interior that is compared. `floor`: the nuisance level [beta0]
    added to the model where all valid pixels are compared. `incidence_deg` and `material` (index into the mesh's) are
    those of the surface in the pixel, weighted by its modelled power; NaN and -1 where there is none. `range_m`,
    `azimuth_m`: pixel centres about the reference point. `sampling_noise`: looks x relative variance of the model that
    its rays leave, averaged over the interior. `metrics`: as evaluate.json has them.
    """

    observation: Observation
    simulated: np.ndarray
    valid: np.ndarray
    gain: float
    floor: float
    incidence_deg: np.ndarray
    material: np.ndarray
    range_m: np.ndarray
    azimuth_m: np.ndarray
    sampling_noise: float
    metrics: ImageMetrics

    @property
    def view(self) -> View:
        return self.observation.view

    @property
    def polarization(self) -> str:
        return self.observation.polarization

    @property
    def measured(self) -> np.ndarray:
        """beta0, linear power, NaN where it is not finite."""
        return self.observation.measured

    @property
    def interior(self) -> np.ndarray:
        """The pixels that are compared."""
        return self.observation.interior

    @property
    def ratio_db(self) -> np.ndarray:
        """10 log10(measured / simulated) [dB]; NaN where either is not positive."""
        return ratio_db(self.measured, self.simulated)


@dataclass(frozen=True)
class Evaluation:
    """All images of a scene, and the metrics pooled over the pixels of each role; None for a role without images.

    `verdicts`, by role: whether anything is left beside speckle.
    """

    images: list[EvaluatedImage]
    train: PooledMetrics | None
    test: PooledMetrics | None
    rays_per_m2: float
    verdicts: dict[str, Verdict] = field(default_factory=dict)


def ratio_db(measured: np.ndarray, simulated: np.ndarray) -> np.ndarray:
    """10 log10(measured / simulated) [dB], any shape; NaN where either is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = 10.0 * np.log10(measured.astype(float) / simulated)
    return np.where((measured > 0) & (simulated > 0), ratio, np.nan)
