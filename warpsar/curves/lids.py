"""Where a body that is declared closed may have an opening: flat parts between sharp edges, as a lid over a duct is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.shape import shape_of
from warpsar.curves.sectors import SEEN
from warpsar.world.mesh import Mesh

EVEN = 0.97
"""Length of the mean normal of a part, by area, that counts as flat: its faces turn by some 15 degrees at most."""
ALIKE = 0.01
"""Relative difference of area up to which two parts are one another's mirror image."""
TURNED = 0.85
"""Cosine between the normals of two such parts, at least: openings on both sides of a body face the same way."""


def lids(mesh: Mesh, looks: NDArray[np.float64], least_m2: float) -> list[NDArray[np.int64]]:
    """The faces of each flat part that looks toward the radar, largest first; mirror images that face alike are one.

    `looks` are unit vectors to the radar, (n, 3): from one of them a part shows half of its area or more, as the sector
    `aperture` has it. `least_m2` is the least area. A part is what no edge of more than `coherent.shape.SMOOTH_DEG`
    cuts. A smooth body has none.
    """
    surface = shape_of(mesh.vertices, mesh.faces, mesh.face_material).surface
    corners = mesh.vertices[mesh.faces]
    across = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.stack([np.bincount(surface, across[:, i]) for i in range(3)], axis=1)
    area = np.bincount(surface, np.linalg.norm(across, axis=1))
    normal = total / area[:, None]
    even = np.linalg.norm(normal, axis=1) > EVEN
    even &= ((looks @ normal.T).max(axis=0) >= SEEN) & (area < area.sum() / 2.0)
    left = [int(i) for i in np.argsort(-area) if even[i]]
    found = []
    while left:
        first = left[0]
        same = [i for i in left if area[first] - area[i] <= ALIKE * area[first] and normal[i] @ normal[first] > TURNED]
        if area[same].sum() >= least_m2:
            found.append(np.flatnonzero(np.isin(surface, same)))
        left = [i for i in left if i not in same]
    return found
