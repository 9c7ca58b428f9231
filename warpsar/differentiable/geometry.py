"""How images change as the mesh's vertices move, silhouettes and shadows included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import warp as wp

from warpsar.effects.registry import declared
from warpsar.errors import InputError
from warpsar.render.render import ViewRender
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.surface.stage import Stage
from warpsar.world.tables import Polarization

STEP_M = 2e-3
"""How far the vertex moves that moves most: the error of a derivative is then under 1e-3 (docs/learn-method.md)."""


def exact_images(
    scene: Scene, device: wp.Device, views: Sequence[str] | None = None
) -> dict[str, dict[str, np.ndarray]]:
    """beta0 without sampling noise, by view name and polarization: float32, shape (rows, cols)."""
    stage = Stage.of(scene, device)
    rays = ExactRays(stage, seed=scene.sampling.seed)
    polarizations: tuple[Polarization, ...] = scene.radar.polarizations
    found = {}
    for view in scene.views:
        if views is None or view.name in views:
            effects = declared(scene, view)
            hits = rays.trace(scene, view, effects)
            found[view.name] = ViewRender(stage, view, hits, scene.grid.shape, polarizations, effects).forward()
    return found


def image_slopes(
    scene: Scene, displacement: np.ndarray, device: wp.Device, views: Sequence[str] | None = None
) -> dict[str, dict[str, np.ndarray]]:
    """d beta0 / dt as the mesh's vertices move by t * `displacement`, by view name and polarization: (rows, cols).

    `displacement` has shape (vertices, 3). The slopes are central differences of exact images. Raises InputError for
    another shape, and where nothing moves.
    """
    vertices = scene.mesh.vertices
    if np.shape(displacement) != vertices.shape:
        raise InputError(f"displacement: found shape {np.shape(displacement)}; must be {vertices.shape}")
    largest = float(np.abs(displacement).max())
    if not 0.0 < largest < np.inf:
        raise InputError(f"displacement: found {largest:g} at most; must be finite, and above 0 somewhere")
    step = STEP_M / largest
    up, down = (
        exact_images(replace(scene, mesh=replace(scene.mesh, vertices=vertices + t * displacement)), device, views)
        for t in (step, -step)
    )
    return {
        name: {pol: (image.astype(float) - down[name][pol]) / (2.0 * step) for pol, image in images.items()}
        for name, images in up.items()
    }
