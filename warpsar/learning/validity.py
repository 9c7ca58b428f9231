"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpsar.kernels import domains as kernels
from warpsar.learning.problem import FitProblem


def outside_domains(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, float]]:
    """By material: the share of its lit area, over all views, that lies outside the domain of each model.

    `spm`: small perturbation, where tau < 1. `ka`: geometric optics, where tau > 0. A model that is not in use is left
    out.
    """
    problem.modelled(x)
    names = problem.surface.materials
    cells = wp.zeros((int(kernels.PARTIALS), len(names), 4), dtype=wp.float64, device=problem.device)
    for piece in (piece for view in problem.views for piece in view.render.pieces()):
        hits = piece.shaded
        wp.launch(
            kernels.area_kernel,
            hits.count,
            inputs=[
                hits.geometry.wavenumber,
                hits.face,
                problem.stage.face_material,
                hits.weight,
                hits.cos_incidence,
                piece.zeta,
            ],
            outputs=[cells],
            device=problem.device,
        )
    area = problem.ranks.sum(cells.numpy().sum(axis=0))  # lit and outside, for SPM and KA
    return {
        name: {
            model: float(area[m, column + 2] / area[m, column])
            for column, model in ((0, "spm"), (1, "ka"))
            if area[m, column] > 0
        }
        for m, name in enumerate(names)
    }
