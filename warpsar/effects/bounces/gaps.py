"""Corners that are open: a wall that ends just before the surface with which it makes double bounces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_SQUARE = 0.1  # sine by which two faces may depart from a right angle
_WIDEST, _WIDEST_M = 0.1, 0.2  # of the wall's height over the other surface, and at most: others stand free, as a hull
_NARROWEST = 0.125  # of a wavelength: less changes no field
_CORNERS = 64  # that are looked at, those with the most rays first
_SHARE = 0.05  # of the wall's length from its ends: where rays are sent across the gap
_BESIDE = 1e-3  # of the gap's limit, beside the wall, at which they start


@dataclass(frozen=True)
class Gap:
    """`wall` and `other`: faces, by number, of two bodies that make a corner; `width_m` is free between them."""

    wall: int
    other: int
    width_m: float


def gaps(
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    bodies: NDArray[np.int64],
    pairs: NDArray[np.integer],
    rays: NDArray[np.floating],
    wavelength_m: float,
) -> list[Gap]:
    """Corners of `pairs` of faces (n, 2), over which `rays` (n,) make double bounces, that stand open.

    `vertices` [m], (v, 3), `faces`, (m, 3), and the numbers of their connected planes, `bodies`, (m,). A wall's edge
    that is next to the other surface is looked at: along the wall's plane nothing may lie between them. So a wall on a
    kerb has no gap to the street below it, and one that reaches below the ground has none.
    """
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny)
    sides = np.sort(bodies[pairs], axis=1)
    _, first, number = np.unique(sides, axis=0, return_index=True, return_inverse=True)
    seen = np.bincount(number.reshape(-1), rays)
    found = []
    for at in np.argsort(-seen, kind="stable")[:_CORNERS]:
        one, other = (int(face) for face in pairs[first[at]])
        if abs(normal[one] @ normal[other]) > _SQUARE:
            continue
        for wall, ground in ((one, other), (other, one)):
            width = _between(vertices, faces, bodies, normal, wall, ground, wavelength_m)
            if width is not None:
                found.append(Gap(wall, ground, width))
    return found


def _between(
    vertices: NDArray[np.float64],
    faces: NDArray[np.integer],
    bodies: NDArray[np.int64],
    normal: NDArray[np.float64],
    wall: int,
    other: int,
    wavelength_m: float,
) -> float | None:
    """How far the body of `wall` ends before the one of `other`; None where it does not, or does not nearly reach."""
    corners = vertices[np.unique(faces[bodies == bodies[wall]])]
    height = (corners - vertices[faces[other, 0]]) @ normal[other]
    if abs(height.min()) > abs(height.max()):
        height = -height
        toward = normal[other]
    else:
        toward = -normal[other]
    width = float(height.min())
    if not max(_NARROWEST * wavelength_m, 1e-9) < width < min(_WIDEST * float(height.max()), _WIDEST_M):
        return None
    low = corners[height < width + 1e-3 * float(height.max())]
    along = np.cross(normal[wall], toward)
    ends = low[[np.argmin(low @ along), np.argmax(low @ along)]]
    beside = _BESIDE * width
    for side in (1.0, -1.0):
        for part in (_SHARE, 0.5, 1.0 - _SHARE):
            start = ends[0] + part * (ends[1] - ends[0]) + side * beside * normal[wall] - beside * toward
            way, face = _first(vertices, faces, start, toward)
            if bodies[face] == bodies[other] and abs(way - beside - width) < 0.01 * width:
                return width
    return None


def _first(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], start: NDArray[np.float64], way: NDArray[np.float64]
) -> tuple[float, int]:
    """How far a ray goes until it meets a face, and which one; infinite, and face 0, where it meets none."""
    p0, p1, p2 = (vertices[faces[:, k]] for k in range(3))
    one, other = p1 - p0, p2 - p0
    across = np.cross(way, other)
    size = (one * across).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # faces along the ray
        from_p0 = start - p0
        u = (from_p0 * across).sum(axis=1) / size
        turned = np.cross(from_p0, one)
        v = turned @ way / size
        length = (other * turned).sum(axis=1) / size
        met = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (length > 0.0)
    if not met.any():
        return np.inf, 0
    face = int(np.argmin(np.where(met, length, np.inf)))
    return float(length[face]), face


def sentences(found: Sequence[Gap], names: Sequence[str]) -> list[str]:
    """What a user should be told of gaps; `names` of each face's material. One sentence for each pair of materials."""
    by_names: dict[tuple[str, str], list[float]] = {}
    for gap in found:
        by_names.setdefault((names[gap.wall], names[gap.other]), []).append(gap.width_m)
    return [
        f"multibounce: {len(widths)} {'corner is' if len(widths) == 1 else 'corners are'} open: faces of "
        f"materials.{wall} end {_size(widths)} before those of materials.{other}, with nothing between. Rays go "
        "through; if the mesh should be closed there, move the vertices together"
        for (wall, other), widths in by_names.items()
    ]


def _size(widths: Sequence[float]) -> str:
    low, high = 100.0 * min(widths), 100.0 * max(widths)
    return f"{low:.3g} cm" if high < 1.01 * low else f"{low:.3g} to {high:.3g} cm"
