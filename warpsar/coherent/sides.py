"""Which side of an open surface the radar sees. The faces of a half-space have an inside: no wave comes from there."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions, radar_records
from warpsar.coherent.joints import Joints, joints
from warpsar.coherent.records import upload
from warpsar.errors import InputError
from warpsar.kernels.coherent import tubes
from warpsar.world.world import World

SHARE = 0.01
"""Of a surface's projected area: what is seen of its other side beyond that is no rough ground's border at grazing."""
_PAIRS = 2**22


def refuse_inside(scene: World, body: CoherentBody, directions: Directions) -> None:
    """Raise InputError where a mesh is open and the radar would see the inside of a half-space.

    That is so where the directions together show both sides of one surface, whichever way round its faces are wound.
    """
    mesh = scene.mesh
    materials = [scene.materials[name] for name in mesh.materials]
    filled = np.array([m.solid for m in materials])[mesh.face_material]
    if not filled.any():
        return
    vertices = mesh.vertices - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0
    seams = joints(vertices, mesh.faces)
    corners = vertices[mesh.faces]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    surface, side = _sides(seams, filled, corners.mean(axis=1), area)
    opened = np.unique(surface[seams.face[(seams.other < 0) & filled[seams.face]]])
    for each in opened:
        some = np.flatnonzero((surface == each) & filled)
        if not side[some].all():
            continue  # a surface with one side alone, like a Moebius strip, has no inside
        turned = side[some, None] * area[some]
        at = _seen_on_both(body, directions, scene.radar.slant_range_m, corners[some].mean(axis=1), turned)
        if at is not None:
            name = mesh.materials[mesh.face_material[some[0]]]
            edges = int(((seams.other < 0) & np.isin(seams.face, some)).sum())
            raise InputError(
                f"{scene.name}: materials.{name}.thickness_m: found none, on a surface open at {edges} edges and "
                f"seen from both sides (s = {np.round(directions.s[at], 3).tolist()}); must be a number for a slab, or "
                "the mesh must be closed around a half-space"
            )


def _sides(
    seams: Joints, filled: NDArray[np.bool_], middle: NDArray[np.float64], area: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The surface that each face belongs to, and +1 or -1: its normal points to the surface's first or second side.

    0 where the surface has one side alone. Each face stands for two nodes, its two sides; across an edge those on one
    side are joined.
    """
    n = len(filled)
    some = seams.other >= 0
    first, second = seams.face[some], seams.other[some]
    both = filled[first] & filled[second]
    first, second = first[both], second[both]
    start, along = seams.start[some][both], (seams.end - seams.start)[some][both]

    def turn(face: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.einsum("ij,ij->i", along, np.cross(middle[face] - start, area[face]))

    same = turn(first) * turn(second) < 0.0
    nodes = np.concatenate([first, first + n])
    others = np.concatenate([np.where(same, second, second + n), np.where(same, second + n, second)])
    links = coo_array((np.ones(len(nodes), np.int8), (nodes, others)), shape=(2 * n, 2 * n))
    label = connected_components(links, directed=False)[1]
    up, down = label[:n], label[n:]
    return np.minimum(up, down).astype(np.int64), np.sign(down - up).astype(np.int64)


def _seen_on_both(
    body: CoherentBody,
    directions: Directions,
    distance_m: float | None,
    middle: NDArray[np.float64],
    area: NDArray[np.float64],
) -> int | None:
    """A direction that shows more than SHARE of the side that the others show less of; None where there is none."""
    cast = directions.s @ area.T  # (directions, faces)
    if np.where(cast > 0.0, cast, 0.0).sum() < np.where(cast < 0.0, -cast, 0.0).sum():
        cast, area = -cast, -area
    some = np.flatnonzero((cast < 0.0).any(axis=1))
    towards, cast = Directions(directions.s[some], directions.u[some], directions.v[some]), cast[some]
    step = max(1, _PAIRS // len(middle))
    points = upload(middle, wp.vec3d, body.device)
    normals = upload(area / np.linalg.norm(area, axis=1)[:, None], wp.vec3d, body.device)
    for i in range(0, len(some), step):
        part = slice(i, i + step)
        radars = upload(radar_records(towards[part], body.origin, distance_m), tubes.TubeRadar, body.device)
        seen = wp.empty((radars.shape[0], len(middle)), dtype=wp.uint8, device=body.device)
        inputs = [body.rays, radars, points, normals, 1]
        wp.launch(tubes.free_kernel, seen.shape, inputs=inputs, outputs=[seen], device=body.device)
        inside = np.where((cast[part] < 0.0) & (seen.numpy() != 0), -cast[part], 0.0).sum(axis=1)
        found = np.flatnonzero(inside > SHARE * np.abs(cast[part]).sum(axis=1))
        if len(found):
            return int(some[i + found[0]])
    return None
