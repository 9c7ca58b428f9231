"""Score tests beside learned fields: their tangent space is taken out by a sparse solution.

A field's tangent space has thousands of directions, and a basis of it would be dense. But a node meets few pixels. With
A the tangent in standard deviations of speckle and D the rows of what is known (tolerances, and how rough fields are),
all rows together are projected as in `partly_known.py`: on the pixels, A (A'A + D'D)^-1 A' is taken off. The matrix
within is sparse, and is factored once in a turn.

A field is pulled by its prior. Its contrasts become too small, by little in each pixel, but alike in all. A score
test would take that for an effect. So scores leave the fields nearly free (`FREED`), and find what no field could do.
Whether an effect is testable at all is asked with the fields quite free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array, hstack, vstack

from warpsar.diagnosis.found import Candidate
from warpsar.diagnosis.models.field_prior import factor, solved
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.scores.evidence import TRIALS, Evidence
from warpsar.diagnosis.scores.partly_known import PartlyKnown
from warpsar.diagnosis.scores.score import REACH, TangentProjection
from warpsar.diagnosis.scores.templates import TemplateMaker
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import Roughness
from warpsar.speckle.draws import Speckle
from warpsar.speckle.residual import residual_autocovariance

FREED = 1e-3  # of the fields' inverse variances, that scores keep: enough to hold what no pixel sees
# Share of a template's energy outside the fields' tangent space. A field that lies a tenth off the truth changes the
# images otherwise than its tangent says, by some percent of what it imitates. That much looks like an effect.
ALONE = 1e-2
LOOSE = 1e-7  # of the mean curvature: what holds a free field in directions that no pixel sees
ROUNDS, DRAWS = 3, 25  # in which the speckle's own correlation is found, and draws in each


def known_of(problem: FitProblem, roughness: Roughness) -> PartlyKnown:
    """What the problem's scene knows, at its own values, and the fields' roughness, `FREED`; the rows are sparse."""
    known, rows = PartlyKnown.of(problem), np.sqrt(FREED) * roughness.rows(problem.x0.size)
    slopes: Any = csr_array(vstack([csr_array(known.slopes), rows]))
    return PartlyKnown(slopes, np.concatenate([known.residual, -(rows @ problem.x0)]))


class FieldProjection(TangentProjection):
    """What `TangentProjection` is, for a scene with fields. `tangent`, shape (n, q), d ln(mu) of what is fitted and of
    the gains of images that are not calibrated; `known` has rows for the first columns."""

    def __init__(self, tangent: csr_array, root_looks: np.ndarray, known: PartlyKnown) -> None:
        self.known, self.alone = known, ALONE
        self._tangent = csr_array(diags_array(root_looks) @ tangent)
        rows, size = known.slopes, tangent.shape[1]
        self._rows = csr_array(hstack([csr_array(rows), csr_array((rows.shape[0], size - rows.shape[1]))]))
        self._information = csc_array(self._tangent.T @ self._tangent)
        held = self._rows.T @ self._rows + diags_array(np.full(size, REACH**-2))
        self._factors = factor(csc_array(self._information + held))

    @cached_property
    def _free(self) -> Any:
        """The factors without the fields' prior."""
        loose = LOOSE * float(self._information.diagonal().mean())
        return factor(csc_array(self._information + diags_array(np.full(self._information.shape[0], loose))))

    def __call__(self, columns: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
        """What is left of standardised columns, shape (n, k) or (n,); `known` are their rows of what is known."""
        table = columns.reshape(len(columns), -1)
        pulled = self._tangent.T @ table
        if known is not None:
            pulled = pulled + self._rows.T @ known.reshape(len(known), table.shape[1])
        return np.asarray(table - self._tangent @ solved(self._factors, pulled)).reshape(columns.shape)

    def left(self, columns: np.ndarray | csc_array) -> np.ndarray:
        """Share of energy of standardised columns of unit length that no move of the parameters imitates, however far
        and however rough the fields, shape (k,)."""
        found = []
        for some in _batches(columns):
            pulled = np.asarray(self._tangent.T @ some)
            found.append(1.0 - (pulled * solved(self._free, pulled)).sum(axis=0))
        return np.maximum(np.concatenate([*found, np.zeros(0)]), 0.0)

    def compared(self, columns: np.ndarray) -> np.ndarray:
        """What is left of columns: fields hide most of what makes effects unlike."""
        return self(columns)

    def covariances(self, columns: np.ndarray | csc_array, k: int, evidence: Evidence) -> np.ndarray:
        """Covariance, under speckle, of the scores of every trial of `k` projected columns, shape (trials, k, k)."""
        found = []
        for some in _batches(columns, max(1, TRIALS // k) * k):
            moves = solved(self._factors, np.asarray(self._tangent.T @ some))
            left, below = some - self._tangent @ moves, self._rows @ moves
            known = below.reshape(len(below), -1, k)
            found.append(evidence.products(left, k) + np.einsum("bti,btj->tij", known, known))
        return np.concatenate([*found, np.zeros((0, k, k))])


def _batches(columns: np.ndarray | csc_array, size: int = TRIALS) -> Iterator[np.ndarray]:
    """Some columns after the others, as matrices."""
    for first in range(0, columns.shape[1], size):
        some = columns[:, first : first + size]
        yield some if isinstance(some, np.ndarray) else np.asarray(some.toarray())


def projection_of(maker: TemplateMaker, setup: FitSetup, evidence: Evidence) -> TangentProjection:
    """What takes out the tangent space of everything that the maker's model fits."""
    problem = maker.neutral
    if setup.roughness is None:
        return TangentProjection(maker.tangent(), evidence.root_looks, PartlyKnown.of(problem))
    return FieldProjection(sparse_tangent(problem, problem.x0), evidence.root_looks, known_of(problem, setup.roughness))


def sparse_tangent(problem: FitProblem, x: np.ndarray) -> csr_array:
    """d ln(mu) / dx of everything that is fitted, shape (n, q), with one column per unknown gain."""
    count = problem.learned.size
    nodes = vstack([part[:, :count] for part in problem.sparse_jacobian(x)])
    parts: list[Any] = [nodes]
    if x.size > count:
        parts.append(csr_array(np.concatenate(problem.jacobian(x, range(count, x.size)))))
    if not problem.scene.grid.calibrated:
        sizes = [seen.count for seen in problem.observations]
        at = np.repeat(np.arange(len(sizes)), sizes)
        parts.append(csr_array((np.ones(at.size), at, np.arange(at.size + 1)), shape=(at.size, len(sizes))))
    return csr_array(hstack(parts))


def bar_those_alone(candidates: Sequence[Candidate], threshold: float) -> None:
    """Call not testable what has less than its share (`Candidate.least`) left beside the fields, unless an effect that
    resembles it is surely found: which of the two it is, their fits decide."""
    sure = [c for c in candidates if c.testability == "testable" and c.eta >= c.least and c.minus_log_p > threshold]
    for c in candidates:
        if c.testability == "testable" and c.eta < c.least and not any(c.effect in one.resembles for one in sure):
            c.testability, c.statistic, c.minus_log_p, c.p_value = "not_testable", float("nan"), 0.0, 1.0


def left_beside(
    problem: FitProblem, others: np.ndarray, roughness: Roughness
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """What the fitted parameters `others`, fields among them, cannot imitate within a mask of pixels (signature.py)."""
    tangent, known = sparse_tangent(problem, problem.x0), known_of(problem, roughness)
    columns = np.concatenate([others, np.arange(problem.x0.size, tangent.shape[1])])
    slopes: Any = known.slopes[:, others]
    tangent, own = csr_array(tangent[:, columns]), replace(known, slopes=slopes)

    def left_of(mask: np.ndarray, roots: np.ndarray, slope: np.ndarray) -> np.ndarray:
        return FieldProjection(csr_array(tangent[mask]), roots, own)(slope)

    return left_of


def beside_fields(evidence: Evidence, projection: TangentProjection, seed: int) -> Evidence:
    """The evidence beside fields: with the residual that is left of them, and the speckle's own autocovariance.

    What a fit with thousands of nodes leaves is paler and less correlated than speckle. The autocovariance is moved
    until draws that went through the projection have that of the residual, on average. Negative ones stay 0.
    """
    if not isinstance(projection, FieldProjection):
        return evidence
    left = projection(evidence.standardised, projection.known.residual)
    wanted = residual_autocovariance(list(zip(evidence.observations, evidence.split(left), strict=True)))
    own = wanted
    for turn in range(ROUNDS):
        random = np.random.default_rng([seed, turn])
        drawn = projection(Speckle(evidence.observations, own)(random, DRAWS), projection.known.drawn(random, DRAWS))
        parts = [evidence.split(drawn[:, k]) for k in range(DRAWS)]
        pairs = [pair for part in parts for pair in zip(evidence.observations, part, strict=True)]
        own = np.where(own > 0, np.maximum(own + wanted - residual_autocovariance(pairs), 0.0), 0.0)
    return replace(evidence, standardised=left, autocovariance=own)
