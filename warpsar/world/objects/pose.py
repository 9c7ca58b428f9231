"""From an object's own frame to the world: roll, pitch, heading, scale and position."""

from __future__ import annotations

import numpy as np

from warpsar.world.objects.table import Object


def rotation(heading_deg: float, pitch_deg: float, roll_deg: float) -> np.ndarray:
    """The matrix, (3, 3), that turns an object whose front is north (+Y) and whose up is +Z.

    Roll about the front (right side down), then pitch about the right side (nose up), then heading about the vertical
    (clockwise from above).
    """
    h, p, r = np.deg2rad([heading_deg, pitch_deg, roll_deg])
    roll = np.array([[np.cos(r), 0.0, np.sin(r)], [0.0, 1.0, 0.0], [-np.sin(r), 0.0, np.cos(r)]])
    pitch = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(p), -np.sin(p)], [0.0, np.sin(p), np.cos(p)]])
    heading = np.array([[np.cos(h), np.sin(h), 0.0], [-np.sin(h), np.cos(h), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(heading @ pitch @ roll)


def placed(vertices: np.ndarray, table: Object, origin: np.ndarray | None = None) -> np.ndarray:
    """Vertices [m], (n, 3), of the object's frame where the table puts them in the world.

    With `origin`, (3,), the vertices are the world's, and the object turns about that point: a group.
    """
    about = np.zeros(3) if origin is None else origin
    along, across, up = table.scales
    turn = rotation(table.heading_deg, table.pitch_deg, table.roll_deg)
    scaled = (vertices - about) * (across, along, up)
    return np.asarray(scaled @ turn.T + table.position_m + about)


def foot(vertices: np.ndarray) -> np.ndarray:
    """The middle of the foot, (3,): the middle of the extent east and north, and the lowest point."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, low[2]])


def axis(name: str) -> np.ndarray:
    """The unit vector of a direction such as "-Y"."""
    found = np.zeros(3)
    found["XYZ".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return found


def in_object_frame(vertices: np.ndarray, table: Object, metres: float) -> np.ndarray:
    """A file's vertices, (n, 3), in the object's frame [m]: front to +Y, up to +Z, origin in the middle of its foot."""
    front, up = axis(table.front), axis(table.up)
    turned = vertices @ np.stack([np.cross(front, up), front, up], axis=1) * metres
    return np.asarray(turned - foot(turned))
