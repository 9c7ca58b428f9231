"""What a reader of mesh files gives: the parts of a file, before they are checked and joined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DEFAULT_MATERIAL = "default"
"""The material of faces that name none."""


@dataclass(frozen=True)
class MeshPart:
    """One part of a file: faces of one material, and vertices of their own."""

    material: str
    vertices: NDArray[np.float64]
    """World coordinates [m], shape (n, 3)."""
    faces: NDArray[np.int64]
    """Indices of the part's vertices, shape (m, 3); not checked yet."""
    uv: NDArray[np.float64] | None = None
    """Texture coordinates, v up, shape (n, 2)."""
    groups: tuple[str, ...] = ()
    """Names that the part has besides: an OBJ's `usemtl`, `o` and `g`, a glTF's nodes. The first kind counts most."""
