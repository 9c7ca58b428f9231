"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

import numpy as np

from warpsar.learning.problem import FitProblem
from warpsar.render.domains import lit_areas


def outside_domains(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, float]]:
    """By material: the share of its lit area, over all views, that lies outside the domain of each model.

    `spm`: small perturbation, where tau < 1. `ka`: geometric optics, where tau > 0. A model that is not in use is left
    out.
    """
    problem.modelled(x)
    pieces = (piece for view in problem.views for piece in view.render.pieces())
    area = problem.ranks.sum(lit_areas(problem.stage, pieces))  # lit and outside, for SPM and KA
    return {
        name: {
            model: float(area[m, column + 2] / area[m, column])
            for column, model in ((0, "spm"), (1, "ka"))
            if area[m, column] > 0
        }
        for m, name in enumerate(problem.surface.materials)
    }
