"""What is said of learned fields: how they moved when effects were added, and what is known of the rest beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csc_array, csr_array, diags_array

from warpsar.diagnosis.models.field_prior import factor
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.turn.field_projection import sparse_tangent
from warpsar.errors import InputError
from warpsar.learning.identify import Identified, of_information, score_products
from warpsar.learning.problem import FitProblem
from warpsar.learning.roughness import FieldPrior
from warpsar.scene.scene import Scene
from warpsar.speckle.residual import residual_autocovariance
from warpsar.world.mesh import DEFAULT_MATERIAL


@dataclass(frozen=True)
class MovedField:
    """A learned field before and after the effects were added: medians over its nodes (SI), and the root of the mean
    square of its nodes' moves in the learned coordinate."""

    material: str
    key: str
    layout: str
    nodes: int
    before: float
    after: float
    move: float

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        return {
            "layout": self.layout,
            "nodes": self.nodes,
            "median_before": self.before,
            "median_after": self.after,
            "rms_move_log": self.move,
        }


def moved_fields(first: Fitted, last: Fitted) -> list[MovedField]:
    """Every learned field; none in a scene of uniform materials."""
    moves, at = [], 0
    for block in (block for block in first.problem.surface.blocks if block.learn):
        a, b = (fitted.x[at : at + block.size] for fitted in (first, last))
        if block.size > 1:
            one, two = (float(np.median(block.kind.from_coordinate(x))) for x in (a, b))
            rms = float(np.sqrt(np.mean((b - a) ** 2)))
            moves.append(MovedField(block.material, block.kind.key, block.layout, block.size, one, two, rms))
        at += block.size
    return moves


def fields_content(first: Fitted, last: Fitted) -> dict[str, Any]:
    """For diagnosis.json: `fields`, where there are any."""
    moves = moved_fields(first, last)
    return {"fields": {f"{one.material}.{one.key}": one.content() for one in moves}} if moves else {}


def fields_rows(content: Mapping[str, Any]) -> list[list[str]]:
    """A row of the report's table for each learned field."""
    return [
        [
            f"{label} ({one['layout']}, {one['nodes']:,} nodes)",
            f"{one['median_before']:.4g}",
            f"{one['median_after']:.4g}",
            f"{one['rms_move_log']:.2g}",
        ]
        for label, one in content.get("fields", {}).items()
    ]


FIELDS_HEAD = ["learned field", "median before", "median after", "root mean square of the nodes' moves (ln)"]


def identify_beside(problem: FitProblem, x: np.ndarray) -> Identified:
    """What the data tell of the uniform parameters and of effects', with the fields free within their prior.

    The fields are projected out of the other parameters' columns; see `identify` for the rest.
    """
    prior = problem.prior
    assert isinstance(prior, FieldPrior)
    curvatures = problem.curvatures(problem.modelled(x))
    tangent = sparse_tangent(problem, x)
    fields = np.concatenate([np.full(n, n > 1) for n in problem.moved_together])
    rest = np.flatnonzero(~fields)
    if not rest.size:
        nothing = np.zeros((0, 0))
        return Identified([], nothing, nothing, nothing, np.zeros(0), nothing)
    gains = np.arange(x.size, tangent.shape[1])
    weights = np.concatenate([c.weight for c in curvatures])
    scaled = csr_array(diags_array(np.sqrt(weights)) @ tangent)
    nuisance, own = scaled[:, np.concatenate([np.flatnonzero(fields), gains])], scaled[:, rest].toarray()
    rows = csr_array(prior.rows[:, np.flatnonzero(fields)])
    none = csr_array((gains.size, gains.size))
    known = csc_array(block_diag([rows.T @ rows, none])) if gains.size else csc_array(rows.T @ rows)
    curvature = csc_array(nuisance.T @ nuisance + known)
    weak = diags_array(np.full(curvature.shape[0], 1e-9 * float(curvature.diagonal().mean())))
    moves = factor(csc_array(curvature + weak)).solve(np.asarray(nuisance.T @ own))
    left = own - nuisance @ moves
    slopes = prior.slopes(x)[:, rest]
    held = slopes.T @ slopes + moves.T @ (known @ moves)
    parts = np.split(left, np.cumsum([seen.count for seen in problem.observations])[:-1])
    residuals = [c.residual * np.sqrt(seen.looks) for c, seen in zip(curvatures, problem.observations, strict=True)]
    autocovariance = residual_autocovariance(list(zip(problem.observations, residuals, strict=True)))
    products = sum(
        score_products(part, autocovariance, seen) for part, seen in zip(parts, problem.observations, strict=True)
    )
    labels = problem.labels
    means = problem.zero_sum_means[:, rest]
    return of_information([labels[k] for k in rest], left.T @ left + held, products + held, means)


def refuse_unsavable(scene: Scene) -> None:
    """Refuse, before hours of work, a mesh whose learned vertex scalars no file format holds. Raises InputError."""
    learned = [name for name, one in scene.materials.items() if one.layout == "vertex" and one.learn]
    if learned and (
        scene.mesh.materials != (DEFAULT_MATERIAL,) or scene.mesh.uv is not None or scene.assembly is not None
    ):
        raise InputError(
            f"{scene.name}: materials.{learned[0]}: found a learned field of layout vertex, in a mesh with several "
            f"materials, UV or objects; the result could not be saved. Allowed are one mesh with one material, "
            f'"{DEFAULT_MATERIAL}", and no UV (PLY), or the layout "texture"'
        )
