"""How improbable a value is that few draws or none have reached."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

TAIL = 0.1  # share of the draws from which a score's tail is taken to fall off exponentially


@dataclass(frozen=True)
class Tail:
    """-ln of the probability that speckle alone exceeds a value, from draws: their empirical tail down to `TAIL`, and
    an exponential one beyond it (peaks over threshold)."""

    body: np.ndarray  # sorted draws
    edge: float
    scale: float

    @classmethod
    def of(cls, draws: np.ndarray) -> Tail:
        body = np.sort(draws)
        edge = float(np.quantile(body, 1.0 - TAIL))
        excess = body[body > edge] - edge
        return cls(body, edge, max(float(excess.mean()) if excess.size else 0.0, 1e-6))

    def __call__(self, values: npt.ArrayLike) -> np.ndarray:
        values = np.asarray(values, float)
        above = self.body.size - np.searchsorted(self.body, values, side="left")
        empirical = -np.log(np.maximum((above + 1.0) / (self.body.size + 1.0), TAIL))
        beyond = -np.log(TAIL) + (values - self.edge) / self.scale
        return np.where(values > self.edge, beyond, np.minimum(empirical, -np.log(TAIL)))
