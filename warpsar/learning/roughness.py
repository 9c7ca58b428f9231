"""What a learned field costs where neighbouring nodes differ: total variation in `learn` (equation 39), in log
coordinates with one weight per kind of parameter; in diagnosis a prior on x.

The prior too holds even ground, and hardly an edge. A Cauchy distribution of the differences d
is a mixture of Gaussians. Given what is known of d, their mean inverse variance goes with 1 / (s^2 + E[d^2]) (Andrews
and Mallows, J. Royal Statistical Society B 36, 1974). So each pair of neighbours has its own, found once from the
images. The prior is then quadratic, and the same for all models that are compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from scipy.sparse import csr_array

from warpsar.kernels import loss as kernels
from warpsar.learning.coordinates import DeviceX, SceneCoordinates
from warpsar.learning.prior import Known, Prior
from warpsar.runtime.program import Program
from warpsar.surface.surface import Block, Surface
from warpsar.world.mesh import Mesh

# Differences below this (0.1 % of a parameter) are priced as squares, so that the slope at 0 exists.
ROUNDING = 1e-3


def neighbours(block: Block, mesh: Mesh, material_index: int) -> np.ndarray:
    """Pairs of neighbouring nodes of a field, shape (n, 2), counted from the block's first node.

    Neighbours are texels that share a side, or vertices that share an edge of a face of the material.
    """
    if block.layout == "texture":
        number = np.arange(block.size).reshape(block.shape)
        across = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1)
        down = np.stack([number[:-1].ravel(), number[1:].ravel()], 1)
        return np.concatenate([across, down])
    faces = mesh.faces[mesh.face_material == material_index]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.sort(edges, axis=1), axis=0) - block.first_vertex


class TotalVariation:
    """Sum over neighbours of weight * |difference| of the learned fields, as a program with a gradient.

    `nodes`: the device array that views share (CUDA); by default it has its own. `loss` are partial sums, float64.
    """

    def __init__(
        self,
        surface: Surface,
        mesh: Mesh,
        weights: Mapping[str, float],
        device: wp.Device,
        nodes: wp.array | None,
    ) -> None:
        self.program = Program(device)
        self.nodes = self.program.array(surface.nodes.size) if nodes is None else nodes
        self.loss = self.program.array(int(kernels.PARTIALS), wp.float64, sum_into=True)
        pairs, strength = [], []
        for block in surface.blocks:
            weight = weights.get(block.kind.key, 0.0)
            if block.learn and block.size > 1 and weight > 0:
                found = neighbours(block, mesh, surface.materials.index(block.material)) + block.start
                pairs.append(found)
                strength.append(np.full(len(found), weight))
        self.count = sum(len(p) for p in pairs)
        if not self.count:
            return
        ends = np.concatenate(pairs).T.astype(np.int32, order="C")
        first: wp.array = wp.array(ends[0], dtype=int, device=device)
        second: wp.array = wp.array(ends[1], dtype=int, device=device)
        weight_array: wp.array = wp.array(np.concatenate(strength).astype(np.float32), dtype=float, device=device)
        self.program.launch(
            kernels.variation_kernel,
            self.count,
            [first, second, weight_array, self.nodes, ROUNDING],
            [self.loss],
        )


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
            if (usable := mine & known).any():
                precision[mine] = 1.0 / (np.median(square[usable]) + square[mine])
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

    def __init__(self, known: Sequence[Known], size: int, roughness: Roughness, standard: slice = slice(0, 0)) -> None:
        super().__init__(known, size, standard)
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
