"""STL."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.world.meshes.part import DEFAULT_MATERIAL, Part
from warpsar.world.meshes.through_trimesh import load, parts, refusing_broken


def read(path: Path) -> list[Part]:
    """The one part of the file; corners at one place become one vertex."""
    scene = load(path, path)
    with refusing_broken(path):
        for geometry in scene.geometry.values():
            if np.isfinite(geometry.vertices).all():
                geometry.merge_vertices()
    return parts(path, scene, lambda _key, _geometry: DEFAULT_MATERIAL)
