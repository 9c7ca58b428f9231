"""Per-pixel geometry beside the image: incidence, layover count, shadow, material."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from warpsar.trace.trace import launch_layers

if TYPE_CHECKING:
    from warpsar.trace.hits import Hits
    from warpsar.trace.target import Target
    from warpsar.world.mesh import Mesh


def layers(target: Target, mesh: Mesh, hits: Hits, rays_per_m2: float) -> dict[str, np.ndarray]:
    """Layers of one view, each (rows, cols) float32.

    `incidence_deg`: local incidence on the lit surface, averaged over its area, NaN where nothing is lit;
    `layover`: how many separate stretches of lit surface fall into the pixel, averaged over its azimuth cells;
    `shadow`: 1 where only surfaces hidden from the radar lie; `material`: index into the mesh's materials of the
    one with the largest lit area, -1 where nothing is lit.
    """
    rows, cols = hits.grid.shape
    n = rows * cols
    pixel, weight = hits.pixel.numpy(), hits.weight.numpy().astype(float)
    area = np.bincount(pixel, weight, n)
    lit = area > 0
    theta = np.rad2deg(np.arccos(hits.cos_incidence.numpy().astype(float)))
    with np.errstate(invalid="ignore"):
        incidence = np.bincount(pixel, weight * theta, n) / area
    material = mesh.face_material[hits.face.numpy()]
    best, largest = np.full(n, -1.0), np.zeros(n)
    for index in range(len(mesh.materials)):
        share = np.bincount(pixel[material == index], weight[material == index], n)
        best[share > largest] = index
        largest = np.maximum(largest, share)
    visits, hidden = launch_layers(target, hits.geometry, hits.grid, rays_per_m2)
    found = {
        "incidence_deg": np.where(lit, incidence, np.nan),
        "layover": np.where(lit, np.maximum(visits, 1.0), 0.0),
        "shadow": np.where(hidden & ~lit, 1.0, 0.0),
        "material": best,
    }
    return {name: values.reshape(rows, cols).astype(np.float32) for name, values in found.items()}
