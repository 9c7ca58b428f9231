"""From where an aperture is seen: by the geometry of the mesh, for any body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from warpsar.coherent.directions import Directions
from warpsar.world.mesh import Mesh

OPEN_SHARE = 1e-3
"""Of a plane of the hull: less than this is rounding, not an aperture."""
NEAR = 1e-4
"""Of the body's size: faces closer than this to a plane of its hull lie in it."""
SEEN = 0.5
"""Share of its area that an aperture shows to the radar, at least, in the sector `aperture`."""
NAMES = ("all", "aperture", "away")


def apertures(mesh: Mesh) -> NDArray[np.float64]:
    """Outward normals of the planes of the convex hull that the faces leave open in part, shape (n, 3).

    A body without a volume has none.
    """
    try:
        hull = ConvexHull(mesh.vertices)
    except QhullError:
        return np.zeros((0, 3))
    size = float(np.ptp(mesh.vertices, axis=0).max())
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    sides = mesh.vertices[hull.simplices]
    hull_area = 0.5 * np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1)
    planes = np.round(hull.equations / np.array([1.0, 1.0, 1.0, size]), 6)
    planes, of = np.unique(planes, axis=0, return_inverse=True)
    found = []
    for plane, whole in zip(planes, np.bincount(of.ravel(), hull_area), strict=True):
        near = np.abs(mesh.vertices @ plane[:3] + plane[3] * size) < NEAR * size
        some = np.flatnonzero(near[mesh.faces[:, 0]])  # a smooth body has a plane for each face
        there = area[some[near[mesh.faces[some]].all(axis=1)]].sum()
        if whole - there > OPEN_SHARE * max(whole, area.sum() / 100):
            found.append(plane[:3])
    return np.array(found).reshape(-1, 3)


def sectors(
    normals: NDArray[np.float64], azimuth_deg: NDArray[np.float64], incidence_deg: NDArray[np.float64]
) -> dict[str, NDArray[np.bool_]]:
    """Which directions lie in each of `NAMES`, (n,) each.

    `aperture`: some aperture shows half of its area or more. `away`: none shows any. Between the two an aperture is
    seen aslant, and only `all` has it. Without apertures, `all` is `away`.
    """
    s = Directions.of(azimuth_deg, incidence_deg).s
    shown = (s @ normals.T).max(axis=1) if len(normals) else np.full(len(s), -1.0)
    return {"all": np.ones(len(s), bool), "aperture": shown >= SEEN - 1e-9, "away": shown <= 1e-9}
