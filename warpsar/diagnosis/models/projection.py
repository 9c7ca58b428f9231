"""Where a place of the world lies in the image of a view."""

from __future__ import annotations

import numpy as np

from warpsar.effects.registry import shift_m
from warpsar.scene.scene import Scene
from warpsar.world.tables import View
from warpsar.world.world import geometry_of


def shift_px(scene: Scene, view: View) -> np.ndarray:
    """Rows and columns by which the scene's effects move the image of a view, shape (2,)."""
    return shift_m(scene, view) / np.array(scene.grid.spacing_m)


def pixel_of(scene: Scene, view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of points, as floats: pixel i covers i to i + 1. `points` [m] are about the reference point,
    shape (n, 3)."""
    places = geometry_of(scene, view).range_and_azimuth_m(points)
    shift = shift_px(scene, view)
    row, col = (
        at / step + n / 2 + moved
        for at, n, step, moved in zip(places, scene.grid.shape, scene.grid.spacing_m, shift, strict=True)
    )
    return row, col
