"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

import numpy as np

from warpsar.learning.problem import FitProblem
from warpsar.render.domains import lit_areas


def outside_domains(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, float]]:
    """Per material: share of its lit area, over all views, outside the domain of small perturbation (`spm`, where
    tau < 1) and of geometric optics (`ka`, where tau > 0); absent where that model is not in use."""
    problem.modelled(x)
    pieces = (piece for view in problem.views for piece in view.pieces())
    area = problem.ranks.sum(lit_areas(problem.stage, pieces))
    return {
        name: {
            model: float(area[m, column + 2] / area[m, column])
            for column, model in ((0, "spm"), (1, "ka"))
            if area[m, column] > 0
        }
        for m, name in enumerate(problem.surface.materials)
    }
