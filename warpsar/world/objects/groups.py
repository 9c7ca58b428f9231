"""The parts of a scene's own mesh that have a name."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from warpsar.world.mesh import Mesh, read_mesh


def with_groups(mesh: Mesh, path: Path | None, wanted: Collection[str]) -> Mesh:
    """The mesh with the `groups` that its materials make, and those of its file where one of `wanted` is no material.

    Materials go first: an OBJ's `usemtl` does so, too. The file is read again only where it must be, because its faces
    and vertices then come in another order.
    """
    if not set(wanted) <= set(mesh.materials) and path is not None:
        return read_mesh(path, groups=True)
    groups = {
        name: np.flatnonzero(mesh.face_material == index).astype(np.int32) for index, name in enumerate(mesh.materials)
    }
    return replace(mesh, groups=groups)


def group_names(mesh: Mesh, path: Path | None) -> list[str]:
    """Every group of the scene's mesh: its materials, and what else an OBJ or a glTF names."""
    named = {} if path is None else read_mesh(path, groups=True).groups
    return list(dict.fromkeys([*mesh.materials, *named]))
