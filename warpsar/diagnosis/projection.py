"""Where a place of the world lies in the image of a view."""

from __future__ import annotations

import numpy as np

from warpsar.effects.registry import get, value_in
from warpsar.scene.scene import Scene
from warpsar.world.tables import View
from warpsar.world.world import geometry_of


def shift_px(scene: Scene, view: View) -> np.ndarray:
    """By how many rows and columns the model moves the image of a view."""
    table = scene.effects.get("registration")
    if table is None:
        return np.zeros(2)
    axes = geometry_of(scene, view)
    range_m, azimuth_m, *world = (value_in(view, p, table) for p in get("registration").parameters)
    moved = np.array([range_m + axes.d @ np.array(world), azimuth_m + axes.u @ np.array(world)])
    return moved / np.array(scene.grid.spacing_m)


def pixel_of(scene: Scene, view: View, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column, as floats with pixel i at i to i + 1, of points about the reference point, shape (n, 3)."""
    axes = geometry_of(scene, view)
    along = points @ axes.d
    if axes.slant_range_m is not None:
        along = np.hypot(along + axes.slant_range_m, points @ axes.v) - axes.slant_range_m
    shift = shift_px(scene, view)
    places = (along, points @ axes.u)
    row, col = (
        at / step + n / 2 + moved
        for at, n, step, moved in zip(places, scene.grid.shape, scene.grid.spacing_m, shift, strict=True)
    )
    return row, col
