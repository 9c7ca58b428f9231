"""The errors of values: clutter and noise, a scatter from value to value, and one that the values of an image share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.differences import Differences

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class ExtraScatter:
    """Standard deviations beyond clutter and noise: from value to value, and from image to image."""

    value: float
    image: float


class ErrorCovariance:
    """The covariance of the values: diagonal, and a constant within each image."""

    def __init__(self, data: Differences, scatter: ExtraScatter) -> None:
        self.diagonal = data.sd**2 + scatter.value**2
        self.image, self.shared = data.image, scatter.image**2
        self.count = int(data.image.max(initial=-1)) + 1
        self.members = data.members
        self.inverse_sum = np.bincount(data.image, 1.0 / self.diagonal, self.count)

    def whitened(self, values: F64) -> F64:
        """Of values (n,) or (n, k): what has unit covariance.

        Within an image D + s 11' has the inverse root D^-1/2 (1 - c D^-1/2 1 1' D^-1/2) for one c; its square is the
        inverse (Sherman and Morrison).
        """
        root = 1.0 / np.sqrt(self.diagonal)
        scaled = values * (root if values.ndim == 1 else root[:, None])
        if self.shared == 0.0:
            return scaled
        total = self.inverse_sum
        shrink = np.divide(
            1.0 - 1.0 / np.sqrt(1.0 + self.shared * total), total, out=np.zeros_like(total), where=total > 0
        )
        sums = self.members @ (scaled * (root if values.ndim == 1 else root[:, None]))
        shrunk = (sums * (shrink if values.ndim == 1 else shrink[:, None]))[self.image]
        return np.asarray(scaled - shrunk * (root if values.ndim == 1 else root[:, None]), np.float64)

    @property
    def log_determinant(self) -> float:
        return float(np.log(self.diagonal).sum() + np.log1p(self.shared * self.inverse_sum).sum())
