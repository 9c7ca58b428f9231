"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import warp as wp

from warpsar.kernels import domains as kernels
from warpsar.render.rendered import Piece
from warpsar.surface.stage import Stage


def lit_areas(stage: Stage, renders: Iterable[Piece]) -> np.ndarray:
    """Per material, shape (materials, 4): lit area where small perturbation is in use (tau < 1) and where geometric
    optics is (tau > 0), and of each what lies outside its domain. Of renders that have run, in any one unit."""
    device = stage.target.device
    cells = wp.zeros((int(kernels.PARTIALS), len(stage.surface.materials), 4), dtype=wp.float64, device=device)
    for render in renders:
        hits = render.shaded
        wp.launch(
            kernels.area_kernel,
            hits.count,
            inputs=[
                hits.geometry.wavenumber,
                hits.face,
                stage.face_material,
                hits.weight,
                hits.cos_incidence,
                render.zeta,
            ],
            outputs=[cells],
            device=device,
        )
    return np.asarray(cells.numpy().sum(axis=0))
