"""The shape of a mesh: smooth surfaces with their normals, flat regions with borders, and wedges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warpsar.coherent.joints import Joints, joints, welded
from warpsar.world.mesh import SMOOTH_DEG
from warpsar.world.smooth import corner_normals

FLAT = 1e-5
"""A surface is flat whose vertices lie in a plane to this share of the body's size."""
_SAMPLES = 256


@dataclass(frozen=True)
class Wedges:
    """Edges that diffract: places [m], unit vectors into both faces, normals on the outer side; shape (n, 3) each."""

    start: NDArray[np.float64]
    end: NDArray[np.float64]
    first: NDArray[np.float64]
    second: NDArray[np.float64]
    normal_first: NDArray[np.float64]
    normal_second: NDArray[np.float64]
    outer: NDArray[np.float64]
    """Outer angle over pi, (n,); 2 at the border of a sheet."""
    share: NDArray[np.float64]
    material: NDArray[np.int64]
    """Of the two faces, (n, 2)."""
    face: NDArray[np.int64]
    """The two faces, (n, 2); twice the same at the border of a sheet."""
    vertex: NDArray[np.int64]
    """As in `Joints`."""
    part: NDArray[np.float64]
    middle: NDArray[np.float64]
    """Of the two faces' surfaces, by area, (n, 2, 3) [m]."""

    def reach(self, which: NDArray[np.int64], places: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far both surfaces go from places (n, 3) on the edges `which`, (n, 2) [m]: twice the way to the middle."""
        into = np.stack([self.first[which], self.second[which]], axis=1)
        way = np.einsum("ijk,ijk->ij", self.middle[which] - places[:, None], into)
        return 2.0 * np.maximum(way, 0.0)


@dataclass(frozen=True)
class Regions:
    """Flat surfaces: shape (r,) or (r, 3) each; edges of their borders in `middle` and `along`, (e, 3)."""

    normal: NDArray[np.float64]
    centre: NDArray[np.float64]
    area: NDArray[np.float64]
    reach: NDArray[np.float64]
    material: NDArray[np.int64]
    first: NDArray[np.int64]
    end: NDArray[np.int64]
    middle: NDArray[np.float64]
    along: NDArray[np.float64]
    sample: NDArray[np.float64]
    """Points of the regions [m], (p, 3): where all of them are seen, the region is lit as a whole."""
    sample_region: NDArray[np.int64]
    """(p,), ascending."""


@dataclass(frozen=True)
class MeshShape:
    """What the engine knows of a mesh."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float64]
    """Of the corners of each face, (m, 3, 3): those of the smooth surface."""
    curved: NDArray[np.int32]
    """(m,): whether the face belongs to a curved surface."""
    surface: NDArray[np.int32]
    """(m,): the surface of a face, flat or curved."""
    fan: NDArray[np.int64]
    """(m, 3): corners with one number share a normal; -1 on flat surfaces."""
    smooth: NDArray[np.int64]
    """Faces that are one surface across an edge, (j, 2), and the edge's vertices as the first one has them, (j, 2)."""
    smooth_vertex: NDArray[np.int64]
    region: NDArray[np.int32]
    """(m,): the flat region of a face, or -1."""
    regions: Regions
    wedges: Wedges
    size: float
    """Largest extent [m]."""


def shape_of(vertices: NDArray[np.float64], faces: NDArray[np.int32], face_material: NDArray[np.int32]) -> MeshShape:
    """Work out the shape of a mesh: (n, 3) [m], (m, 3), (m,)."""
    size = float(np.ptp(vertices, axis=0).max())
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = 0.5 * np.linalg.norm(normal, axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    found = joints(vertices, faces)
    into_first = _into(found, found.face, a, b, c)
    into_second = _into(found, np.where(found.other < 0, found.face, found.other), a, b, c)
    between = np.arccos(np.clip(np.einsum("ij,ij->i", into_first, into_second), -1.0, 1.0))
    joined = found.other >= 0
    smooth = joined & (np.pi - between < np.deg2rad(SMOOTH_DEG))
    one = smooth & (face_material[found.face] == face_material[found.other])
    pairs = found.face[one], found.other[one]
    links = coo_array((np.ones(len(pairs[0]), np.int8), pairs), shape=(len(faces), len(faces)))
    surface = connected_components(links, directed=False)[1]
    flat = _flat(surface, vertices, faces, normal, area, size)
    curved = ~flat[surface]
    names = np.cumsum(flat) - 1
    region = np.where(curved, -1, names[surface]).astype(np.int32)
    edges = np.flatnonzero(~smooth)
    middles = _middles(surface, area, (a + b + c) / 3.0)
    wedges = _wedges(found, edges, into_first, into_second, between, face_material, middles)
    normals, fan = _smooth_normals(vertices, faces, surface, normal, curved)
    return MeshShape(
        vertices,
        faces,
        normals,
        curved.astype(np.int32),
        surface.astype(np.int32),
        fan,
        np.stack([found.face[one], found.other[one]], axis=1),
        found.vertex[one],
        region,
        _regions(region, int(flat.sum()), vertices, faces, normal, area, face_material),
        wedges,
        size,
    )


def faces_alone(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> MeshShape:
    """A mesh whose faces belong to no surface: enough for rough faces, and quick for a million of them.

    Without normals, flat regions and wedges: rays see it, and tubes do not.
    """
    places, numbers, pairs = np.empty((0, 3)), np.empty(0), np.empty((0, 2), np.int64)
    none = np.empty(0, np.int64)
    return MeshShape(
        vertices,
        faces,
        np.empty((0, 3, 3)),
        np.empty(0, np.int32),
        np.arange(len(faces), dtype=np.int32),
        np.empty((0, 3), np.int64),
        pairs,
        pairs,
        np.full(len(faces), -1, np.int32),
        Regions(places, places, numbers, numbers, none, none, none, places, places, places, none),
        Wedges(*(places,) * 6, numbers, numbers, pairs, pairs, pairs, np.empty((0, 2)), np.empty((0, 2, 3))),
        float(np.ptp(vertices, axis=0).max()),
    )


def _into(
    found: Joints,
    face: NDArray[np.int64],
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Unit vectors in the faces, across the edges and away from them, (n, 3)."""
    along = found.end - found.start
    along /= np.linalg.norm(along, axis=1)[:, None]
    inward = (a[face] + b[face] + c[face]) / 3.0 - found.start
    n = np.cross(b[face] - a[face], c[face] - a[face])
    n /= np.linalg.norm(n, axis=1)[:, None]
    across = np.cross(n, along)
    across /= np.linalg.norm(across, axis=1)[:, None]
    side: NDArray[np.float64] = np.sign(np.einsum("ij,ij->i", across, inward))[:, None] * across
    return side


def _flat(
    surface: NDArray[np.int32],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    normal: NDArray[np.float64],
    area: NDArray[np.float64],
    size: float,
) -> NDArray[np.bool_]:
    """Which surfaces are planes, by number."""
    count = int(surface.max()) + 1
    # Faces of one surface may be wound either way round: turn each as the surface's first one.
    first = np.full(count, len(surface))
    np.minimum.at(first, surface, np.arange(len(surface)))
    sign = np.where(np.einsum("ij,ij->i", normal, normal[first[surface]]) < 0.0, -1.0, 1.0)
    mean = np.stack([np.bincount(surface, sign * area * normal[:, i], count) for i in range(3)], axis=1)
    mean = mean / np.linalg.norm(mean, axis=1)[:, None]
    origin = vertices[faces[first, 0]]
    offset = np.abs(np.einsum("ijk,ik->ij", vertices[faces] - origin[surface][:, None], mean[surface])).max(axis=1)
    worst = np.zeros(count)
    np.maximum.at(worst, surface, offset)
    flat: NDArray[np.bool_] = worst < FLAT * size
    return flat


def _smooth_normals(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    surface: NDArray[np.int32],
    normal: NDArray[np.float64],
    curved: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Normals of the corners, (m, 3, 3), and which corners share one, (m, 3)."""
    normals = np.repeat(normal[:, None], 3, axis=1)
    fan = np.full(faces.shape, -1, np.int64)
    some = np.flatnonzero(curved)
    if not len(some):
        return normals, fan
    corners = welded(vertices, faces)[some]
    points = vertices[faces[some]]
    key = corners.astype(np.int64) * (int(surface.max()) + 1) + surface[some][:, None]
    place = np.unique(key, return_inverse=True)[1].reshape(key.shape)
    normals[some] = corner_normals(points, place)
    fan[some] = place
    return normals, fan


def _wedges(
    found: Joints,
    edges: NDArray[np.int64],
    into_first: NDArray[np.float64],
    into_second: NDArray[np.float64],
    between: NDArray[np.float64],
    face_material: NDArray[np.int32],
    middles: NDArray[np.float64],
) -> Wedges:
    first, second, angle = into_first[edges], into_second[edges], between[edges]
    along = found.end[edges] - found.start[edges]
    along /= np.linalg.norm(along, axis=1)[:, None]
    sheet = angle < 1e-6
    n1 = np.cross(along, first)
    away = np.einsum("ij,ij->i", n1, second) > 0.0
    n1 = np.where(away[:, None], -n1, n1)
    n2 = np.cross(along, second)
    away = np.einsum("ij,ij->i", n2, first) > 0.0
    n2 = np.where(away[:, None], -n2, n2)
    n2 = np.where(sheet[:, None], -n1, n2)
    other = np.where(found.other[edges] < 0, found.face[edges], found.other[edges])
    face = np.stack([found.face[edges], other], axis=1)
    return Wedges(
        found.start[edges],
        found.end[edges],
        first,
        second,
        n1,
        n2,
        2.0 - angle / np.pi,
        found.share[edges],
        face_material[face].astype(np.int64),
        face,
        found.vertex[edges],
        found.part[edges],
        middles[face],
    )


def _middles(surface: NDArray[np.int32], area: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of each face the middle of its surface by area, (m, 3); `places` are the middles of the faces."""
    total = np.bincount(surface, area)
    mean = np.stack([np.bincount(surface, area * places[:, i]) for i in range(3)], axis=1)
    return np.asarray((mean / total[:, None])[surface])


def _regions(
    region: NDArray[np.int32],
    count: int,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    normal: NDArray[np.float64],
    area: NDArray[np.float64],
    face_material: NDArray[np.int32],
) -> Regions:
    some = np.flatnonzero(region >= 0)
    order = some[np.argsort(region[some], kind="stable")]
    of = region[order]
    start = np.searchsorted(of, np.arange(count))
    reference = normal[order[start]] if count else np.empty((0, 3))
    sign = np.where(np.einsum("ij,ij->i", normal[order], reference[of]) < 0.0, -1, 1)
    corners = np.where(sign[:, None] < 0, faces[order][:, ::-1], faces[order])
    weight = area[order]
    total = np.bincount(of, weight, count).astype(np.float64)  # of nothing it gives integers
    points = vertices[corners]
    turned = (sign * weight)[:, None] * normal[order]
    mean = np.stack([np.bincount(of, turned[:, i], count) for i in range(3)], axis=1).astype(np.float64)
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    middle = weight[:, None] * points.mean(axis=1)
    centre = np.stack([np.bincount(of, middle[:, i], count) for i in range(3)], axis=1) / total[:, None]
    reach = np.zeros(count)
    np.maximum.at(reach, of, np.linalg.norm(points - centre[of][:, None], axis=2).max(axis=1))
    # An edge between two faces of a region cancels, and is left out where both share its vertices.
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]).astype(np.int64)
    owner = np.tile(of, 3).astype(np.int64)
    low, high = ends.min(axis=1), ends.max(axis=1)
    key = (owner * len(vertices) + low) * len(vertices) + high if len(vertices) < 2e6 else None
    if key is not None and count * float(len(vertices)) ** 2 < 9e18:
        inverse, times = np.unique(key, return_inverse=True, return_counts=True)[1:]
        border = times[inverse] == 1
        ends, owner = ends[border], owner[border]
    by = np.argsort(owner, kind="stable")
    ends, owner = ends[by], owner[by]
    begin, finish = vertices[ends[:, 0]], vertices[ends[:, 1]]
    inward = np.cross(mean[owner], finish - begin)
    inward *= (reach[owner] / np.linalg.norm(inward, axis=1))[:, None]
    sample, sample_region = _samples(points, of, weight, total, begin, finish, owner, 1e-3 * inward)
    return Regions(
        mean,
        centre,
        total,
        2.0 * reach,
        face_material[order[start]].astype(np.int64) if count else np.empty(0, np.int64),
        np.searchsorted(owner, np.arange(count)),
        np.searchsorted(owner, np.arange(count), side="right"),
        0.5 * (begin + finish),
        finish - begin,
        sample,
        sample_region,
    )


def _samples(
    points: NDArray[np.float64],
    of: NDArray[np.int32],
    weight: NDArray[np.float64],
    total: NDArray[np.float64],
    begin: NDArray[np.float64],
    finish: NDArray[np.float64],
    owner: NDArray[np.int64],
    inward: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Points all over each region, and along its border, a little inside."""
    cuts = np.ceil(np.sqrt(_SAMPLES * weight / total[of])).astype(int).clip(1, 16)
    found, names = [], []
    for n in np.unique(cuts):
        chosen = np.flatnonzero(cuts == n)
        i, j = (axis.ravel() for axis in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        inside = i + j < n
        one = (np.stack([i[inside], j[inside]]) + 1.0 / 3.0) / n
        p = points[chosen]
        at = p[:, :1] + one[0][:, None] * (p[:, 1:2] - p[:, :1]) + one[1][:, None] * (p[:, 2:] - p[:, :1])
        found.append(at.reshape(-1, 3))
        names.append(np.repeat(of[chosen], at.shape[1]))
    if not found:
        return np.empty((0, 3)), np.empty(0, np.int64)
    sample, name = np.concatenate(found), np.concatenate(names).astype(np.int64)
    by = np.argsort(name, kind="stable")
    sample, name = sample[by], name[by]
    # Thousands of small faces need no sample each.
    many = np.bincount(name, minlength=len(total))
    rank = np.arange(len(name)) - (np.cumsum(many) - many)[name]
    kept = rank % np.maximum(many // (2 * _SAMPLES), 1)[name] == 0
    edge = np.concatenate([begin + f * (finish - begin) + inward for f in (0.02, 0.5, 0.98)])
    edge_name = np.tile(owner, 3)
    sample, name = np.concatenate([sample[kept], edge]), np.concatenate([name[kept], edge_name])
    by = np.argsort(name, kind="stable")
    return sample[by], name[by]


def beyond(shape: MeshShape) -> NDArray[np.int64]:
    """The face across the edge opposite to each corner, (m, 3), where both are one surface; -1 elsewhere."""
    found = np.full(shape.faces.shape, -1, np.int64)
    for one, other in ((0, 1), (1, 0)):
        face, ends = shape.smooth[:, one], shape.smooth_vertex
        on = (shape.faces[face][:, :, None] == ends[:, None]).any(axis=2)
        whole = on.sum(axis=1) == 2  # a mesh that is not welded states the edge for either face by itself
        found[face[whole], np.argmin(on[whole], axis=1)] = shape.smooth[whole, other]
    return found
