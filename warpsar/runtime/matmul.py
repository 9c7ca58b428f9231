"""Products of tall matrices inside one thread.

BLAS starts threads of its own for a large product. Called from several of our threads at once, these wait for one
another in busy loops: on two cores that other programs share, a bootstrap then takes ten times its CPU time. Pieces
below the size at which BLAS starts threads avoid that, and their sums do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np

TILE = 16  # pixels on a side
SMALL = 2**18  # multiplications of one product that OpenBLAS does in one thread (its GEMM_MULTITHREAD_THRESHOLD)
ROWS, COLUMNS = 256, 64  # of a piece, at most: small enough for products with a vector too


def _rows(k: int, m: int) -> int:
    return max(1, min(ROWS, SMALL // max(k * m, 1)))


def transposed_times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a' b, shape (k, m), of `a`, shape (n, k), and `b`, shape (n, m)."""
    (_, k), m = a.shape, b.shape[1]
    found = np.empty((k, m), np.result_type(a, b))
    for first in range(0, k, COLUMNS):
        for other in range(0, m, COLUMNS):
            block = slice(first, first + COLUMNS), slice(other, other + COLUMNS)
            found[block] = _block(a[:, block[0]], b[:, block[1]])
    return found


def _block(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a' b of at most `COLUMNS` columns each, by pieces of their rows."""
    (n, k), m = a.shape, b.shape[1]
    rows = _rows(k, m)
    whole = n - n % rows
    pieces = a[:whole].reshape(n // rows, rows, k).swapaxes(1, 2) @ b[:whole].reshape(n // rows, rows, m)
    return np.asarray(pieces.sum(axis=0) + a[whole:].T @ b[whole:])


def gram(j: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """j' diag(weight) j, shape (k, k), of `j`, shape (n, k): the half above the diagonal is the other half, too."""
    k, weighted = j.shape[1], weight[:, None] * j
    found = np.empty((k, k))
    for first in range(0, k, COLUMNS):
        for other in range(first, k, COLUMNS):
            row, column = slice(first, first + COLUMNS), slice(other, other + COLUMNS)
            block = _block(j[:, row], weighted[:, column])
            found[column, row] = block.T
            found[row, column] = block
    return found


def gram_by_tiles(j: np.ndarray, weight: np.ndarray, pixels: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """j' diag(weight) j, shape (k, k), of `j`, shape (n, k), whose rows belong to `pixels` (n,) of an image of a
    `shape` (rows, columns).

    Columns that are 0 in a tile of `TILE` x `TILE` pixels take no part there. A hundred bodies of which each changes
    the image near by alone then cost little more than one does.
    """
    row, column = np.divmod(pixels, shape[1])
    tile = (row // TILE) * (shape[1] // TILE + 1) + column // TILE
    order = np.argsort(tile, kind="stable")
    ends = np.flatnonzero(np.diff(tile[order])) + 1
    found = np.zeros((j.shape[1], j.shape[1]))
    for inside in np.split(order, ends):
        part = j[inside]
        some = np.flatnonzero(part.any(axis=0))
        part = part[:, some]
        found[np.ix_(some, some)] += gram(part, weight[inside])
    return found


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a b, shape (n, m), of `a`, shape (n, k), and `b`, shape (k, m)."""
    n, k = a.shape
    rows = _rows(k, b.shape[1])
    found = np.empty((n, b.shape[1]), np.result_type(a, b))
    whole = n - n % rows
    np.matmul(a[:whole].reshape(n // rows, rows, k), b, out=found[:whole].reshape(n // rows, rows, b.shape[1]))
    found[whole:] = a[whole:] @ b
    return found
