"""The parts of a scene's own mesh that have a name."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.world.mesh import Mesh, read_mesh


def with_groups(mesh: Mesh, path: Path | None, wanted: Collection[str]) -> Mesh:
    """The mesh with the `groups` that its materials make, and those of its file where one of `wanted` is no material.

    Materials go first: an OBJ's `usemtl` does so, too. The file is read again only where it must be, because its faces
    and vertices then come in another order. Groups that the mesh has already stay.
    """
    if wanted and set(wanted) <= set(mesh.groups):
        return mesh
    groups = {
        name: np.flatnonzero(mesh.face_material == index).astype(np.int32) for index, name in enumerate(mesh.materials)
    }
    groups |= mesh.groups
    if not set(wanted) <= set(groups) and path is not None:
        return read_mesh(path, groups=True)
    return replace(mesh, groups=groups)


def group_names(mesh: Mesh, path: Path | None) -> list[str]:
    """Every group of the scene's mesh: its materials, and what else an OBJ or a glTF names."""
    named = {} if path is None else read_mesh(path, groups=True).groups
    return list(dict.fromkeys([*mesh.materials, *mesh.groups, *named]))


def without_group(mesh: Mesh, group: str) -> Mesh:
    """The mesh without the faces of a group, whose name stays with no faces; materials without a face go.

    Other groups of the same faces alone go, too. Raises InputError where no face is left.
    """
    kept = np.ones(len(mesh.faces), bool)
    kept[mesh.groups[group]] = False
    if not kept.any():
        raise InputError(f"group {group}: found all faces of the mesh; must leave some")
    place = np.cumsum(kept) - 1
    groups = {name: place[faces[kept[faces]]].astype(np.int32) for name, faces in mesh.groups.items()}
    groups = {
        name: faces for name, faces in groups.items() if len(faces) or name == group or not len(mesh.groups[name])
    }
    vertices, corners = np.unique(mesh.faces[kept], return_inverse=True)
    used, material = np.unique(mesh.face_material[kept], return_inverse=True)
    return replace(
        mesh,
        vertices=mesh.vertices[vertices],
        faces=corners.reshape(-1, 3).astype(np.int32),
        face_material=material.astype(np.int32),
        materials=tuple(mesh.materials[k] for k in used),
        uv=None if mesh.uv is None else mesh.uv[vertices],
        vertex_scalars={name: values[vertices] for name, values in mesh.vertex_scalars.items()},
        groups=groups,
    )
