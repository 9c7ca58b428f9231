"""Normals of smooth surfaces, of which a mesh has points and flat faces."""

import numpy as np
from numpy.typing import NDArray


def corner_normals(points: NDArray[np.float64], place: NDArray[np.int64]) -> NDArray[np.float64]:
    """Unit normals of the corners of faces, (m, 3, 3), whose `points` [m] are of shape (m, 3, 3). Corners with one
    number, `place` (m, 3), share theirs.

    Weights of Max (J. Graphics Tools 4(2), 1999): exact on a sphere.
    """
    total = np.zeros((int(place.max()) + 1, 3))
    for i in range(3):
        e1 = points[:, (i + 1) % 3] - points[:, i]
        e2 = points[:, (i + 2) % 3] - points[:, i]
        weight = np.cross(e1, e2) / ((e1**2).sum(1) * (e2**2).sum(1))[:, None]
        for axis in range(3):
            total[:, axis] += np.bincount(place[:, i], weight[:, axis], len(total))
    total /= np.maximum(np.linalg.norm(total, axis=1), np.finfo(float).tiny)[:, None]
    normals: NDArray[np.float64] = total[place]
    return normals
