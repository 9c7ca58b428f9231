"""The arrays of a mesh made in memory: from trimesh, from named parts, or from vertices and faces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from warpsar.errors import InputError, shown
from warpsar.world.mesh_arrays import checked


def arrays_of(source: Any, faces: Any, default: str) -> dict[str, Any]:
    """`vertices`, `faces`, `face_material`, `materials` and `uv` of what `Mesh.of` takes; checked part by part.

    Raises InputError.
    """
    if faces is not None:
        return _joined([(default, source, faces, None)])
    if isinstance(source, Mapping):
        return _joined([_part(str(name), part) for name, part in source.items()])
    if hasattr(source, "graph") and hasattr(source, "geometry"):  # trimesh.Scene
        return _joined(_placed(source))
    return _joined([_part(default, source)])


def _part(name: str, part: Any) -> tuple[str, Any, Any, Any]:
    """A name with vertices, faces and uv (or None)."""
    if hasattr(part, "vertices") and hasattr(part, "faces"):  # trimesh.Trimesh
        return name, part.vertices, part.faces, getattr(getattr(part, "visual", None), "uv", None)
    if isinstance(part, tuple) and len(part) == 2:
        return name, *part, None
    raise InputError(
        f"mesh: found {shown(type(part).__name__)} as {name!r}; must be a trimesh.Trimesh, a trimesh.Scene, a dict of "
        f"names and parts, or vertices and faces"
    )


def _placed(scene: Any) -> list[tuple[str, Any, Any, Any]]:
    """The geometries of a trimesh.Scene, each where its nodes put it, under the geometry's name."""
    parts = []
    for node in scene.graph.nodes_geometry:
        transform, key = scene.graph[node]
        name, vertices, faces, uv = _part(str(key), scene.geometry[key])
        parts.append((name, np.asarray(vertices) @ transform[:3, :3].T + transform[:3, 3], faces, uv))
    return parts


def _joined(parts: list[tuple[str, Any, Any, Any]]) -> dict[str, Any]:
    if not parts:
        raise InputError("mesh: found no part; must hold triangles")
    names = tuple(dict.fromkeys(name for name, *_ in parts))
    found, count = [], 0
    for name, vertices, faces, uv in parts:
        try:
            one = checked(vertices, faces, np.zeros(np.shape(faces)[:1], np.int32), (name,), uv, {})
        except InputError as error:
            raise error if len(parts) == 1 else InputError(f"part {name!r}: {error}") from error
        one["faces"] = one["faces"] + count
        one["face_material"] = one["face_material"] + names.index(name)
        count += len(one["vertices"])
        found.append(one)
    joined = {key: np.concatenate([one[key] for one in found]) for key in ("vertices", "faces", "face_material")}
    if any(one["uv"] is not None for one in found):
        nowhere = [np.full((len(one["vertices"]), 2), np.nan, np.float32) for one in found]
        joined["uv"] = np.concatenate(
            [n if one["uv"] is None else one["uv"] for one, n in zip(found, nowhere, strict=True)]
        )
    return {**joined, "materials": names}
