"""What even ground tells of speckle: how the logarithm of measured over modelled power scatters within small blocks.

Log-cumulants of second and third order tell laws apart that have one variance (Nicolas, Traitement du Signal 19, 2002):
of a product of two gamma laws both are sums, psi'(L) + psi'(nu) and psi''(L) + psi''(nu).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import polygamma

from warpsar.speckle.law import looks_of_second

BLOCK = 12  # pixels on a side of a block, in which a plane is taken out of the logarithm
PLANE = 3  # numbers of a plane
FULL = 0.5  # share of a block that must be even ground
MANY = 16  # blocks, from which their own scatter is asked, too
OUTLIER = 4.0  # standard deviations from the other blocks, from which a block is not even
MOST_CORRELATED = 0.3  # of a block's variance, that the plane may take by the speckle's correlation
# Logarithms are less correlated than intensities, and slopes take less of them than a mean does: of a further pixel of
# correlation area so much. Found on fields blurred by 0.5 to 1.2 pixels, of 1 to 16 looks
# (tests/speckle/test_facts.py).
LESS = 0.55
# Pixels apart: those that share a response, too far for one of about a pixel, and too far for clumps of a few pixels.
NEXT, APART, FAR = 1, 3, 5


@dataclass(frozen=True)
class EvenGround:
    """Log-cumulants of one image's even ground, and their covariance, shape (2, 2).

    `second` and `third` are of ln(measured / modelled). `left_out`: blocks that differ from the others. `shared`: the
    part of the second cumulant that pixels `APART` have in common, beyond those `FAR` and beyond what a response makes
    of it, and its standard error: 0 for speckle and texture that are new in each pixel, above 0 for clumps.
    """

    second: float
    third: float
    covariance: np.ndarray
    pixels: int
    blocks: int
    left_out: int
    shared: tuple[float, float] = (0.0, np.inf)

    @property
    def looks(self) -> float:
        """Looks of the gamma law that has the second cumulant."""
        return looks_of_second(self.second)

    @property
    def looks_error(self) -> float:
        """Relative standard error of `looks`."""
        slope = -self.second / (self.looks * float(polygamma(2, self.looks)))
        return abs(slope) * float(np.sqrt(self.covariance[0, 0])) / self.second


def even_ground(ratio: np.ndarray, even: np.ndarray, correlated_pixels: float = 1.0) -> EvenGround | None:
    """The cumulants of the pixels `even` of an image; `ratio`: measured over modelled power; shape (rows, cols) each.

    A plane in each block takes up what the model misses over longer distances than a block. It takes up speckle too: of
    white speckle 3 of n pixels, and more of correlated speckle, whose correlation area is `correlated_pixels`.
    Blocks that stand out are left out: something stands there. None where no block is even.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        log = np.where(even & (ratio > 0), np.log(np.where(even, ratio, 1.0)), 0.0)
    even = even & (ratio > 0)
    rows, cols = (n // BLOCK * BLOCK for n in log.shape)
    values, inside = (_blocks(plane[:rows, :cols]) for plane in (log, even.astype(float)))
    count = inside.sum(axis=1)
    full = count >= FULL * BLOCK**2
    if not full.any():
        return None
    values, inside, count = values[full], inside[full], count[full]
    left = _without_plane(values, inside)
    taken = np.minimum(PLANE * (1.0 + LESS * (correlated_pixels - 1.0)) / count, MOST_CORRELATED)
    second = (left**2).sum(axis=1) / count / (1.0 - taken)
    third = (left**3).sum(axis=1) / count / (1.0 - PLANE / count) ** 3
    keep = _alike(second)
    weights = count[keep] / count[keep].sum()
    both = np.stack([second[keep], third[keep]])
    mean = both @ weights
    covariance = _sampling(float(mean[0]), float(count[keep].sum()))
    if keep.sum() >= MANY:
        away = both - mean[:, None]
        seen = (away * weights**2) @ away.T * keep.sum() / (keep.sum() - 1.0)
        covariance *= max(float(np.trace(seen @ np.linalg.inv(covariance))) / 2.0, 1.0)
    else:
        covariance *= max(correlated_pixels, 1.0)
    pixels, blocks, left_out = int(count[keep].sum()), int(keep.sum()), int((~keep).sum())
    shared = _shared(left[keep], inside[keep], float(mean[0]))
    return EvenGround(float(mean[0]), float(mean[1]), covariance, pixels, blocks, left_out, shared)


def _shared(left: np.ndarray, inside: np.ndarray, second: float) -> tuple[float, float]:
    """`EvenGround.shared` of blocks, shape (blocks, BLOCK^2). A Gaussian response correlates pixels d apart by the
    correlation of neighbours to the power d^2."""
    if len(left) < MANY:
        return 0.0, np.inf
    near, apart, far = (_correlation(left, inside, lag) / second for lag in (NEXT, APART, FAR))
    of_response = max(float((near - far).mean()), 0.0) ** (APART**2)
    beyond = apart - far
    return float(beyond.mean()) - of_response, float(beyond.std() / np.sqrt(len(left)))


def _correlation(left: np.ndarray, inside: np.ndarray, lag: int) -> np.ndarray:
    """Mean product of pixels so many rows or columns apart, shape (blocks,)."""
    values, there = (one.reshape(-1, BLOCK, BLOCK) for one in (left, inside))
    products, pairs = np.zeros(len(left)), np.zeros(len(left))
    for here, away in (np.s_[:, lag:], np.s_[:, :-lag]), (np.s_[:, :, lag:], np.s_[:, :, :-lag]):
        products += (values[here] * values[away]).sum(axis=(1, 2))
        pairs += (there[here] * there[away]).sum(axis=(1, 2))
    return np.asarray(products / np.maximum(pairs, 1.0))


def _sampling(second: float, pixels: float) -> np.ndarray:
    """Covariance of the second and third sample cumulant of independent pixels, whose law is the gamma law of that
    second cumulant (Kendall and Stuart, The Advanced Theory of Statistics 1, 1977, 12.16)."""
    k2, k3, k4, k5, k6 = (float(polygamma(order - 1, looks_of_second(second))) for order in range(2, 7))
    between = k5 + 6.0 * k2 * k3
    return np.array([[k4 + 2.0 * k2**2, between], [between, k6 + 9.0 * k4 * k2 + 9.0 * k3**2 + 6.0 * k2**3]]) / pixels


def _blocks(plane: np.ndarray) -> np.ndarray:
    """Blocks as rows, shape (blocks, BLOCK^2)."""
    down, across = (n // BLOCK for n in plane.shape)
    return plane.reshape(down, BLOCK, across, BLOCK).swapaxes(1, 2).reshape(-1, BLOCK**2)


def _without_plane(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """What the best plane leaves of each block's values; 0 where `inside` is 0."""
    at = (np.arange(BLOCK) - (BLOCK - 1) / 2.0) / BLOCK
    design = np.stack([np.ones(BLOCK**2), np.repeat(at, BLOCK), np.tile(at, BLOCK)], axis=1)
    normal = np.einsum("bn,ni,nj->bij", inside, design, design)
    right = np.einsum("bn,ni->bi", inside * values, design)
    return np.asarray(inside * (values - np.linalg.solve(normal, right[..., None])[..., 0] @ design.T))


def _alike(second: np.ndarray) -> np.ndarray:
    """Which blocks scatter as most others do."""
    log = np.log(np.maximum(second, 1e-30))
    keep = np.ones(log.size, bool)
    for _ in range(10):
        middle = np.median(log[keep])
        spread = 1.4826 * float(np.median(np.abs(log[keep] - middle)))
        now = np.abs(log - middle) <= OUTLIER * max(spread, 1e-6)
        if (now == keep).all():
            break
        keep = now
    return keep
