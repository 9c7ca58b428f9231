"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

import numpy as np

from warpsar.learning.problem import FitProblem
from warpsar.render.domains import lit_areas, model_areas


def outside_domains(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, float]]:
    """By material: the share of its lit area, over all views, that lies outside the domain of each model.

    `spm`: small perturbation, where tau < 1. `ka`: geometric optics, where tau > 0. A model that is not in use is left
    out. A material with another model than ka_spm has that one's share, under its name.
    """
    problem.modelled(x)
    pieces = [piece for view in problem.views for piece in view.render.pieces()]
    area = problem.over_views(lit_areas(problem.stage, pieces))  # lit and outside, for SPM and KA
    surface = problem.surface
    default = surface.by_default
    other = np.zeros((default.size, 2)) if default.all() else problem.over_views(model_areas(problem.stage, pieces))
    found = {}
    for m, name in enumerate(surface.materials):
        if default[m]:
            columns = [(0, "spm"), (1, "ka")]
            found[name] = {k: float(area[m, c + 2] / area[m, c]) for c, k in columns if area[m, c] > 0}
        else:
            lit, outside = other[m]
            found[name] = {surface.model[m]: float(outside / lit)} if lit > 0 else {}
    return found
