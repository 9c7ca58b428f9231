"""How improbable a value is that few draws or none have reached.

Draws are most of what a chance costs, and most chances are far from the limit that decides. So draws come in two
stages: the second is left out where the first has decided (Besag and Clifford, Biometrika 78, 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FIRST = 200  # draws, after which it is asked whether more are needed
SURE = 2.0  # standard errors that a chance must be away from a limit to need no more draws
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

    def value(self, minus_log_p: float) -> float:
        """The value whose `minus_log_p` this is: what speckle alone exceeds with that probability."""
        if minus_log_p <= -np.log(TAIL):
            return float(np.quantile(self.body, -np.expm1(-minus_log_p)))
        return self.edge + self.scale * float(minus_log_p + np.log(TAIL))

    def interval(self, value: float) -> tuple[float, float]:
        """Between which -ln p of a value beyond the edge lies, by `SURE` standard errors: those of the scale, known to
        one over the root of the draws there, and of the edge. Of any other value, that of the edge."""
        count = TAIL * self.body.size
        edge, relative, of_edge = -np.log(TAIL), SURE / np.sqrt(count), SURE * np.sqrt((1.0 - TAIL) / count)
        beyond = max(float(self(value)) - edge, 0.0)
        less = beyond - beyond / (1.0 + relative)
        more = beyond / max(1.0 - relative, TAIL) - beyond
        return edge + beyond - float(np.hypot(less, of_edge)), edge + beyond + float(np.hypot(more, of_edge))

    def value_error(self, minus_log_p: float) -> float:
        """Standard error of `value` beyond the edge, where the density is `TAIL` over the scale."""
        beyond = (minus_log_p + np.log(TAIL)) / np.sqrt(TAIL * self.body.size)
        return self.scale * float(np.hypot(beyond, np.sqrt((1.0 - TAIL) / (TAIL * self.body.size))))

    def __call__(self, values: npt.ArrayLike) -> np.ndarray:
        values = np.asarray(values, float)
        above = self.body.size - np.searchsorted(self.body, values, side="left")
        empirical = -np.log(np.maximum((above + 1.0) / (self.body.size + 1.0), TAIL))
        beyond = -np.log(TAIL) + (values - self.edge) / self.scale
        return np.where(values > self.edge, beyond, np.minimum(empirical, -np.log(TAIL)))


@dataclass(frozen=True)
class Tails:
    """-ln of the probability that speckle alone has anything so improbable among several statistics.

    Each statistic counts by its own tail, so that none with a far tail hides another one. `together`: of the most
    improbable one of each draw.
    """

    each: Sequence[Tail]
    together: Tail

    @classmethod
    def of(cls, draws: np.ndarray) -> Tails:
        """`draws`: shape (statistics, draws)."""
        each = [Tail.of(some) for some in draws]
        return cls(each, Tail.of(_largest(each, draws)))

    def first(self, values: npt.ArrayLike) -> int:
        """Which of the statistics, shape (statistics,), is the most improbable; of several beyond doubt, the first."""
        return int(np.argmax([tail(value) for tail, value in zip(self.each, np.asarray(values), strict=True)]))

    def interval(self, values: npt.ArrayLike) -> tuple[float, float]:
        """Between which -ln p of values, shape (statistics,), lies: as of a `Tail`, by its error and the one of
        `together`."""
        k = self.first(values)
        low, high = self.each[k].interval(float(np.asarray(values)[k]))
        return self.together.interval(low)[0], self.together.interval(high)[1]

    def __call__(self, values: npt.ArrayLike) -> np.ndarray:
        """-ln p of values of shape (statistics, ...), shape (...)."""
        return self.together(_largest(self.each, np.asarray(values, float)))


def _largest(tails: Sequence[Tail], values: np.ndarray) -> np.ndarray:
    """The largest -ln p over the statistics of values of shape (statistics, ...), shape (...)."""
    return np.asarray(np.max([tail(value) for tail, value in zip(tails, values, strict=True)], axis=0))
