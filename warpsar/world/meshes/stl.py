"""STL, binary or text."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.world.meshes.part import DEFAULT_MATERIAL, Part
from warpsar.world.meshes.through_trimesh import load, parts, refusing_broken


def read(path: Path) -> list[Part]:
    """The one part of the file; corners at one place become one vertex."""
    _refuse_other_text(path)
    scene = load(path, path)
    with refusing_broken(path):
        for geometry in scene.geometry.values():
            if np.isfinite(geometry.vertices).all():
                geometry.merge_vertices()
    return parts(path, scene, lambda _key, _geometry: DEFAULT_MATERIAL)


def _refuse_other_text(path: Path) -> None:
    """Raise InputError for a file that is neither binary STL of its stated length nor UTF-8.

    trimesh would guess an encoding, if the package for that happens to be installed, and find no triangles.
    """
    data = path.read_bytes()
    if len(data) >= 84 and 84 + 50 * struct.unpack_from("<I", data, 80)[0] == len(data):
        return
    try:
        data.decode()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: cannot be read as STL (truncated, or text that is not UTF-8)") from error
