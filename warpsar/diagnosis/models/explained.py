"""How much of what is unlike speckle a change of the model explains, where it changes anything.

A gain in likelihood says that a change is better than none. It does not say that the change is the cause: the nearest
hypothesis explains a part of any error. The cause explains most of what is wrong in the pixels that it touches.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.models.left_out import clipped
from warpsar.speckle.likelihood import loss_terms

TOUCHED = 0.1  # change of ln power, from which a change touches a pixel


@dataclass(frozen=True)
class Compared:
    """An image beside two models, arrays of shape (n,) [beta0]: `measured`, and `before` and `after` the change.
    `speckle`: the loss that speckle leaves on average, of each pixel or of all."""

    looks: float
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    speckle: np.ndarray | float


@dataclass(frozen=True)
class Explained:
    """Log-likelihood by which the touched pixels are unlike speckle `before` a change and `after` it. A pixel counts by
    its loss less that of pure speckle, and by 20 at most."""

    before: float
    after: float

    @classmethod
    def of(cls, images: Iterable[Compared]) -> Explained:
        sums = np.zeros(2)
        for one in images:
            touched = np.abs(np.log(one.after / one.before)) > TOUCHED
            for k, mu in enumerate((one.before, one.after)):
                lost = clipped(loss_terms("gamma", one.measured[touched], mu[touched], one.looks))
                sums[k] += float((lost - np.broadcast_to(one.speckle, touched.shape)[touched]).sum())
        return cls(*map(float, sums))

    @property
    def share(self) -> float:
        """1 for all of it; 0 where nothing was unlike speckle."""
        return 1.0 - self.after / self.before if self.before > 0 else 0.0
