"""Are these arrays a mesh? Kernels take indices and coordinates as they come: what is wrong is refused here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, shown
from warpsar.world.meshes.through_trimesh import LARGEST_MESH

# float32 kernels keep no metre apart beyond this, and no radar scene is this large.
LARGEST_COORDINATE_M = 1e8


def checked(
    vertices: Any, faces: Any, face_material: Any, materials: Any, uv: Any, vertex_scalars: Any
) -> dict[str, Any]:
    """The fields of a `Mesh` in their own types. Raises InputError: what was found, and what is allowed."""
    points = _array("vertices", vertices, "fiu", (None, 3), np.float64)
    _check_vertices(points)
    corners = _indices("faces", faces, (None, 3), len(points), "vertices")
    if not len(corners):
        raise InputError("mesh.faces: found no face; must hold triangles")
    if isinstance(materials, str) or not all(isinstance(name, str) and name for name in materials):
        raise InputError(f"mesh.materials: found {shown(materials)}; must be names, such as ('ground', 'roof')")
    names = tuple(materials)
    if len(set(names)) < len(names) or not names:
        raise InputError(f"mesh.materials: found {shown(names)}; must be one or more names, each of them once")
    return {
        "vertices": points,
        "faces": corners,
        "face_material": _indices("face_material", face_material, (len(corners),), len(names), "materials"),
        "materials": names,
        "uv": None if uv is None else _array("uv", uv, "fiu", (len(points), 2), np.float32),
        "vertex_scalars": _scalars(vertex_scalars, len(points)),
    }


def _check_vertices(vertices: NDArray[np.float64]) -> None:
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(
            f"mesh.vertices: {len(bad)} of {len(vertices)} are NaN or infinite (the first is vertex {bad[0]}, from 0); "
            f"must be finite"
        )
    largest = float(np.abs(vertices).max(initial=0.0))
    if largest > LARGEST_COORDINATE_M:
        raise InputError(f"mesh.vertices: found a coordinate of {largest:g} m; must be up to {LARGEST_COORDINATE_M:g}")


def _scalars(given: Any, count: int) -> dict[str, NDArray[np.float64]]:
    if not isinstance(given, Mapping):
        raise InputError(f"mesh.vertex_scalars: found {shown(given)}; must be a dict of names and arrays")
    return {str(name): _array(f"vertex_scalars[{name!r}]", v, "fiu", (count,), np.float64) for name, v in given.items()}


def _indices(name: str, given: Any, shape: tuple[int | None, ...], count: int, of: str) -> NDArray[np.int32]:
    found = _array(name, given, "iu", shape, None)
    if found.size and (int(found.min()) < 0 or int(found.max()) >= count):
        bad = int(found.min()) if int(found.min()) < 0 else int(found.max())
        raise InputError(f"mesh.{name}: found index {bad}; must be from 0 to {count - 1}: there are {count} {of}")
    return np.ascontiguousarray(found, dtype=np.int32)


def _array(name: str, given: Any, kinds: str, shape: tuple[int | None, ...], kind: Any) -> NDArray[Any]:
    """`given` as an array of `shape` (None: any length) and type `kind` (None: its own)."""
    try:
        found = np.asarray(given)
    except ValueError as error:
        raise InputError(f"mesh.{name}: found rows of different lengths; must be one array") from error
    what = "whole numbers" if kinds == "iu" else "real numbers"
    if not found.size and None in shape:  # an empty list says nothing of its shape
        found = np.zeros([n or 0 for n in shape], kind or np.int32)
    if found.dtype.kind not in kinds:
        raise InputError(f"mesh.{name}: found values of type {found.dtype}; must be {what}")
    if found.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, found.shape, strict=True)):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(f"mesh.{name}: found shape {found.shape}; must be ({wanted})")
    if len(found) > LARGEST_MESH:
        raise InputError(f"mesh.{name}: found {len(found)}; must be at most {LARGEST_MESH}")
    with np.errstate(over="ignore"):  # beyond float32 is no place on a texture
        return np.ascontiguousarray(found, dtype=kind)
