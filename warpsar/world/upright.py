"""Y up and Z up: how one becomes the other, and whether a mesh seems to have Y up.

What things stand on, and what ground is, tells which axis points up.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

_LAYER = 0.03  # of an extent: what lies in it at an end is that end
_STANDS = 0.4  # of the footprint: a house, a plate and four wheels stand on more
_LIES = 0.35  # of the footprint: a car's bumper or a tree's twigs have less at an end
_ALIKE = 0.05  # by which the shares of two ends may differ, and are still one shape seen from both sides
_ROOFED = 0.85  # how much more of the footprint the foot of a house has than its ridge
_WALL = 0.5  # of the footprint that a wall's faces take at least
_SAME = 0.02  # by which the two walls of a house may differ
_FLAT = 0.985  # cosine to an axis of faces that lie across it: 10 degrees
_SHEET = (0.8, 1.3)  # ground: at least so much of its area faces up, and it covers its footprint at most so often
_THIN = (1e-3, 0.5)  # the relief of ground over its smaller side

_SEEMS = "it seems to have Y up (it {how} across Y), and the world has Z up"


def z_up(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points of a frame with Y up, shape (n, 3), in one with Z up, also right-handed: (x, -z, y)."""
    x, y, z = np.asarray(vertices, np.float64).T
    return np.stack([x, -z, y], axis=1)


def y_up(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> str | None:
    """How a mesh shows that Y points up in its file, in words; None where nothing says so, or Z points up as well.

    Things stand on wide ends. The share of the footprint that the convex hull of an end takes (its lowest 3 %) is
    therefore large at the foot, and tells foot from top. Ground covers its footprint once. A box shows nothing, nor
    does a single plate. Vertices are (n, 3), faces (m, 3).
    """
    low, extent = vertices[faces].min(axis=(0, 1)), np.ptp(vertices[faces], axis=(0, 1))
    if not (extent > 0).all():
        return None
    points = (vertices - low) / extent
    cross = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]) / 2.0
    covered = np.abs(cross).sum(axis=0)  # of the footprint across each axis, how often
    true = cross * np.prod(extent) / extent
    area = np.linalg.norm(true, axis=1)
    if _is_ground(covered, true, area, extent):
        return _SEEMS.format(how="lies as ground does")
    used = np.zeros(len(points), bool)
    used[faces] = True
    y, z = (_ends(points[used], axis) for axis in (1, 2))
    if y[0] < _STANDS:
        return None
    on_a_plate = z[0] <= _LIES and abs(y[0] - y[1]) >= _ALIKE
    if on_a_plate or (y[0] - y[1] >= _ROOFED and _between_walls(points, faces, cross, true, area)):
        return _SEEMS.format(how="stands")
    return None


def _is_ground(
    covered: NDArray[np.float64], true: NDArray[np.float64], area: NDArray[np.float64], extent: NDArray[np.float64]
) -> bool:
    """Whether it is one sheet across Y with some relief."""
    relief = extent[1] / min(extent[0], extent[2])
    up = np.abs(true[:, 1]).sum() / area.sum()
    return bool(up >= _SHEET[0] and 0.5 < covered[1] <= _SHEET[1] and _THIN[0] <= relief <= _THIN[1])


def _ends(points: NDArray[np.float64], axis: int) -> tuple[float, float]:
    """The share of the footprint across an axis that the lower and the upper end take; `points` fill the unit cube."""
    others = [k for k in range(3) if k != axis]
    along = points[:, axis]
    return _hull(points[along <= _LAYER][:, others]), _hull(points[along >= 1.0 - _LAYER][:, others])


def _hull(points: NDArray[np.float64]) -> float:
    if len(points) < 3:
        return 0.0
    try:
        return float(ConvexHull(points).volume)  # in two dimensions, its area
    except QhullError:  # all on a line
        return 0.0


def _between_walls(
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    cross: NDArray[np.float64],
    true: NDArray[np.float64],
    area: NDArray[np.float64],
) -> bool:
    """Whether both ends along Z are walls, and one as large as the other: the gables of a house that lies on its
    side."""
    flat = np.abs(true[:, 2]) >= _FLAT * area
    along = points[faces, 2]
    share = [
        float(np.abs(cross[flat & inside, 2]).sum())
        for inside in ((along <= _LAYER).all(axis=1), (along >= 1.0 - _LAYER).all(axis=1))
    ]
    return min(share) >= _WALL and abs(share[0] - share[1]) <= _SAME
