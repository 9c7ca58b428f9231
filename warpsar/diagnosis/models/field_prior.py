"""How rough the learned fields of a scene are, as the images themselves tell (empirical Bayes)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import KEPT_WITHIN, QUICK_FLAT, standing_at
from warpsar.errors import InputError
from warpsar.learning.optimise import levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import FieldPrior, Roughness
from warpsar.learning.sparse_quadratic import whole_jacobian
from warpsar.runtime import once
from warpsar.runtime.threads import side_by_side
from warpsar.scene.scene import Scene
from warpsar.surface.surface import Surface

FIRST_SD = 0.3  # of neighbours' difference, in log coordinates, before anything is known
TURNS = 4  # of expectation and maximisation: from one to the next the precisions then change by little
STEPS = 4  # of a fit in each turn
DRAWS = 24  # of what the data leave open
INFORMED = 1.0  # information from which on the data tell something of a node: its logarithm to 1


def has_fields(scene: Scene) -> bool:
    """Whether the scene learns a field: a parameter with a number for each vertex or texel."""
    return any(block.learn and block.size > 1 for block in Surface.of(scene).blocks)


def with_roughness(setup: FitSetup, scene: Scene, seed: int) -> tuple[FitSetup, np.ndarray]:
    """The setup that expects what the images say of the fields, and the x that the declared model has arrived at.

    Expectation and maximisation by turns: a fit at the present precisions, then those that its fields and their errors
    make likeliest (`Roughness.expected`). They are found once, with the declared model, so that all models are compared
    with the same prior. Raises InputError where the hits of all views are not at hand.
    """
    random = np.random.default_rng(seed)
    problem = setup.problem(scene)
    if not problem.keeps_hits:
        raise InputError(
            f"{scene.name}: found a learned field, and more hits than memory holds; beside fields diagnose needs the "
            f"hits of all train views at once. Allowed are fewer views, smaller images or fewer rays"
        )
    rough, x = Roughness.of(problem, 1.0 / FIRST_SD**2), problem.x0
    for _ in range(TURNS):
        setup = replace(setup, roughness=rough)
        problem = setup.problem(scene)
        state = standing_at(problem, x)
        while not state.arrived and state.since_start < STEPS:
            state = levenberg_marquardt(problem, state, flat=QUICK_FLAT, kept_within=KEPT_WITHIN)
        x = once.decide(state.best_x)
        rough = rough.expected(x, *_errors(problem, x, random))
        rough = replace(rough, precision=once.decide(rough.precision))
    return replace(setup, roughness=rough), x


def _errors(problem: FitProblem, x: np.ndarray, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draws of what the data and the prior leave open, shape (p, draws), and which elements the data tell of.

    With A the tangent in standard deviations and D the prior's rows, H^-1 (A' z + D' y) has the covariance H^-1 for
    normal z and y, since H = A'A + D'D (Papandreou and Yuille, NIPS 2010).
    """
    prior = problem.prior
    assert isinstance(prior, FieldPrior)
    weights = np.concatenate([c.weight for c in problem.curvatures(problem.modelled(x))])
    tangent = diags_array(np.sqrt(weights)) @ whole_jacobian(problem, x)
    information = csc_array(tangent.T @ tangent)
    curvature = csc_array(information + prior.sparse_information(x))
    drawn = tangent.T @ random.standard_normal((tangent.shape[0], DRAWS))
    drawn = drawn + prior.rows.T @ random.standard_normal((prior.rows.shape[0], DRAWS))
    weak = diags_array(np.full(x.size, 1e-6 * curvature.diagonal().mean()))
    return solved(factor(csc_array(curvature + weak)), np.asarray(drawn)), information.diagonal() > INFORMED


def factor(matrix: csc_array) -> SuperLU:
    """The factors of a positive definite sparse matrix."""
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def solved(factors: SuperLU, right: np.ndarray) -> np.ndarray:
    """The solution for every column of `right`, shape (p, k), each in a thread of ours.

    For several columns at once BLAS starts threads of its own, which wait for one another in busy loops
    (`runtime/matmul.py`).
    """
    found = np.empty(right.shape, order="F")

    def one(k: int) -> None:
        found[:, k] = factors.solve(right[:, k])

    side_by_side([partial(one, k) for k in range(right.shape[1])])
    return found
