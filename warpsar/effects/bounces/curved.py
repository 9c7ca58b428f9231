"""Curved surfaces: flat pieces of a mesh that join others nearly smoothly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warpsar.effects.bounces.cells import bodies_of
from warpsar.world.mesh import SMOOTH_DEG
from warpsar.world.smooth import corner_normals

_FLAT = 1e-3
"""Radians between the normals of a face and of its smooth surface, up to which the face is flat: `kinds_of` tells no
less apart."""
_LOST = 0.5
"""Cosine of that angle, below which faces are wound both ways round: their smooth surface is not known."""


@dataclass(frozen=True)
class FlatPieces:
    """Connected planes of faces, by number: `of` each face, (m,); `area` [m2], (pieces,). `joined`, (n, 2): pairs that
    meet at less than `SMOOTH_DEG`, and so are pieces of a curved surface."""

    of: NDArray[np.int64]
    area: NDArray[np.float64]
    joined: NDArray[np.int64]

    def surfaces(self, planes: NDArray[np.int64], least_m2: float) -> NDArray[np.int64]:
        """The `planes` of faces, by number, where pieces of a curved surface that are smaller have one number: it is
        that of no plane."""
        small = self.area < least_m2
        one, other = self.joined[small[self.joined].all(axis=1)].T
        links = coo_array((np.ones(one.size, bool), (one, other)), shape=(self.area.size,) * 2)
        label = connected_components(links, directed=False)[1]
        together = np.bincount(label)[label] > 1
        return np.where(together[self.of], planes.max(initial=0) + 1 + label[self.of], planes)


def pieces_of(vertices: NDArray[np.float64], corners: NDArray[np.integer], planes: NDArray[np.int64]) -> FlatPieces:
    """`vertices` (n, 3) [m], each place once, the faces' `corners` among them, (m, 3), and the number of each one's
    plane."""
    of = bodies_of(np.asarray(corners, np.int64), planes) - 1
    p0, p1, p2 = (vertices[corner] for corner in corners.T)
    area = np.bincount(of, 0.5 * np.linalg.norm(np.cross(p1 - p0, p2 - p0), axis=1)).astype(np.float64)
    ends = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    face, apex = np.tile(np.arange(len(corners)), 3), np.concatenate([corners[:, k] for k in (2, 0, 1)])
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, face, apex = ends[order], face[order], apex[order]
    both = np.flatnonzero((ends[1:] == ends[:-1]).all(axis=1))  # an edge of more than two faces has several pairs
    both = both[of[face[both]] != of[face[both + 1]]]
    along = _unit(vertices[ends[both, 1]] - vertices[ends[both, 0]])
    into = []
    for side in (both, both + 1):
        away = vertices[apex[side]] - vertices[ends[both, 0]]
        into.append(_unit(away - (away * along).sum(axis=1, keepdims=True) * along))
    smooth = both[(into[0] * into[1]).sum(axis=1) < -np.cos(np.deg2rad(SMOOTH_DEG))]
    return FlatPieces(of, area, np.stack([of[face[smooth]], of[face[smooth + 1]]], axis=1))


@dataclass(frozen=True)
class CurvedFaces:
    """Faces on smooth surfaces: `normals` of their corners, (m, 3, 3). `turn` (m,): by how much the normal turns on a
    face [rad/m], at most; 0 on flat ones alone. `bend` (m,): how far the corners' are from the face's own [rad], at
    most. Faces that are wound both ways round are curved by about 0."""

    normals: NDArray[np.float64]
    turn: NDArray[np.float32]
    bend: NDArray[np.float32]


def curved_faces(vertices: NDArray[np.float64], corners: NDArray[np.integer], pieces: FlatPieces) -> CurvedFaces:
    """Of the faces of pieces that join others; arguments as `pieces_of` has them."""
    points = vertices[corners]
    e1, e2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    flat = _unit(np.cross(e1, e2))
    normals = np.repeat(flat[:, None], 3, axis=1)
    turn, bend = (np.zeros(len(corners), np.float32) for _ in range(2))
    joins = np.zeros(pieces.area.size, bool)
    joins[pieces.joined] = True
    some = np.flatnonzero(joins[pieces.of])
    if not some.size:
        return CurvedFaces(normals, turn, bend)
    links = coo_array((np.ones(len(pieces.joined), bool), pieces.joined.T), shape=(pieces.area.size,) * 2)
    surface = connected_components(links, directed=False)[1][pieces.of]
    key = np.asarray(corners, np.int64)[some] * (int(surface.max()) + 1) + surface[some][:, None]
    place = np.unique(key, return_inverse=True)[1].reshape(key.shape)
    normals[some] = corner_normals(points[some], place)
    cosine = (normals * flat[:, None]).sum(axis=2).min(axis=1)
    angle = np.linalg.norm(normals - flat[:, None], axis=2).max(axis=1)
    lost = cosine <= _LOST
    angle[lost] = 0.0
    curved = lost | (angle > _FLAT)
    alone = lost | ~curved
    normals[alone] = flat[alone][:, None]
    g11, g12, g22 = ((a * b).sum(axis=1) for a, b in ((e1, e1), (e1, e2), (e2, e2)))
    det = np.maximum(g11 * g22 - g12**2, np.finfo(float).tiny)[:, None]
    r1, r2 = (g22[:, None] * e1 - g12[:, None] * e2) / det, (g11[:, None] * e2 - g12[:, None] * e1) / det
    change = [normals[:, k] - normals[:, 0] for k in (1, 2)]
    slopes = r1[:, :, None] * change[0][:, None] + r2[:, :, None] * change[1][:, None]
    found = np.linalg.norm(slopes[curved], ord=2, axis=(1, 2))
    turn[curved], bend[curved] = np.maximum(found, np.finfo(np.float32).tiny), angle[curved]
    return CurvedFaces(normals, turn, bend)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    found: NDArray[np.float64] = vectors / np.maximum(length, np.finfo(float).tiny)
    return found
