"""Score tests: how well templates fit the residual, beyond what the fitted parameters can absorb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from scipy.sparse import csc_array
from scipy.special import gammaincc, gammaln, logsumexp

from warpsar.diagnosis.evidence import Evidence
from warpsar.diagnosis.partly_known import NOTHING, PartlyKnown
from warpsar.diagnosis.templates import Template

NOT_TESTABLE = 1e-3  # share of a template's energy outside the tangent space (docs/diagnosis.md)
# Directions of the tangent weaker than this, relative to the strongest, are rounding of float32 images.
RANK = 1e-5
SPARSE = 0.1  # share of pixels that a template touches, below which it is kept as a sparse column


class Projection:
    """Removes the tangent space of the fitted parameters from templates and residuals, in standardised units; of a
    parameter that is `known` to a tolerance, as much as it may move."""

    def __init__(self, tangent: np.ndarray, root_looks: np.ndarray, known: PartlyKnown = NOTHING) -> None:
        self.known = known
        scaled = known.under(root_looks[:, None] * tangent)
        norms = np.linalg.norm(scaled, axis=0)
        scaled = scaled / np.where(norms > 0, norms, 1.0)
        left, strength, _ = np.linalg.svd(scaled, full_matrices=False)
        basis = left[:, strength > RANK * strength.max(initial=0.0)]
        self.basis, self._under = np.split(basis, [len(tangent)])

    def __call__(self, columns: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
        """What is left of standardised columns, shape (n, k) or (n,); `known` are their rows of what is known."""
        absorbed = self.basis.T @ columns
        return columns - self.basis @ (absorbed if known is None else absorbed + self._under.T @ known)

    def left_under(self, columns: np.ndarray) -> np.ndarray:
        """What is left of columns in the rows of what is known, shape (rows, k)."""
        return -self._under @ (self.basis.T @ columns)


def log_tail(statistic: np.ndarray, degrees: int) -> np.ndarray:
    """ln of the upper tail of a chi-square, also where it is below the smallest float."""
    a, x = degrees / 2.0, np.maximum(np.asarray(statistic, float), 0.0) / 2.0
    if degrees == 0:
        return np.where(x > 0, -np.inf, 0.0)
    large = np.maximum(x, 300.0)
    series = 1.0 + (a - 1.0) / large + (a - 1.0) * (a - 2.0) / large**2
    beyond = -large + (a - 1.0) * np.log(large) - gammaln(a) + np.log(series)
    return np.where(x < 300.0, np.log(np.maximum(gammaincc(a, x), 1e-300)), beyond)


def minus_log_p(statistic: np.ndarray, two_sided: int, one_sided: int) -> np.ndarray:
    """-ln p of a score test with one-sided coordinates: the mixture of chi-squares with binomial weights (exact for
    independent coordinates; Self and Liang, 1987). What the approximation leaves, the bootstrap takes out."""
    terms = [
        np.log(comb(one_sided, extra) / 2.0**one_sided) + log_tail(statistic, two_sided + extra)
        for extra in range(one_sided + 1)
    ]
    return -logsumexp(np.stack(terms), axis=0)


@dataclass(frozen=True)
class Group:
    """All templates of one effect with the same coordinates, two- and one-sided: `columns`, shape (n, trials * k), a
    matrix or sparse, standardised and of unit length, not projected; `covariance`, shape (trials, k, k), of their
    scores once projected; `eta`, shape (trials,), the share of energy that the projection leaves of the best column."""

    templates: list[Template]
    columns: np.ndarray | csc_array
    covariance: np.ndarray
    eta: np.ndarray

    @property
    def one_sided(self) -> tuple[bool, ...]:
        return self.templates[0].one_sided

    def columns_of(self, trial: int) -> np.ndarray:
        """The columns of one trial, shape (n, k), as a matrix."""
        k = len(self.one_sided)
        found = self.columns[:, trial * k : (trial + 1) * k]
        return found if isinstance(found, np.ndarray) else np.asarray(found.toarray())

    def statistics(self, projected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(statistic, -ln p), each of shape (trials, draws), of projected residuals, shape (n, draws).

        Two-sided coordinates: S' V^-1 S. One-sided ones (a level, a variance) may not go negative: the largest gain
        over the faces of the cone.
        """
        trials, k = self.covariance.shape[:2]
        scores = np.asarray(self.columns.T @ projected).reshape(trials, k, -1)
        free = [i for i, bound in enumerate(self.one_sided) if not bound]
        bound = [i for i, is_bound in enumerate(self.one_sided) if is_bound]
        best = np.zeros((trials, scores.shape[2]))
        for size in range(len(bound) + 1):
            for chosen in combinations(bound, size):
                members = [*free, *chosen]
                if members:
                    part = self.covariance[:, members][:, :, members]
                    step = np.linalg.pinv(part, rcond=1e-10, hermitian=True) @ scores[:, members]
                    inside = (step[:, len(free) :] >= 0).all(axis=1)
                    gain = (scores[:, members] * step).sum(axis=1)
                    best = np.where(inside, np.maximum(best, gain), best)
        return best, minus_log_p(best, len(free), len(bound))


def group(templates: Sequence[Template], projection: Projection, evidence: Evidence) -> list[Group]:
    """Templates of one effect made ready for the residual at hand; only trials that are testable are kept in the
    groups, unless none is."""
    found = []
    for one_sided in dict.fromkeys(t.one_sided for t in templates):
        alike = [t for t in templates if t.one_sided == one_sided]
        columns = np.concatenate([evidence.root_looks[:, None] * t.columns for t in alike], axis=1)
        norms = np.linalg.norm(columns, axis=0)
        columns /= np.where(norms > 0, norms, 1.0)
        absorbed = projection.basis.T @ columns
        left = (norms > 0) * np.maximum(1.0 - (absorbed**2).sum(axis=0), 0.0)
        k = len(one_sided)
        eta = left.reshape(-1, k).max(axis=1)
        testable = eta >= NOT_TESTABLE
        keep = testable if testable.any() else np.ones_like(testable)
        chosen = np.repeat(keep, k)
        columns = columns[:, chosen]
        alike = [t for t, kept in zip(alike, keep, strict=True) if kept]
        covariance = _covariances(columns, projection, evidence, k)
        found.append(Group(alike, _compact(columns), covariance, eta[keep]))
    return found


def _covariances(columns: np.ndarray, projection: Projection, evidence: Evidence, k: int) -> np.ndarray:
    """Covariance of the scores of every trial, shape (trials, k, k)."""
    trials = columns.shape[1] // k
    covariance = np.empty((trials, k, k))
    white = np.count_nonzero(evidence.autocovariance) == 1
    for trial in range(trials):
        mine = columns[:, trial * k : (trial + 1) * k]
        left, under = projection(mine), projection.left_under(mine)
        covariance[trial] = evidence.autocovariance.max() * (left.T @ left) if white else evidence.products(left)
        covariance[trial] += under.T @ under
    return covariance


def _compact(columns: np.ndarray) -> np.ndarray | csc_array:
    """Sparse where most of it is zero."""
    if np.count_nonzero(columns) < SPARSE * columns.size:
        return csc_array(columns)
    return columns
