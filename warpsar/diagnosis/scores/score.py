"""Score tests: how well templates fit the residual, beyond what the fitted parameters can absorb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb

import numpy as np
from scipy.sparse import csc_array, hstack
from scipy.special import gammaincc, gammaln, logsumexp

from warpsar.diagnosis.scores.evidence import Evidence
from warpsar.diagnosis.scores.partly_known import NOTHING, PartlyKnown
from warpsar.diagnosis.scores.templates import Template
from warpsar.runtime.matmul import times, transposed_times

NOT_TESTABLE = 1e-3  # share of a template's energy outside the tangent space (docs/diagnosis-method.md)
# Directions of the tangent weaker than this, relative to the strongest, are rounding of float32 images.
RANK = 1e-5
# How far a parameter may have to move (in ln or logit) to change the images by one standard deviation of speckle. A
# direction that takes more imitates nothing: bounds and the bend of the model come first.
REACH = 5.0
SPARSE = 0.1  # share of pixels that a template touches, below which it is kept as a sparse column


class TangentProjection:
    """Removes the tangent space of the fitted parameters from templates and residuals, in standardised units; of a
    parameter that is `known` to a tolerance, as much as it may move.

    `alone`: the share of its template's energy that has to be left for an effect to be found by itself.
    """

    def __init__(self, tangent: np.ndarray, root_looks: np.ndarray, known: PartlyKnown = NOTHING) -> None:
        self.known, self.alone = known, NOT_TESTABLE
        scaled = known.under(root_looks[:, None] * tangent)
        norms = np.linalg.norm(scaled, axis=0)
        scaled = scaled / np.where(norms > 0, norms, 1.0)
        left, strength, right = np.linalg.svd(scaled, full_matrices=False)
        strong = strength > RANK * strength.max(initial=0.0)
        moved = np.abs(right / np.where(norms > 0, norms, 1.0)).max(axis=1, initial=0.0)
        basis = left[:, strong & (moved < REACH * strength)]
        self._imitates = left[: len(tangent), strong]  # by any move
        self.basis, self._below = np.split(basis, [len(tangent)])
        self._under: Evidence | None = None

    def __call__(self, columns: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
        """What is left of standardised columns, shape (n, k) or (n,); `known` are their rows of what is known."""
        table = columns.reshape(len(columns), -1)
        basis = self._single if table.dtype == np.float32 else self.basis
        absorbed = transposed_times(basis, table)
        if known is not None:
            absorbed = absorbed + self._below.T @ known.reshape(len(known), table.shape[1])
        return (table - times(basis, absorbed.astype(basis.dtype, copy=False))).reshape(columns.shape)

    @cached_property
    def _single(self) -> np.ndarray:
        return self.basis.astype(np.float32)

    def left(self, columns: np.ndarray | csc_array) -> np.ndarray:
        """Share of energy of standardised columns of unit length that no move of the parameters imitates, however far,
        shape (k,)."""
        return np.maximum(1.0 - (np.asarray(columns.T @ self._imitates) ** 2).sum(axis=1), 0.0)

    def compared(self, columns: np.ndarray) -> np.ndarray:
        """Columns as effects are compared by them: as they are."""
        return columns

    def covariances(self, columns: np.ndarray | csc_array, k: int, evidence: Evidence) -> np.ndarray:
        """Covariance, under speckle, of the scores of every trial of `k` projected columns, shape (trials, k, k).

        With T = columns, B = basis and C = the residual's covariance, T' (1 - BB') C (1 - BB') T is multiplied out:
        T'CT stays sparse where T is, and all else has the size of the basis. The rows of what is known add their own
        variance, which is 1.
        """
        if self._under is not evidence:  # the same for all effects
            self._under, self._seen = evidence, evidence.correlated(self.basis)
            self._half = self.basis.T @ self._seen / 2.0
        inside = self._inside(columns)
        across = np.asarray(columns.T @ self._seen).T - self._half @ inside
        crossed = np.einsum("bti,btj->tij", *(m.reshape(len(m), inside.shape[1] // k, k) for m in (inside, across)))
        below = self.left_under(columns).reshape(len(self._below), inside.shape[1] // k, k)
        known = np.einsum("bti,btj->tij", below, below)
        return evidence.products(columns, k) - crossed - crossed.swapaxes(1, 2) + known

    def left_under(self, columns: np.ndarray | csc_array) -> np.ndarray:
        """What is left of columns in the rows of what is known, shape (rows, k)."""
        return -self._below @ self._inside(columns)

    def _inside(self, columns: np.ndarray | csc_array) -> np.ndarray:
        """Coordinates of columns in the basis, shape (rank, k)."""
        return np.asarray(columns.T @ self.basis).T


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
class TemplateGroup:
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
        best = self._statistics(projected)
        return best, self._minus_log_p(best)

    def largest(self, projected: np.ndarray) -> np.ndarray:
        """The largest -ln p over the trials, shape (draws,): it rises with the statistic, alike for every trial."""
        return self._minus_log_p(self._statistics(projected).max(axis=0))

    def _minus_log_p(self, statistic: np.ndarray) -> np.ndarray:
        return minus_log_p(statistic, self.one_sided.count(False), self.one_sided.count(True))

    def _statistics(self, projected: np.ndarray) -> np.ndarray:
        trials, k = self.covariance.shape[:2]
        if isinstance(self.columns, np.ndarray):
            columns = self._single if projected.dtype == np.float32 else self.columns
            scores = transposed_times(columns, projected)
        else:
            scores = np.asarray(self.columns.T @ projected)
        scores = scores.reshape(trials, k, -1)
        best = np.zeros((trials, scores.shape[2]))
        for members, inverse in self._faces:
            step = inverse @ scores[:, members]
            inside = (step[:, self.one_sided.count(False) :] >= 0).all(axis=1)
            gain = (scores[:, members] * step).sum(axis=1)
            best = np.where(inside, np.maximum(best, gain), best)
        return best

    @cached_property
    def _single(self) -> np.ndarray:
        """The columns in float32, for draws: their rounding is far below what speckle varies by."""
        assert isinstance(self.columns, np.ndarray)
        return self.columns.astype(np.float32)

    @cached_property
    def _faces(self) -> list[tuple[list[int], np.ndarray]]:
        """The coordinates of every face of the cone, two-sided ones first, and the inverse of their covariance."""
        free = [i for i, bound in enumerate(self.one_sided) if not bound]
        bound = [i for i, is_bound in enumerate(self.one_sided) if is_bound]
        faces = [[*free, *chosen] for size in range(len(bound) + 1) for chosen in combinations(bound, size)]
        parts = [(members, self.covariance[:, members][:, :, members]) for members in faces if members]
        return [(members, np.linalg.pinv(part, rcond=1e-10, hermitian=True)) for members, part in parts]


def group(templates: Sequence[Template], projection: TangentProjection, evidence: Evidence) -> list[TemplateGroup]:
    """Templates of one effect made ready for the residual at hand; only trials that are testable are kept in the
    groups, unless none is."""
    found = []
    for one_sided in dict.fromkeys(t.one_sided for t in templates):
        alike = [t for t in templates if t.one_sided == one_sided]
        columns = hstack([t.columns for t in alike], format="csc")
        columns.data *= evidence.root_looks[columns.indices]
        norms = np.sqrt(columns.power(2).sum(axis=0))
        columns.data /= np.repeat(np.where(norms > 0, norms, 1.0), np.diff(columns.indptr))
        ready = _dense_where_full(columns)
        k = len(one_sided)
        eta = ((norms > 0) * projection.left(ready)).reshape(-1, k).max(axis=1)
        testable = eta >= projection.alone
        if not testable.any():
            testable = eta >= NOT_TESTABLE
        keep = testable if testable.any() else np.ones_like(testable)
        ready = ready if keep.all() else ready[:, np.repeat(keep, k)]
        alike = [t for t, kept in zip(alike, keep, strict=True) if kept]
        found.append(TemplateGroup(alike, ready, projection.covariances(ready, k, evidence), eta[keep]))
    return found


def _dense_where_full(columns: csc_array) -> np.ndarray | csc_array:
    return columns if columns.nnz < SPARSE * np.prod(columns.shape) else columns.toarray(order="F")
