"""How much of the lit surface lies outside the domain of its model (equations 9, 12, 19, corrected)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from warpsar.fit import FitProblem


def spm_valid(kh: np.ndarray, kl: np.ndarray) -> np.ndarray:
    """Small perturbation (19): kh < 0.3 and sqrt(2) h / l < 0.3."""
    return (kh < 0.3) & (np.sqrt(2.0) * kh / kl < 0.3)


def ka_valid(kh: np.ndarray, kl: np.ndarray, cos_incidence: np.ndarray) -> np.ndarray:
    """Geometric optics (9, 12): kh cos(theta) > sqrt(10) / 2, kl > 6 and l^2 > 2.76 h lambda."""
    return (kh * cos_incidence > np.sqrt(10.0) / 2.0) & (kl > 6.0) & (kl**2 > 2.76 * 2.0 * np.pi * kh)


def outside_domains(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, float]]:
    """Per material: share of its lit area, over all views, outside the domain of small perturbation (`spm`, where
    tau < 1) and of geometric optics (`ka`, where tau > 0); absent where that model is not in use."""
    problem.modelled(x)
    names = problem.surface.materials
    area = np.zeros((len(names), 4))  # lit and outside, for SPM and KA
    for piece in (piece for view in problem.views for piece in view.pieces()):
        hits = piece.shaded
        zeta = piece.zeta.numpy().astype(float)
        material = problem.scene.mesh.face_material[hits.face.numpy()]
        weight = hits.weight.numpy().astype(float)
        k = hits.geometry.wavenumber
        kh, kl, tau = k * np.exp(zeta[:, 1]), k * np.exp(zeta[:, 2]), zeta[:, 3]
        spm, ka = tau < 40.0, tau > -40.0
        outside = np.stack([~spm_valid(kh, kl), ~ka_valid(kh, kl, hits.cos_incidence.numpy())], 1)
        for column, used in ((0, spm), (1, ka)):
            area[:, column] += np.bincount(material, weight * used, len(names))
            area[:, column + 2] += np.bincount(material, weight * used * outside[:, column], len(names))
    area = problem.ranks.sum(area)
    return {
        name: {
            model: float(area[m, column + 2] / area[m, column])
            for column, model in ((0, "spm"), (1, "ka"))
            if area[m, column] > 0
        }
        for m, name in enumerate(names)
    }
