"""Meshes with a value per vertex, as PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import unstructured_to_structured

from warpsar.io.images import replacing


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray, scalars: dict[str, np.ndarray]) -> None:
    """Binary PLY with per-vertex scalars, which CloudCompare, MeshLab and Blender show; float64 coordinates [m]."""
    names = ["x", "y", "z", *scalars]
    columns = np.column_stack([vertices, *scalars.values()])
    vertex = unstructured_to_structured(columns, np.dtype([(name, "<f8") for name in names]))
    face = np.empty(len(faces), np.dtype([("n", "u1"), ("corners", "<i4", 3)]))
    face["n"], face["corners"] = 3, faces
    properties = "".join(f"property double {name}\n" for name in names)
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertex)}\n{properties}"
        f"element face {len(face)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with replacing(path) as temporary, temporary.open("wb") as stream:
        stream.write(header.encode("ascii"))
        vertex.tofile(stream)
        face.tofile(stream)
