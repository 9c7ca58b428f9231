"""The correlation and the variance that speckle itself has in a residual, whatever structure lies in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpsar.speckle.law import Law

LAGS = 6  # pixels, each way, over which neighbours are taken to be correlated
_FALL = np.minimum(1.0, 2.0 - 2.0 * np.abs(np.arange(-LAGS, LAGS + 1)) / (LAGS + 1.0))
TAPER = np.outer(_FALL, _FALL)  # of an autocovariance: flat to half the lags (Politis and Romano, 1995)
FAR = 5.0  # pixels from which neighbours are taken to share no speckle
BLOCK = 12  # pixels on a side of a block
FULL = 0.25  # share of a block's pairs of pixels that must be there
LARGEST = 8.0  # standard deviations at which a residual is cut off


@dataclass(frozen=True)
class Patch:
    """`ratio`: measured over modelled power, shape (rows, cols), where `interior` holds; `law` of its speckle."""

    interior: np.ndarray
    ratio: np.ndarray
    law: Law

    @property
    def looks(self) -> float:
        return self.law.equivalent_looks

    @property
    def values(self) -> np.ndarray:
        """The ratio of the interior, shape (n,)."""
        return self.ratio[self.interior]


def own_autocovariance(patches: Sequence[Patch]) -> tuple[np.ndarray, float]:
    """Autocorrelation of the speckle, shape (2 LAGS + 1, 2 LAGS + 1), and its variance in units of 1 / looks.

    Structure in the residual looks like correlated speckle of a large variance, and would excuse itself. So pixels
    are taken about the median of their own block, and the median over all blocks counts: what lies in less than
    half of the blocks moves it little. A gain with a ripple lies in all of them, and makes pixels of a line alike
    however far apart they are. So speckle has the part of each lag that those from `FAR` on do not foretell by its
    rows and its columns (`_of_lines`); a block's own level, which lowers all lags alike, goes with it. Lags below
    three times their sampling error, by the pairs of pixels that each has, and negative ones, are set to zero. A
    block that measured no power in half of its pixels has no level, and says nothing. Where no block has pixels
    enough, the speckle is taken for white, and its variance for 1.
    """
    lags = [(i, j) for i in range(LAGS + 1) for j in range(-LAGS, LAGS + 1) if (i, j) >= (0, 0)]
    means: list[list[np.ndarray]] = [[] for _ in lags]
    pairs = np.ones(len(lags))  # and one, so that a lag without any has an error
    for patch in patches:
        level = _levels(patch)
        inside = (patch.interior & (level > 0.0)).astype(float)
        level[level <= 0.0] = 1.0
        standing = _standardised(patch.ratio, level, patch.looks)
        for k, (i, j) in enumerate(lags):
            both = np.multiply(*_pair(inside, i, j))
            product = _standardised(_pair(patch.ratio, i, j)[1], _pair(level, i, j)[0], patch.looks)
            product *= _pair(standing, i, j)[0]
            product *= both
            count = _blocks(both)
            enough = count >= FULL * BLOCK**2
            means[k].append(_blocks(product)[enough] / count[enough])
            pairs[k] += count[enough].sum()
    medians = np.array([np.median(blocks) if (blocks := np.concatenate(m)).size else 0.0 for m in means])
    without_lines = np.eye(len(lags)) - _of_lines(lags)
    medians = without_lines @ medians
    correlation = np.zeros((2 * LAGS + 1, 2 * LAGS + 1))
    correlation[LAGS, LAGS] = 1.0
    variance = float(medians[lags.index((0, 0))])
    if variance <= 0:
        return correlation, 1.0
    # a median of normal values scatters by 1.25 of what a mean does
    noise = 3.0 * 1.25 * np.sqrt(without_lines**2 @ (1.0 / pairs))
    for (i, j), median, least in zip(lags, medians, noise, strict=True):
        if median > least * variance:
            correlation[LAGS + i, LAGS + j] = correlation[LAGS - i, LAGS - j] = min(median / variance, 1.0)
    return correlation * TAPER, variance


def _of_lines(lags: Sequence[tuple[int, int]]) -> np.ndarray:
    """What lines share at each lag, as weights of all lags, shape (lags, lags): a number for the rows and one for the
    columns that pixels are apart, their sum fitted to the lags from `FAR` on, where speckle shares nothing."""
    apart = np.abs(lags)
    design = np.concatenate([np.eye(LAGS + 1)[apart[:, axis]] for axis in (0, 1)], axis=1)
    far = np.hypot(*apart.T) >= FAR
    return np.asarray(design @ np.linalg.pinv(design * far[:, None]))


def _levels(patch: Patch) -> np.ndarray:
    """The ratio's level in the block of each pixel, by its median, shape (rows, cols); 1 where a block is empty."""
    rows, cols = patch.ratio.shape
    values = np.where(patch.interior, patch.ratio, np.nan)
    values = np.pad(values, ((0, -rows % BLOCK), (0, -cols % BLOCK)), constant_values=np.nan)
    down, across = (n // BLOCK for n in values.shape)
    blocks = values.reshape(down, BLOCK, across, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)
    level, some = np.ones(len(blocks)), np.isfinite(blocks).any(axis=1)
    level[some] = np.nanmedian(blocks[some], axis=1) / patch.law.median
    return np.kron(level.reshape(down, across), np.ones((BLOCK, BLOCK)))[:rows, :cols]


def _standardised(ratio: np.ndarray, level: np.ndarray, looks: float) -> np.ndarray:
    """sqrt(L) (ratio / level - 1) within +-`LARGEST`, as a new array."""
    found = ratio / level
    found -= 1.0
    found *= np.sqrt(looks)
    return np.clip(found, -LARGEST, LARGEST, out=found)


def _pair(image: np.ndarray, i: int, j: int) -> tuple[np.ndarray, np.ndarray]:
    """`image` where a pixel has one `i` rows and `j` columns further, and the values there."""
    rows, cols = image.shape
    here = image[: max(rows - i, 0), max(0, -j) : cols - max(0, j)]
    return here, image[i:, max(0, j) : cols - max(0, -j)]


def _blocks(image: np.ndarray) -> np.ndarray:
    """Sums over blocks, flat; those at the far edges hold fewer pixels."""
    if not image.size:
        return np.zeros(0)
    rows = np.add.reduceat(image, np.arange(0, image.shape[0], BLOCK), axis=0)
    return np.add.reduceat(rows, np.arange(0, image.shape[1], BLOCK), axis=1).ravel()
