"""One view's simulated images."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class SimulatedView:
    """One view's images.

    `beta0[pol]`: linear power, dimensionless, shape (rows, cols), float32, rows along slant range. `range_m` and
    `azimuth_m`: pixel centres about the reference point [m]. `sampling_variance[pol]`: variance of beta0 that the
    jitter of the rays leaves (two seeds). `layers`: see `warpsar.layers.layers`,
    and by name the shares of beta0 that effects tell apart (`beta0_2_bounces_HH`), before the image stage.
    `lit_fraction`: share of the pixels that single-bounce light reaches. `metadata`: geometry, axes and calibration, as
    the headers of its files have them. `looks`: of the speckle on `beta0`; None for an image without.
    """

    name: str
    beta0: dict[str, np.ndarray]
    range_m: np.ndarray
    azimuth_m: np.ndarray
    rays: int
    hits: int
    sampling_variance: dict[str, np.ndarray] = field(default_factory=dict)
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    lit_fraction: float = 0.0
    metadata: dict[str, Any] = field(default_factory=dict)
    looks: float | None = None

    def channels(self) -> dict[str, np.ndarray]:
        """What was asked for beyond the images, by name: layers, shares and sampling variances."""
        return dict(self.layers) | {f"sampling_variance_{p}": v for p, v in self.sampling_variance.items()}
