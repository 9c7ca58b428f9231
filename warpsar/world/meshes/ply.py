"""Stanford PLY, with the scalars of its vertices."""

from __future__ import annotations

from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.world.meshes import broken_lines
from warpsar.world.meshes.part import DEFAULT_MATERIAL, MeshPart
from warpsar.world.meshes.through_trimesh import load, parts, refusing_broken

# Vertex properties that are not scalars of the surface.
_RESERVED = frozenset(
    ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha"] + ["u", "v", "s", "t", "texture_u", "texture_v"]  # noqa: RUF005
)


def read(path: Path, warnings: list[str]) -> tuple[list[MeshPart], dict[str, NDArray[np.float64]]]:
    """The one part of the file, and its vertices' scalars, each (n,). Keeps the order of the vertices.

    Where texture coordinates are per face, vertices are split and scalars lost: that goes into `warnings`.
    """
    # fix_texture splits vertices at the seams of per-face texture coordinates; the order is kept without it.
    content = path.read_bytes()
    fault = partial(broken_lines.of_ply, content)
    scene = load(path, BytesIO(content), file_type="ply", fix_texture=False, fault=fault)
    if not scene.geometry:
        return [], {}
    (geometry,) = scene.geometry.values()
    elements = geometry.metadata["_ply_raw"]
    for name, element in elements.items():
        data = element.get("data")
        with refusing_broken(path, fault):
            rows = len(next(iter(data.values())) if isinstance(data, dict) else data) if data is not None else 0
        if rows != element["length"]:  # trimesh takes the lines that there are
            raise InputError(f"{path}: found {rows} of {element['length']} {name} entries: truncated")
    scalars: dict[str, NDArray[np.float64]] = {}
    if "texcoord" in elements.get("face", {}).get("properties", {}):
        scene = load(path, path, fix_texture=True)
        warnings.append("texture coordinates are per face: vertices were split, their scalars are not available")
    else:
        with refusing_broken(path, fault):
            vertex = elements["vertex"]
            scalars = {
                name: np.asarray(vertex["data"][name], np.float64).reshape(-1)
                for name, kind in vertex["properties"].items()
                if name not in _RESERVED and "LIST" not in kind
            }
    return parts(path, scene, lambda _key, _geometry: DEFAULT_MATERIAL), scalars
