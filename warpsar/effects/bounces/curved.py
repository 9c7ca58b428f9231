"""Curved surfaces: flat pieces of a mesh that join others nearly smoothly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warpsar.effects.bounces.cells import bodies_of
from warpsar.world.mesh import SMOOTH_DEG


@dataclass(frozen=True)
class FlatPieces:
    """Connected planes of faces, by number: `of` each face, (m,); `area` [m2], (pieces,). `joined`, (n, 2): pairs that
    meet at less than `SMOOTH_DEG`, and so are pieces of a curved surface."""

    of: NDArray[np.int64]
    area: NDArray[np.float64]
    joined: NDArray[np.int64]

    def mirrors(self) -> NDArray[np.float32]:
        """Of each face, the area of its piece [m2]; infinite where it is none of a curved surface."""
        curved = np.zeros(self.area.size, bool)
        curved[self.joined] = True
        return np.where(curved, self.area, np.inf)[self.of].astype(np.float32)

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


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    found: NDArray[np.float64] = vectors / np.maximum(length, np.finfo(float).tiny)
    return found
