"""How many angles of a curve are independent.

A body of width D across the line of sight sends back a field whose phase turns by up to +-k D per radian. So its
bandwidth in angle is 2 D / lambda, and values closer than lambda / 2D say the same. A curve of n rows over a sector of
w radians holds about w 2D / lambda independent ones, and each row counts for that share of one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.directions import Directions
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.mesh import Mesh


def width_m(mesh: Mesh, azimuth_deg: NDArray[np.float64], incidence_deg: NDArray[np.float64]) -> float:
    """Largest width of the body across the line of sight, in the level plane, over the directions [m]."""
    widest = np.ptp(mesh.vertices @ Directions.of(azimuth_deg, incidence_deg).u.T, axis=0)
    return float(widest.max())


def independent_deg(width_m: float, frequency_hz: float) -> float:
    """lambda / 2D [deg], at most a half turn: closer directions say the same."""
    return min(float(np.rad2deg(SPEED_OF_LIGHT / frequency_hz / (2.0 * width_m))), 180.0)


def weights(azimuth_deg: NDArray[np.float64], step_deg: float) -> NDArray[np.float64]:
    """Share of an independent direction that each row stands for, (n,), at most 1. The order of rows does not matter.

    A row stands for half of the way to either neighbour; a row without one, for a whole direction.
    """
    order = np.argsort(azimuth_deg, kind="stable")
    gaps = np.minimum(np.diff(azimuth_deg[order]) / step_deg, 1.0)
    share = np.ones(len(order))
    if len(order) > 1:
        left, right = np.append(gaps[0], gaps), np.append(gaps, gaps[-1])
        share = 0.5 * (left + right)
    found = np.empty(len(order))
    found[order] = share
    return found


def blocks(azimuth_deg: NDArray[np.float64], step_deg: float) -> NDArray[np.int64]:
    """Number of the independent stretch that each row lies in, (n,), from 0."""
    _, index = np.unique(np.floor((azimuth_deg - azimuth_deg.min()) / step_deg).astype(np.int64), return_inverse=True)
    found: NDArray[np.int64] = index.reshape(-1)
    return found
