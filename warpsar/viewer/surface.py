"""The surface as a browser draws it: triangles whose corners know material, object and parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.evaluation.meshview import parameters_at
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.surface.stage import Stage

FINEST = 200_000
"""Triangles that a textured mesh may be cut into: a page of some 20 MB."""


@dataclass(frozen=True)
class Drawn:
    """Triangles to draw, with what is known at their n corners.

    `corners` [m] are about the reference point, shape (n, 3), float32; `triangles` index them, shape (m, 3), uint32.
    `material` and `owner` are indices into `materials` and `owners`, shape (n,), and alike on the three corners of a
    triangle. `parameters` hold surface parameters by key, SI, shape (n,), NaN where a corner has none.
    `levels_db` hold what the triangles send back, by the words that the page shows, shape (n,); all of them share one
    scale.
    """

    corners: NDArray[np.float32]
    triangles: NDArray[np.uint32]
    material: NDArray[np.integer]
    materials: tuple[str, ...]
    owner: NDArray[np.integer]
    owners: tuple[str, ...]
    parameters: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    levels_db: dict[str, NDArray[np.float64]] = field(default_factory=dict)


def drawn(scene: Scene) -> Drawn:
    """The mesh of the scene. Corners are shared only where material and object are the same. Faces with a texture are
    cut into triangles of about a texel, as far as `FINEST` allows."""
    stage = stage_of(scene, "cpu")
    mesh, owner = scene.mesh, owners(scene)
    face, weights, triangles = _cut(_parts_of_edges(scene, stage))
    values = {} if stage is None else _parameters(stage, face, weights)
    corners = np.einsum("nk,nkc->nc", weights, mesh.vertices[mesh.faces[face]]) - np.asarray(scene.reference_point_m)
    kept = np.concatenate([corners.astype(np.float32), mesh.face_material[face][:, None], owner[face][:, None]], axis=1)
    # Corners that agree in all that is drawn are one.
    everything = np.concatenate([kept, *(one[:, None] for one in values.values())], axis=1)
    _, first, place = np.unique(everything, axis=0, return_index=True, return_inverse=True)
    return Drawn(
        corners=kept[first, :3].astype(np.float32),
        triangles=place.reshape(-1)[triangles].astype(np.uint32),
        material=mesh.face_material[face][first],
        materials=mesh.materials,
        owner=owner[face][first],
        owners=("the scene's mesh", *(one.label for one in scene.objects)),
        parameters={key: one[first] for key, one in values.items()},
    )


def stage_of(scene: Scene, device: str | None) -> Stage | None:
    """None for smooth or conducting surfaces, which have a phase, and neither parameters nor images of power."""
    try:
        return Stage.of(scene, devices.resolve_device(device))
    except InputError:
        return None


def _parameters(stage: Stage, face: NDArray[np.intp], weights: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    device = stage.target.device
    at: wp.array = wp.array(face.astype(np.int32), dtype=int, device=device)
    return parameters_at(stage, at, wp.array(weights[:, 1:].astype(np.float32), dtype=wp.vec2, device=device))


def owners(scene: Scene) -> NDArray[np.intp]:
    """0 for a face of the scene's own mesh, and i + 1 for a face of object i, shape (faces,)."""
    if scene.assembly is None:
        return np.zeros(len(scene.mesh.faces), np.intp)
    base = scene.assembly.base
    own = np.zeros(0 if base is None else len(base.faces), np.intp)
    placed = [own]
    for index, one in enumerate(scene.objects):
        if one.group is None:
            placed.append(np.full(len(scene.assembly.placed(one).faces), index + 1))
        elif base is not None:
            own[np.isin(base.faces, scene.assembly.moved[one.label]).all(axis=1)] = index + 1
    return np.concatenate(placed)


def _parts_of_edges(scene: Scene, stage: Stage | None) -> NDArray[np.intp]:
    """Into how many parts the edges of each face are cut, shape (faces,): one where it has no texture."""
    mesh = scene.mesh
    texels = np.zeros(len(mesh.faces))
    for block in () if stage is None else stage.surface.blocks:
        if block.layout != "texture" or mesh.uv is None:
            continue
        mine = mesh.face_material == mesh.materials.index(block.material)
        corners = mesh.uv[mesh.faces[mine]] * np.array(block.shape[::-1])
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        texels[mine] = np.maximum(texels[mine], edges)
    parts = np.maximum(np.ceil(np.nan_to_num(texels)), 1.0)
    while (parts**2).sum() > max(FINEST, len(parts)):
        parts = np.maximum(np.floor(0.8 * parts), 1.0)
    return parts.astype(np.intp)


def _cut(parts: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.intp]]:
    """Every face on a lattice of `parts` along its edges: the face of each corner, its barycentrics (three), and the
    triangles as indices of corners."""
    of_corner, weights, triangles, count = [], [], [], 0
    for n in np.unique(parts).tolist():
        mine = np.flatnonzero(parts == n)
        places = [(i, j) for i in range(n + 1) for j in range(n + 1 - i)]
        number = {place: k for k, place in enumerate(places)}
        up = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i in range(n) for j in range(n - i)]
        down = [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i in range(n) for j in range(n - i - 1)]
        i, j = np.array(places).T
        of_corner.append(np.repeat(mine, len(places)))
        weights.append(np.tile(np.stack([n - i - j, i, j], axis=1) / n, (len(mine), 1)))
        starts = count + len(places) * np.arange(len(mine))
        triangles.append((np.array(up + down)[None] + starts[:, None, None]).reshape(-1, 3))
        count += len(places) * len(mine)
    return np.concatenate(of_corner), np.concatenate(weights), np.concatenate(triangles)
