"""Levenberg-Marquardt steps for fields: the curvature is sparse, and conjugate gradients solve for the step.

A texel meets few pixels, so J'WJ has few elements, and the prior couples neighbours alone. The preconditioner is the
curvature within each node (its channels together), and that of all other parameters together, inverted exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, hstack, vstack
from scipy.sparse.linalg import splu

from warpsar.learning.prior import Prior
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import FieldPrior

LARGEST_STEP = 1.0  # of a log coordinate in one step: a factor e
SHARES = (1.0, 0.5, 0.2, 0.05)  # of a step, of which the best is taken
SOLVED = 1e-3  # of the gradient, that conjugate gradients leave; the promised gain is then known to 1e-4
MOST_TURNS = 500  # of conjugate gradients
FAINT = 1e-9  # of the median curvature: what no pixel depends on stays where it is


@dataclass(frozen=True)
class SparseStep:
    """A damped step, and the gain in log-likelihood that it promises."""

    step: np.ndarray
    promised: float


@dataclass(frozen=True)
class SparseQuadratic:
    """The loss about x as a quadratic: `gradient`, shape (p,), exact by the adjoint, and `hessian`, shape (p, p),
    sparse. `free` are the elements that may move. `nodes` numbers the node of each element, 0 where it has none."""

    x: np.ndarray
    loss: float
    gradient: np.ndarray
    hessian: csr_array
    free: np.ndarray
    nodes: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    _steps: dict[float, SparseStep] = field(default_factory=dict)

    @classmethod
    def about(cls, problem: FitProblem, x: np.ndarray, moving: np.ndarray | None = None) -> SparseQuadratic:
        """The loss, its gradient and its curvature (Fisher scoring) at x; `moving` leaves out elements."""
        _, gradient = problem.gradient(x)
        modelled = problem.standing()
        loss = problem.value(modelled) + problem.penalty(x)
        weights = [c.weight for c in problem.curvatures(modelled)]
        tangent = whole_jacobian(problem, x, moving)
        hessian = curvature(tangent, weights, problem.prior, x, calibrated=problem.scene.grid.calibrated)
        return cls.of(x, loss, gradient, hessian, node_numbers(problem), problem.bounds, moving)

    @classmethod
    def of(
        cls,
        x: np.ndarray,
        loss: float,
        gradient: np.ndarray,
        hessian: csr_array,
        nodes: np.ndarray,
        bounds: tuple[np.ndarray, np.ndarray],
        moving: np.ndarray | None = None,
    ) -> SparseQuadratic:
        """With the elements free that no bound holds, that something depends on, and that are `moving`."""
        low, high = bounds
        diagonal = hessian.diagonal()
        free = ~((x <= low) & (gradient > 0) | (x >= high) & (gradient < 0)) & (diagonal > FAINT * np.median(diagonal))
        if moving is not None:
            free &= moving
        return cls(x, loss, gradient, hessian, free, nodes, bounds)

    def step(self, damping: float) -> SparseStep:
        """The step at a damping, which is relative to the diagonal of the curvature."""
        if damping in self._steps:
            return self._steps[damping]
        free = np.flatnonzero(self.free)
        step = np.zeros(self.x.size)
        if free.size:
            inner = self._inner
            damped = csr_array(inner + diags_array(damping * inner.diagonal()))
            step[free] = solved(damped, -self.gradient[free], self.nodes[free])
        promised = -float(self.gradient @ step + 0.5 * step @ (self.hessian @ step))
        return self._steps.setdefault(damping, SparseStep(step, promised))

    @cached_property
    def _inner(self) -> csr_array:
        """The curvature among the free elements."""
        free = np.flatnonzero(self.free)
        return csr_array(self.hessian[free][:, free])

    def bent(self, problem: FitProblem, planned: SparseStep) -> np.ndarray:
        """The best place along the step; no element goes further than `LARGEST_STEP`. Images cost next to nothing
        beside another solution at a larger damping."""
        step = np.clip(planned.step, -LARGEST_STEP, LARGEST_STEP)
        places = [np.clip(self.x + share * step, *self.bounds) for share in SHARES]
        losses = [problem.value(problem.modelled(at)) + problem.penalty(at) for at in places]
        return np.asarray(places[int(np.argmin(losses))])


def curvature(
    tangent: csr_array, weights: Sequence[np.ndarray], prior: Prior, x: np.ndarray, *, calibrated: bool
) -> csr_array:
    """The curvature (Fisher scoring) at x, shape (p, p), of observations whose pixels have these `weights`, and of a
    prior of fields; `tangent` is d ln(mu) / dx of all their pixels, one after the other, shape (n, p). A gain of its
    own is at its best in every image that is not `calibrated`."""
    assert isinstance(prior, FieldPrior)
    scaled = diags_array(np.sqrt(np.concatenate(weights))) @ tangent
    hessian = csr_array(scaled.T @ scaled)
    if not calibrated:
        ends = np.cumsum([0, *(w.size for w in weights)])
        means = np.stack(
            [w @ tangent[a:b] / np.sqrt(w.sum()) for w, a, b in zip(weights, ends, ends[1:], strict=False)]
        )
        hessian = csr_array(hessian - csr_array(means).T @ csr_array(means))
    return csr_array(hessian + prior.sparse_information(x))


def solved(matrix: csr_array, right: np.ndarray, nodes: np.ndarray, accuracy: float = SOLVED) -> np.ndarray:
    """The solution of a positive definite system by preconditioned conjugate gradients, which leave `accuracy` of
    `right`."""
    entries = coo_array(matrix)
    own = nodes[entries.row] == nodes[entries.col]
    blocks = coo_array((entries.data[own], (entries.row[own], entries.col[own])), matrix.shape).tocsc()
    inverse = splu(blocks, permc_spec="NATURAL", diag_pivot_thresh=0.0)
    found, left = np.zeros(right.size), right.copy()
    way = near = inverse.solve(left)
    energy, wanted = _times(left, near), accuracy**2 * _times(right, right)
    for _ in range(MOST_TURNS):
        if _times(left, left) <= wanted:
            break
        bent = matrix @ way
        share = energy / _times(way, bent)
        found, left = found + share * way, left - share * bent
        near = inverse.solve(left)
        before, energy = energy, _times(left, near)
        way = near + energy / before * way
    return found


def _times(one: np.ndarray, other: np.ndarray) -> float:
    """Their inner product. BLAS would take threads for so short a sum, and wait for them longer than it takes."""
    return float((one * other).sum())


def node_numbers(problem: FitProblem) -> np.ndarray:
    """The number of the node that each element of x belongs to, from 1 on: channels of one texel or vertex share it.
    0 for uniform parameters and those of effects."""
    found, first = [], dict[tuple[Any, ...], int]()
    count = 1
    for block in (block for block in problem.surface.blocks if block.learn):
        if block.size == 1:
            found.append(np.zeros(1, int))
            continue
        key = block.material, block.layout, block.shape, block.first_vertex
        if key not in first:
            first[key], count = count, count + block.size
        found.append(first[key] + np.arange(block.size))
    return np.concatenate([*found, np.zeros(problem.x0.size - problem.learned.size, int)])


def whole_jacobian(problem: FitProblem, x: np.ndarray, moving: np.ndarray | None = None) -> csr_array:
    """d ln(mu) / dx of all observations' pixels, one after the other, shape (n, p), with gains projected out of the
    effects' columns alone. Columns that are not `moving` may be empty. Behind an effect of the image, nodes have their
    derivative before it, scaled as the whole image is: near enough for a step, and a thousand times faster."""
    count = problem.learned.size
    effects = np.arange(count, x.size)
    wanted = effects if moving is None else effects[moving[count:]]
    sizes = [seen.count for seen in problem.observations]
    if moving is None or moving[:count].any():
        surface = vstack([part[:, :count] for part in problem.sparse_jacobian(x, near=True)])
    else:
        surface = csr_array((sum(sizes), count))
    rest = np.zeros((sum(sizes), effects.size))
    if wanted.size:
        rest[:, wanted - count] = np.concatenate(problem.jacobian(x, wanted.tolist()))
    return csr_array(hstack([surface, csr_array(rest)]))
