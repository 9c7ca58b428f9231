"""Fields of which each rises or falls as a whole: what can be said of them before their geometry is known.

A search on blurred images moves bodies by metres. Nodes that are free meanwhile would paint a body where it is not, and
fields that are held keep a wrong level, which sizes then make up for (docs/learn-method.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from warpsar.learning.prior import Prior
from warpsar.learning.problem import FitProblem

STEP = 1e-2  # of a level, up and down


@dataclass(frozen=True)
class FieldLevels:
    """The x of a fit problem by a vector y of its numbers and one level for each field, in the order of x.

    x is `base` + y[`element`], within `bounds`, (p,) each: `base`, shape (p,), has the fields' nodes as they stand, and
    0 at numbers. `labels`, `start` and `ends` are those of y.
    """

    base: np.ndarray
    element: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    labels: list[str]
    start: np.ndarray
    ends: tuple[np.ndarray, np.ndarray]

    @classmethod
    def of(cls, problem: FitProblem) -> FieldLevels:
        """About where the problem stands."""
        sizes = [block.size for block in problem.surface.blocks if block.learn]
        sizes += [1] * (problem.x0.size - problem.learned.size)
        firsts = np.cumsum([0, *sizes[:-1]])
        alone = np.array(sizes) == 1
        element = np.repeat(np.arange(len(sizes)), sizes)
        labels = problem.labels
        base = np.where(alone[element], 0.0, problem.x0)
        low, high = problem.bounds
        return cls(
            base,
            element,
            (low, high),
            [
                labels[k] if one else f"{labels[k].partition('[')[0]} level"
                for k, one in zip(firsts, alone, strict=True)
            ],
            np.where(alone, problem.x0[firsts], 0.0),
            (np.minimum.reduceat(low - base, firsts), np.maximum.reduceat(high - base, firsts)),
        )

    def x(self, y: np.ndarray) -> np.ndarray:
        """The problem's x, shape (p,)."""
        return np.clip(self.base + y[self.element], *self.bounds)

    def jacobian(self, problem: FitProblem, y: np.ndarray) -> list[np.ndarray]:
        """d ln(mu) / dy of every observation, shape (pixels, len(y)); to levels by central differences of images."""
        counts = np.bincount(self.element)
        firsts = np.cumsum([0, *counts[:-1]])
        numbers = np.flatnonzero(counts == 1)
        found = [np.zeros((seen.count, y.size)) for seen in problem.observations]
        if numbers.size:
            for one, own in zip(found, problem.jacobian(self.x(y), firsts[numbers].tolist()), strict=True):
                one[:, numbers] = own
        for k in np.flatnonzero(counts > 1):
            up, down = (problem.modelled(self.x(y + way * STEP * (np.arange(y.size) == k))) for way in (1.0, -1.0))
            for one, above, below in zip(found, up, down, strict=True):
                one[:, k] = np.log(above / below) / (2.0 * STEP)
        return found

    def prior(self, whole: Prior, behind: int) -> Prior:
        """The prior of y and of so many elements `behind` it, from that of x and these. Nodes are not known."""
        size, p = self.start.size, self.element.size
        place = [*self.element.tolist(), *range(size, size + behind)]
        known = [replace(one, at=place[one.at]) for one in whole.known]
        standard = whole.standard
        return Prior(known, size + behind, slice(standard.start - p + size, standard.stop - p + size))

    def risen(self, known: Mapping[str, float]) -> np.ndarray:
        """The x at which levels and numbers are as `known` by label; those that are not stay."""
        pairs = zip(self.labels, self.start, strict=True)
        return self.x(np.array([known.get(label, value) for label, value in pairs]))
