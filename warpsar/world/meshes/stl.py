"""STL, binary or text."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from warpsar.errors import InputError, shown
from warpsar.world.meshes.part import DEFAULT_MATERIAL, MeshPart
from warpsar.world.meshes.through_trimesh import load, parts, refusing_broken


def read(path: Path) -> list[MeshPart]:
    """The one part of the file; corners at one place become one vertex."""
    _refuse_truncated(path)
    scene = load(path, path)
    with refusing_broken(path):
        for geometry in scene.geometry.values():
            if np.isfinite(geometry.vertices).all():
                geometry.merge_vertices()
    return parts(path, scene, lambda _key, _geometry: DEFAULT_MATERIAL)


def _refuse_truncated(path: Path) -> None:
    """Raise InputError for a file that is neither binary STL of its stated length nor text in UTF-8 that ends.

    trimesh would guess an encoding, if the package for that happens to be installed, and find no triangles; in text
    without an end it finds none either.
    """
    data = path.read_bytes()
    triangles = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else 0
    if len(data) >= 84 and 84 + 50 * triangles == len(data):
        return
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        stated = f"{triangles} triangles take {84 + 50 * triangles} bytes, found {len(data)}"
        raise InputError(
            f"{path}: cannot be read as STL (truncated, or text that is not UTF-8; if binary, its {stated})"
        ) from error
    lines = text.rstrip().split("\n")
    if lines[0].split()[:1] == ["solid"] and lines[-1].split()[:1] != ["endsolid"]:
        last = f"line {len(lines)}, the last, is {shown(lines[-1].strip())}"
        raise InputError(f"{path}: cannot be read as STL ({last}; must be 'endsolid': truncated)")
