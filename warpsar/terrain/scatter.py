"""How measured cells scatter about a model, and what neighbours have in common.

Real fields are alike inside: cells near each other are off by the same. So a residual is taken for a sum of parts that
know nothing of each other: one of each cell, and stationary ones whose covariance falls off linearly over 6, 12, 24,
... cells along both axes. Their variances follow from those of the means over blocks of these sizes, as large as there
are enough blocks for. Those are measured robustly: a field that is quite off does not make all others look uncertain.
Then any sum over cells has its variance, whatever the width of fields.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from warpsar.terrain.comparison import SQUARE

F64 = NDArray[np.float64]
CAP = 6.0
"""Residuals count in full up to so many of their robust standard deviation: a bright point is not a level."""
LEAST_BLOCKS = 12
"""Of a size: fewer do not tell a variance."""
FILLED = 0.25
"""Share of a block's cells that must be used."""
LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class CellBlocks:
    """Blocks of doubling size over the cells of `where` (rows, columns) that are used."""

    where: NDArray[np.bool_]
    sizes: tuple[int, ...]
    """Cells along a side: `SQUARE`, then its doubles."""
    of_cell: tuple[NDArray[np.intp], ...]
    """The block of each used cell, (n,), by size."""
    whole: tuple[NDArray[np.bool_], ...]
    """Blocks with so many cells that their mean says something, by size."""
    left: F64
    """(sizes, 1 + sizes): what a mean over a block of the row's size has of the variance of a cell's part, and of the
    parts that reach over each size."""

    @classmethod
    def of(cls, where: NDArray[np.bool_]) -> CellBlocks:
        row, column = np.nonzero(where)
        sizes: list[int] = []
        of_cell: list[NDArray[np.intp]] = []
        whole: list[NDArray[np.bool_]] = []
        typical: list[NDArray[np.bool_]] = []
        size = SQUARE
        while True:
            across = where.shape[1] // size + 1
            which = row // size * across + column // size
            count = np.bincount(which)
            fit = count >= FILLED * size**2
            if fit.sum() < LEAST_BLOCKS:
                break
            sizes.append(size)
            of_cell.append(which)
            whole.append(fit)
            top, left = (size * k for k in divmod(int(np.argmax(count)), across))
            typical.append(where[top : top + size, left : left + size])
            size *= 2
        table = [
            [1.0 / block.sum(), *(_in_common(block.astype(np.float64), reach) / block.sum() ** 2 for reach in sizes)]
            for block in typical
        ]
        return cls(where, tuple(sizes), tuple(of_cell), tuple(whole), np.array(table))

    def in_common(self, directions: F64, reach: int) -> F64:
        """Of sums along directions (n, k): their covariance (k, k) for a part of variance 1 that reaches so far."""
        rasters = np.zeros((directions.shape[1], *self.where.shape))
        rasters[:, self.where] = directions.T
        sums = np.stack([_box_sums(each, reach).ravel() for each in rasters], axis=-1)
        return np.asarray(sums.T @ sums) / reach**2


def _box_sums(values: F64, side: int) -> F64:
    """Sums over all squares of so many cells along a side that meet an array (rows, columns)."""
    for axis in (0, 1):
        width = [(side, side - 1) if k == axis else (0, 0) for k in (0, 1)]
        total = np.cumsum(np.pad(values, width), axis=axis)
        values = np.take(total, np.arange(side, total.shape[axis]), axis=axis) - np.take(
            total, np.arange(total.shape[axis] - side), axis=axis
        )
    return values


def _in_common(values: F64, reach: int) -> float:
    """The variance of the sum of `values` (rows, columns) times a part of variance 1 that reaches so far."""
    return float((_box_sums(values, reach) ** 2).sum()) / reach**2


@dataclass(frozen=True)
class CellScatter:
    """Of residuals (n,) of cells: their weights, and the variances of the parts that they are sums of."""

    residual: F64
    weights: F64
    variance: float
    """Of a cell, robustly: of all parts together."""
    variances: tuple[float, ...]
    """Of a cell by itself, then of what reaches over each size of blocks."""
    blocks: CellBlocks

    @classmethod
    def of(cls, residual: F64, blocks: CellBlocks) -> CellScatter:
        variance = max(robust_variance(residual), LEAST_VARIANCE)
        return cls(residual, weights_of(residual), variance, _variances(residual, blocks), blocks)

    def covariance(self, directions: F64) -> F64:
        """Of the sums of residual times direction (n, k) over cells."""
        weighted = directions * self.weights[:, None]
        total = self.variances[0] * weighted.T @ weighted
        for variance, reach in zip(self.variances[1:], self.blocks.sizes, strict=True):
            if variance > 0.0:
                total = total + variance * self.blocks.in_common(weighted, reach)
        return np.asarray(total)

    def common(self, side: int) -> float:
        """Variance of a mean over a block of so many cells along a side, of all that reaches beyond a cell."""
        block = np.full((side, side), side**-2.0)
        return sum(v * _in_common(block, reach) for v, reach in zip(self.variances[1:], self.blocks.sizes, strict=True))


def weights_of(residual: F64) -> F64:
    """1, and less beyond `CAP`: there a residual counts as if it lay at `CAP`."""
    far = np.abs(residual - np.median(residual))
    return np.asarray(np.minimum(1.0, CAP * np.sqrt(robust_variance(residual)) / np.maximum(far, 1e-300)))


def robust_variance(values: F64) -> float:
    return float((1.4826 * np.median(np.abs(values - np.median(values)))) ** 2)


def _variances(residual: F64, blocks: CellBlocks) -> tuple[float, ...]:
    """So that cells, and means over blocks of each size, have the variance that they are seen to have."""
    seen = [robust_variance(residual)]
    for which, whole in zip(blocks.of_cell, blocks.whole, strict=True):
        seen.append(robust_variance((np.bincount(which, residual) / np.maximum(np.bincount(which), 1))[whole]))
    values = np.array(seen)
    table = np.vstack([np.ones(1 + len(blocks.sizes)), blocks.left]) if blocks.sizes else np.ones((1, 1))
    scale = 1.0 / np.maximum(values, LEAST_VARIANCE)  # each size counts alike
    found, _ = nnls(table * scale[:, None], values * scale)
    return (max(float(found[0]), LEAST_VARIANCE), *found[1:].tolist())
