"""The variance of sums over cells, beside what sums of made fields scatter by; and parts that are off."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from warpsar.terrain.parts import part_in, refined
from warpsar.terrain.scatter import CellBlocks, CellScatter

SHAPE = (144, 120)
DRAWS = 60
CELL_SD, FIELD_SD = 0.3, 0.25


def fields(random: np.random.Generator, count: int) -> np.ndarray:
    """The field of each cell: the nearest of so many places."""
    places = cKDTree(random.uniform(0.0, 1.0, (count, 2)) * SHAPE)
    return np.asarray(places.query(np.stack(np.indices(SHAPE), axis=-1) + 0.5)[1])


def residual(random: np.random.Generator, count: int) -> np.ndarray:
    """Each field has a level, and each cell."""
    return random.normal(0.0, FIELD_SD, count)[fields(random, count)] + random.normal(0.0, CELL_SD, SHAPE)


@pytest.mark.full
@pytest.mark.parametrize("count", [40, 110, 400])
@pytest.mark.parametrize("halved", [False, True])
def test_sums_over_fields_scatter_as_is_said(count: int, halved: bool) -> None:
    """Fields some 21, 13 and 7 cells wide; the whole image, a square of 20 x 20 cells, and a slope along rows.

    60 draws tell a deviation to 9 %. Robust variances and four sizes of blocks for any width leave some 15 %.
    """
    random = np.random.default_rng(count)
    row, column = np.indices(SHAPE)
    where = (row // 6 + column // 6) % 2 == 0 if halved else np.ones(SHAPE, bool)
    square = (abs(row - 40) < 10) & (abs(column - 40) < 10)
    directions = np.stack([np.ones(where.sum()), square[where], row[where] / 72.0 - 1.0], axis=-1)
    blocks = CellBlocks.of(where)
    assert blocks.sizes == (6, 12, 24)
    sums, said = [], []
    for _ in range(DRAWS):
        scatter = CellScatter.of(residual(random, count)[where], blocks)
        sums.append((directions * (scatter.weights * scatter.residual)[:, None]).sum(axis=0))
        said.append(np.diag(scatter.covariance(directions)))
    np.testing.assert_allclose(np.sqrt(np.mean(said, axis=0)), np.std(sums, axis=0), rtol=0.25)


def test_a_field_that_is_quite_off_does_not_make_others_uncertain() -> None:
    """Of 110 fields one is off by 15 of their standard deviations."""
    random = np.random.default_rng(3)
    blocks = CellBlocks.of(np.ones(SHAPE, bool))
    even = residual(random, 110)
    odd = even + np.where(fields(random, 110) == 7, 15.0 * FIELD_SD, 0.0)
    sums = [
        np.sqrt(CellScatter.of(each.ravel(), blocks).covariance(np.ones((each.size, 1)))[0, 0]) for each in (even, odd)
    ]
    assert sums[1] < 1.3 * sums[0]


def test_the_shape_of_what_is_off_is_found_from_half_of_the_cells() -> None:
    random = np.random.default_rng(4)
    row, column = np.indices(SHAPE)
    lake = (row - 60.0) ** 2 + (column - 70.0) ** 2 < 8.0**2
    ratio = residual(random, 110) - np.where(lake, 2.0, 0.0)
    half = (row // 6 + column // 6) % 2 == 0
    may = column < 110
    blocks = CellBlocks.of(half)
    part = part_in(ratio, half, may, CellScatter.of(ratio[half], blocks))
    assert part is not None
    assert (part & ~lake).sum() < 0.1 * lake.sum()
    assert (part & lake).sum() > 0.3 * lake.sum()
    found = refined(ratio, np.ones(SHAPE, bool), may, part)
    assert found is not None
    inner, border = found
    assert not (inner & ~lake).any()
    assert (inner & lake).sum() > 0.5 * lake.sum()
    assert not (inner & border).any()
