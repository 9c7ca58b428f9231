"""Scenes with a collection, in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import warpsar
from warpsar.world.collection import Collection
from warpsar.world.frame import SPEED_OF_LIGHT

FREQUENCY = 9.6e9
WAVELENGTH = SPEED_OF_LIGHT / FREQUENCY
ROUGH = {"eps_r": 6.0, "rms_height_m": 0.0012, "correlation_length_m": 0.01}
VIEW = {"azimuth_deg": 30.0, "incidence_deg": 40.0}
SPOT = {"mode": "spotlight", "resolution_m": (0.5, 0.5), "slant_range_m": 10e3, "speed_m_s": 100.0}


def field(width: float, depth: float, height: Any = None) -> warpsar.Mesh:
    """A rectangle of ground about the origin; `height(x, y)` lifts its corners."""
    x, y = np.array([-1, 1, 1, -1]) * width / 2, np.array([-1, -1, 1, 1]) * depth / 2
    z = np.zeros(4) if height is None else height(x, y)
    return warpsar.Mesh.of(np.stack([x, y, z], axis=1), np.array([[0, 1, 2], [0, 2, 3]]))


def square_trihedral(a: float) -> warpsar.Mesh:
    """A corner of three squares at the origin that opens to +X+Y+Z."""
    squares = [
        [[0, 0, 0], [a, 0, 0], [a, a, 0], [0, a, 0]],
        [[0, 0, 0], [a, 0, 0], [a, 0, a], [0, 0, a]],
        [[0, 0, 0], [0, a, 0], [0, a, a], [0, 0, a]],
    ]
    faces = np.concatenate([[[i, i + 1, i + 2], [i, i + 2, i + 3]] for i in (0, 4, 8)])
    return warpsar.Mesh.of(np.concatenate(squares).astype(float), faces)


def scene(
    mesh: warpsar.Mesh,
    *,
    collection: dict[str, Any] | None = None,
    material: dict[str, Any] | None = None,
    view: dict[str, Any] | None = None,
    shape: tuple[int, int] = (64, 64),
    spacing: ArrayLike = (0.25, 0.25),
    radar: dict[str, Any] | None = None,
    **more: Any,
) -> warpsar.Scene:
    rows, columns = np.asarray(spacing, float).tolist()
    return warpsar.Scene(
        mesh=mesh,
        radar=warpsar.Radar(**{"frequency_hz": FREQUENCY, "polarizations": ("HH",), **(radar or {})}),
        grid=warpsar.Grid(shape=shape, spacing_m=(rows, columns)),
        materials={name: warpsar.Material(**(material or ROUGH)) for name in mesh.materials},
        views=[warpsar.View(name="one", **(view or VIEW))],
        collection=Collection(**(SPOT | (collection or {}))),
        **more,
    )
