"""How far a modelled image is from a measured one: the loss with its weight, gain and curvature."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from warpsar.compare.observation import Observation
from warpsar.speckle.likelihood import Curvature, best_gain, curvature, loss_terms, loss_weight


@dataclass(frozen=True)
class Misfit:
    """One loss for all images of a fit; `mean_square` is their common scale (`loss_weight`).

    Where the images are not `calibrated`, each has a gain of its own, which is always at its best. `mu` is the modelled
    beta0 of the interior pixels of `seen`, shape (n,), float64. `bound`: of the gamma loss, see `bounded`; 0 for none.
    """

    loss: str
    mean_square: float
    calibrated: bool
    bound: float = 0.0
    _found: dict[int, tuple[Observation, np.ndarray, float]] = field(default_factory=dict, init=False, compare=False)

    def weight(self, seen: Observation) -> float:
        """What a pixel's loss is multiplied by."""
        return loss_weight(self.loss, seen.looks, self.mean_square)

    def gain(self, seen: Observation, mu: np.ndarray) -> float:
        """The best gain; 1 for calibrated images. That of the last `mu` is kept: loss and curvature ask for it too."""
        if self.calibrated:
            return 1.0
        last = self._found.get(id(seen))
        if last is None or last[0] is not seen or last[1] is not mu:
            last = seen, mu, best_gain(self.loss, seen.values, mu, seen.looks, self.bound, seen.top)
            self._found[id(seen)] = last
        return last[2]

    def terms(self, seen: Observation, mu: np.ndarray) -> np.ndarray:
        """The loss of every pixel before its weight, at the best gain, shape (n,), float64."""
        return loss_terms(self.loss, seen.values, self.gain(seen, mu) * mu, seen.looks, self.bound, seen.top)

    def curvature(self, seen: Observation, mu: np.ndarray) -> Curvature:
        """Residuals and weights at the best gain."""
        modelled = self.gain(seen, mu) * mu
        return curvature(self.loss, seen.values, modelled, seen.looks, self.weight(seen), self.bound, seen.top)
