"""Mesh files that trimesh reads: its errors become messages, and its geometries become parts."""

from __future__ import annotations

import logging
import struct
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.errors import InputError
from warpsar.world.meshes.part import MeshPart

if TYPE_CHECKING:
    import trimesh

LARGEST_MESH = 2**28
"""Vertices, and faces, of all parts of a file: nodes may show one part many times."""
# What trimesh raises on broken files: it has no errors of its own.
_BROKEN: tuple[type[Exception], ...] = (ArithmeticError, AssertionError, AttributeError, EOFError, ImportError)
_BROKEN += (LookupError, NameError, NotImplementedError, OSError, RecursionError, TypeError, ValueError, struct.error)
_BROKEN += (DeprecationWarning,)
logging.getLogger("trimesh").addHandler(logging.NullHandler())  # our message holds what it says of a broken file


@contextmanager
def refusing_broken(path: Path, fault: Callable[[], str | None] | None = None) -> Iterator[None]:
    """A `with` block around trimesh and its results: what it raises becomes one message, and NumPy stays silent.

    `fault` says, of a file that trimesh cannot read, which of its lines is broken, or None.
    """
    suffix = path.suffix.lower()
    try:
        with np.errstate(all="ignore"):
            yield
    except _BROKEN as error:
        what = (fault and fault()) or f"{type(error).__name__}: {' '.join(str(error).split())[:500]}"
        raise InputError(f"{path}: cannot be read as {suffix[1:].upper()} ({what})") from error


def load(
    path: Path, source: Path | BytesIO, *, fault: Callable[[], str | None] | None = None, **how: Any
) -> trimesh.Scene:
    """The file as trimesh reads it. Of the files that it refers to only those in `resolver` are there."""
    import trimesh

    with refusing_broken(path, fault), warnings.catch_warnings():
        # older NumPy warns of a word that is no number, and goes on without what follows
        warnings.filterwarnings("error", "string or file could not be read", DeprecationWarning)
        return trimesh.load_scene(source, process=False, **{"resolver": {}, **how})


def parts(path: Path, scene: trimesh.Scene, name_of: Callable[[object, Any], str]) -> list[MeshPart]:
    """The geometries of a scene, each at its place in the world; `name_of` (key, geometry) gives the material."""
    with refusing_broken(path):
        return _placed(scene, name_of)


def _placed(scene: trimesh.Scene, name_of: Callable[[object, Any], str]) -> list[MeshPart]:
    import trimesh

    found = []
    total = 0
    for node in scene.graph.nodes_geometry:
        transform, key = scene.graph[node]
        geometry = scene.geometry[key]
        total += max(len(geometry.vertices), len(getattr(geometry, "faces", ())))
        if total > LARGEST_MESH:
            raise ValueError(f"more than {LARGEST_MESH} vertices or faces in all")
        vertices = trimesh.transform_points(np.asarray(geometry.vertices, np.float64), transform)
        faces = np.asarray(getattr(geometry, "faces", np.zeros((0, 3))), np.int64)
        uv = getattr(getattr(geometry, "visual", None), "uv", None)
        if uv is not None and np.shape(uv) != (len(vertices), 2):
            uv = None
        found.append(MeshPart(name_of(key, geometry), vertices, faces, uv, _names_of(scene, node)))
    return found


def _names_of(scene: trimesh.Scene, node: str) -> tuple[str, ...]:
    """A node and the nodes above it, as far as the root."""
    parents, names = scene.graph.transforms.parents, [str(node)]
    above = parents.get(node)
    while above is not None and str(above) not in names and above != scene.graph.base_frame:
        names.append(str(above))
        above = parents.get(above)
    return tuple(names)


def material_name(geometry: Any) -> str | None:
    """The material's name of a geometry of trimesh; None without one."""
    return getattr(getattr(getattr(geometry, "visual", None), "material", None), "name", None)
