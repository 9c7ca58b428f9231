"""Strong scatterers in the scene: an octahedron at each place, with size and colour by its RCS."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from warpsar.scene.scene import Scene
from warpsar.viewer.surface import Drawn

NAME = "scatterers"
SMALLEST, LARGEST = 0.006, 0.03
"""From the middle of an octahedron to its corners, over the scene's size: of a weak scatterer, and of the strongest."""
WEAK_DB = 30.0
"""Under the strongest one: what is weaker, and the mesh, have the darkest colour."""
CORNERS = np.concatenate([np.eye(3), -np.eye(3)])
TRIANGLES = np.array([(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)])


def with_points(
    surface: Drawn, scene: Scene, place_m: NDArray[np.float64], levels_dbsm: Mapping[str, NDArray[np.float64]]
) -> Drawn:
    """`surface` with points at `place_m` (n, 3) [m], in the coordinates of the mesh, and by polarization their levels,
    (n,)."""
    if not len(place_m):
        return surface
    strongest = max(float(levels.max()) for levels in levels_dbsm.values())
    dark = np.full(len(surface.corners), strongest - WEAK_DB)
    share = np.clip(np.max(list(levels_dbsm.values()), axis=0) - strongest + WEAK_DB, 0.0, None) / WEAK_DB
    size = (SMALLEST + (LARGEST - SMALLEST) * share) * float(np.ptp(scene.mesh.vertices, axis=0).max())
    middle = place_m - np.asarray(scene.reference_point_m)
    corners = (middle[:, None] + size[:, None, None] * CORNERS).reshape(-1, 3)
    first = len(surface.corners) + len(CORNERS) * np.arange(len(place_m))
    triangles = (first[:, None, None] + TRIANGLES).reshape(-1, 3)
    levels = {
        f"{NAME} {name} [dBsm]": np.concatenate([dark, np.repeat(np.maximum(each, dark[0]), len(CORNERS))])
        for name, each in levels_dbsm.items()
    }
    none = {key: np.concatenate([values, np.full(len(corners), np.nan)]) for key, values in surface.parameters.items()}
    return replace(
        surface,
        corners=np.concatenate([surface.corners, corners]).astype(np.float32),
        triangles=np.concatenate([surface.triangles, triangles]).astype(np.uint32),
        material=np.concatenate([surface.material, np.full(len(corners), len(surface.materials))]),
        materials=(*surface.materials, NAME),
        owner=np.concatenate([surface.owner, np.full(len(corners), len(surface.owners))]),
        owners=(*surface.owners, NAME),
        parameters=none,
        levels_db=surface.levels_db | levels,
    )
