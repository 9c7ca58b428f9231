"""Where an object may stand: points on the ground with nothing of the scene above them."""

from __future__ import annotations

import numpy as np

from warpsar.world.mesh import Mesh

SAME_M = 1e-3  # surfaces closer than this are one


def free_ground(mesh: Mesh, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """The height of the ground [m], shape (len(north), len(east)), at every point of a regular grid of places.

    NaN where there is no surface, or where another one lies above it: a body of the scene stands there.
    """
    lowest = np.full((north.size, east.size), np.inf)
    highest = np.full((north.size, east.size), -np.inf)
    corners = mesh.vertices[mesh.faces]
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    first_col, last_col = np.searchsorted(east, low[:, 0]), np.searchsorted(east, high[:, 0], side="right")
    first_row, last_row = np.searchsorted(north, low[:, 1]), np.searchsorted(north, high[:, 1], side="right")
    for k in np.flatnonzero((last_col > first_col) & (last_row > first_row)):
        there = (slice(first_row[k], last_row[k]), slice(first_col[k], last_col[k]))
        height = _height(corners[k], east[there[1]], north[there[0]])
        np.fmin(lowest[there], height, out=lowest[there])
        np.fmax(highest[there], height, out=highest[there])
    alone = np.isfinite(lowest) & (highest < lowest + SAME_M)
    return np.where(alone, lowest, np.nan)


def _height(corners: np.ndarray, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """The height of a triangle, (3, 3) [m], over each point of a grid; NaN beside it, and for an upright one."""
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    if abs(normal[2]) < 1e-9 * np.linalg.norm(normal):
        return np.full((north.size, east.size), np.nan)
    x, y = np.meshgrid(east, north)
    turn = [(q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1]) for p, q in ((a, b), (b, c), (c, a))]
    sign = np.sign(normal[2])
    slack = 1e-9 * abs(normal[2])
    inside = np.all([sign * t >= -slack for t in turn], axis=0)
    height = a[2] - ((x - a[0]) * normal[0] + (y - a[1]) * normal[1]) / normal[2]
    return np.where(inside, height, np.nan)
