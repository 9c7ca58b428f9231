"""What is expected of a learned field: how far neighbouring nodes differ, as a prior on x.

As total variation (regularise.py) it holds even ground, and hardly an edge. A Cauchy distribution of the differences d
is a mixture of Gaussians. Given what is known of d, their mean inverse variance goes with 1 / (s^2 + E[d^2]) (Andrews
and Mallows, J. Royal Statistical Society B 36, 1974). So each pair of neighbours has its own, found once from the
images. The prior is then quadratic, and the same for all models that are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from warpsar.learning.coordinates import DeviceX, SceneCoordinates
from warpsar.learning.prior import Known, Prior
from warpsar.learning.regularise import ROUNDING, neighbours


@dataclass(frozen=True)
class Roughness:
    """Pairs of neighbouring elements of x, shape (m, 2), the inverse variance of their difference, (m,), and the number
    of the field that each pair belongs to, (m,). `sizes` are the fields' numbers of nodes."""

    pairs: np.ndarray
    precision: np.ndarray
    field: np.ndarray
    sizes: tuple[int, ...]

    @classmethod
    def of(cls, coordinates: SceneCoordinates, precision: float) -> Roughness:
        """One precision for all learned fields of a scene; uniform parameters have no neighbours."""
        scene, surface = coordinates.scene, coordinates.surface
        pairs, sizes, at = [], [], 0
        for block in (block for block in surface.blocks if block.learn):
            if block.size > 1:
                found = neighbours(block, scene.mesh, surface.materials.index(block.material))
                pairs.append(found + at)
                sizes.append(block.size)
            at += block.size
        numbers = np.repeat(np.arange(len(pairs)), [len(found) for found in pairs])
        return cls(np.concatenate(pairs), np.full(numbers.size, precision), numbers, tuple(sizes))

    def expected(self, x: np.ndarray, errors: np.ndarray, seen: np.ndarray) -> Roughness:
        """The precisions that fields at x expect, where x is known with `errors`: random moves of x within what the
        data leave open, shape (p, draws). `seen`: which elements of x the data tell something of, shape (p,).

        1 / (s^2 + E[d^2]), where s^2 is the median of E[d^2] over a field's seen pairs. A Cauchy distribution has twice
        that, and a field has twice as many pairs as nodes.
        """
        square = self.differences(x) ** 2 + np.mean(self.differences(errors) ** 2, axis=1)
        square = np.maximum(square, ROUNDING**2)
        known = seen[self.pairs].all(axis=1)
        precision = self.precision.copy()
        for number in range(len(self.sizes)):
            mine = self.field == number
            if (told := mine & known).any():
                precision[mine] = 1.0 / (np.median(square[told]) + square[mine])
        return replace(self, precision=precision)

    def differences(self, x: np.ndarray) -> np.ndarray:
        """How far neighbours differ, shape (m,) or (m, n) for x of shape (p, n)."""
        return np.asarray(x[self.pairs[:, 0]] - x[self.pairs[:, 1]])

    def rows(self, size: int) -> csr_array:
        """The differences in standard deviations as a linear function of an x of `size` elements, shape (m, size)."""
        root, count = np.sqrt(self.precision), len(self.pairs)
        data = np.column_stack([root, -root]).ravel()
        return csr_array((data, self.pairs.ravel(), 2 * np.arange(count + 1)), shape=(count, size))


class FieldPrior(Prior):
    """The prior of an x with fields: what is `known` to a tolerance, and the fields' `roughness`."""

    def __init__(self, known: Sequence[Known], size: int, roughness: Roughness) -> None:
        super().__init__(known, size)
        self.roughness = roughness
        self.rows = roughness.rows(size)

    def value(self, x: np.ndarray | DeviceX) -> float:
        return super().value(x) + 0.5 * float(np.sum((self.rows @ np.asarray(x)) ** 2))

    def gradient(self, x: np.ndarray | DeviceX) -> np.ndarray:
        return np.asarray(super().gradient(x) + self.rows.T @ (self.rows @ np.asarray(x)))

    def sparse_information(self, x: np.ndarray | DeviceX) -> csr_array:
        """Its curvature without the bend of the coordinates, shape (p, p); of roughness it is exact."""
        slopes = csr_array(self.slopes(x))
        return csr_array(self.rows.T @ self.rows + slopes.T @ slopes)
