"""Mesh files to `Mesh`: triangles in metres, Z up, with a material on every face."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, shown
from warpsar.runtime import threads
from warpsar.world.mesh_arrays import LARGEST_COORDINATE_M, checked
from warpsar.world.meshes import dem, gltf, obj, ply, stl
from warpsar.world.meshes.part import DEFAULT_MATERIAL, MeshPart
from warpsar.world.upright import y_up, z_up

GLTF = (".gltf", ".glb")
SUFFIXES = (".obj", ".ply", ".stl", *GLTF, *dem.SUFFIXES)
# A radar scene of more than 5 km that is not a DEM is far more often a building in millimetres.
SUSPICIOUS_EXTENT_M = 5e3
SMOOTH_DEG = 30.0
"""Faces that meet at less than this angle are one smooth surface; the edge between others is a wedge."""
_TOGETHER = 1 << 16  # faces that a core looks at: some 20 arrays of three numbers each stay in its cache


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of the world, in metres: right-handed, X east, Y north, Z up.

    Lists and arrays of other types are taken as well. Raises InputError for shapes and types that are no mesh, for NaN
    or infinite vertices, and for indices out of range.
    """

    vertices: NDArray[np.float64]
    """World coordinates [m], shape (n, 3)."""
    faces: NDArray[np.int32]
    """Vertex indices, shape (m, 3)."""
    face_material: NDArray[np.int32]
    """Index into `materials`, shape (m,)."""
    materials: tuple[str, ...] = (DEFAULT_MATERIAL,)
    """Material names, in the order of their first face."""
    uv: NDArray[np.float32] | None = None
    """Texture coordinates, v up, shape (n, 2); NaN where only other parts of the mesh have them."""
    vertex_scalars: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Named scalars of a PLY's vertices, each of shape (n,)."""
    warnings: tuple[str, ...] = ()
    """What a user should know about the file, one sentence each."""
    groups: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Faces of the parts that the file names (`read_mesh` with `groups`)."""

    def __repr__(self) -> str:
        names = ", ".join(self.materials[:4]) + (", ..." if len(self.materials) > 4 else "")
        return f"<Mesh: {len(self.faces)} triangles, {len(self.vertices)} vertices, materials {names}>"

    def __post_init__(self) -> None:
        given = (self.vertices, self.faces, self.face_material, self.materials, self.uv, self.vertex_scalars)
        for name, value in checked(*given).items():
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, source: Any, faces: Any = None, **more: Any) -> Mesh:
        """A mesh made in memory, checked as one from a file is: faces of zero area are left out.

        `source` is one of: a `trimesh.Trimesh`; a `trimesh.Scene`, whose geometries' names become the materials; a
        dict of material names with a Trimesh or a pair (vertices, faces) each; or vertices, shape (n, 3) [m], with
        `faces`, shape (m, 3). `more` are fields of `Mesh` to be set besides: `vertex_scalars`, `uv`, or `materials`
        with `face_material`. Without names the one material is "default". Raises InputError.
        """
        mesh = cls(**{**arrays_of(source, faces, DEFAULT_MATERIAL), **more})
        lit = ~_zero_area(mesh.vertices, mesh.faces)
        if not lit.any():
            raise InputError(f"mesh.faces: all {len(lit)} faces have zero area; must hold triangles")
        warnings = _extent_warnings(mesh.vertices)
        if lit.all():
            return replace(mesh, warnings=warnings)
        dropped = f"{len(lit) - int(lit.sum())} of {len(lit)} faces have zero area and were dropped"
        faces, face_material = mesh.faces[lit], mesh.face_material[lit]
        return replace(mesh, faces=faces, face_material=face_material, warnings=(dropped, *warnings))


def unlikely_size(vertices: NDArray[np.float64]) -> str | None:
    """How large a mesh is, in words, where that is more likely a wrong unit than its size; `vertices` [m], (n, 3)."""
    extent = float(np.ptp(vertices, axis=0).max())
    if extent <= SUSPICIOUS_EXTENT_M:
        return None
    return f"the mesh is {extent:g} m across, more than {SUSPICIOUS_EXTENT_M:g} m: its unit is likely the millimetre"


def _extent_warnings(vertices: NDArray[np.float64]) -> tuple[str, ...]:
    found = unlikely_size(vertices)
    return () if found is None else (f"{found}, and must be the metre",)


def read_mesh(path: str | Path, *, groups: bool = False, up: str | None = None) -> Mesh:
    """Read an OBJ, PLY, STL, glTF or GLB file, or a DEM in GeoTIFF (extra `geo`).

    `up` is the axis of the file that points up, "y" or "z": Y up is turned, (x, y, z) to (x, -z, y). None takes it as
    the format has it, and warns where the mesh seems to have Y up (`upright.y_up`).

    With `groups` the faces of an OBJ are kept apart by each of the names `usemtl`, `o` and `g`, and the mesh has
    `groups`: of an OBJ the faces under each name, of a glTF those at each node or below it. A name that an OBJ gives
    twice means its `usemtl`, else its `o`.

    Material names come from an OBJ's `usemtl`, or from `o` or `g` where a face has none; from a glTF's material, or
    from its mesh. Elsewhere the material is "default". The modules of `warpsar.world.meshes` say what each format
    keeps.

    Raises InputError for a file that cannot be read, is empty or has no faces; for indices out of range and for
    coordinates that are not finite; and where all faces have zero area.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: found a mesh of type '{suffix}'; must be one of {', '.join(SUFFIXES)}")
    if not os.path.isfile(path):  # Path.is_file raises for names that no file can have
        raise InputError(f"{path}: no such mesh file")
    if not path.stat().st_size:
        raise InputError(f"{path}: the file is empty; must hold triangles")
    scalars: dict[str, NDArray[np.float64]] = {}
    warnings: list[str] = []
    if suffix == ".obj":
        parts = obj.read(path, groups=groups)
    elif suffix == ".ply":
        parts, scalars = ply.read(path, warnings)
    elif suffix == ".stl":
        parts = stl.read(path)
    elif suffix in dem.SUFFIXES:
        parts = dem.read(path, warnings)
    else:
        parts = gltf.read(path, warnings, up)
    if up == "y" and suffix not in GLTF:
        parts = [replace(part, vertices=z_up(part.vertices)) for part in parts]
    mesh = _join(path, parts, scalars, warnings, groups=groups)
    seems = y_up(mesh.vertices, mesh.faces) if up is None and suffix not in dem.SUFFIXES else None
    if seems is None:
        return mesh
    return replace(mesh, warnings=(*mesh.warnings, f"{seems}; `warpsar new --up y` turns it"))


def _join(
    path: Path, parts: list[MeshPart], scalars: dict[str, NDArray[np.float64]], warnings: list[str], *, groups: bool
) -> Mesh:
    """Check the parts, put them into one mesh and drop faces of zero area."""
    if not any(len(part.vertices) for part in parts):
        raise InputError(f"{path}: the mesh is empty; must hold triangles")
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise InputError(f"{path}: the mesh has vertices and no faces; must hold triangles")
    for part in parts:
        low, high, count = int(part.faces.min()), int(part.faces.max()), len(part.vertices)
        if low < 0 or high >= count:
            bad = low if low < 0 else high
            raise InputError(f"{path}: a face refers to vertex {bad} (from 0); the file has {count} vertices")
    names = tuple(dict.fromkeys(part.material for part in parts))
    index_of = {name: index for index, name in enumerate(names)}
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    vertices = np.ascontiguousarray(np.concatenate([part.vertices for part in parts]), dtype=np.float64)
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    faces = faces.astype(np.int32)
    face_material = np.repeat(
        np.array([index_of[part.material] for part in parts], np.int32), [len(part.faces) for part in parts]
    )
    _refuse_coordinates(path, vertices)
    lit = ~_zero_area(vertices, faces)
    if not lit.any():
        raise InputError(f"{path}: all {len(faces)} faces have zero area; must hold triangles")
    part_of = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])[lit] if groups else None
    if not lit.all():
        faces, face_material = faces[lit], face_material[lit]
        warnings.append(f"{len(lit) - int(lit.sum())} of {len(lit)} faces have zero area and were dropped")
    if path.suffix.lower() not in dem.SUFFIXES:
        warnings += _extent_warnings(vertices)
    named = {} if part_of is None else _groups(path, parts, part_of)
    return Mesh(vertices, faces, face_material, names, _joined_uv(parts), scalars, tuple(warnings), named)


def _groups(path: Path, parts: list[MeshPart], part_of: NDArray[np.int64]) -> dict[str, NDArray[np.int32]]:
    """Faces under each name of an OBJ's or a glTF's parts; `part_of`, (m,), is the part of each face.

    An OBJ's `usemtl` goes before an `o` of the same name, and that before a `g`.
    """
    suffix = path.suffix.lower()
    if suffix not in (".obj", ".gltf", ".glb"):
        return {}
    members: dict[str, tuple[int, list[int]]] = {}
    for index, part in enumerate(parts):
        for place, name in enumerate(part.groups):
            kind = place if suffix == ".obj" else 0
            best, found = members.get(name, (kind, []))
            if name and kind <= best:
                members[name] = (kind, [index] if kind < best else [*found, index])
    return {name: np.flatnonzero(np.isin(part_of, found)).astype(np.int32) for name, (_, found) in members.items()}


def _refuse_coordinates(path: Path, vertices: NDArray[np.float64]) -> None:
    bad_vertices = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad_vertices):
        raise InputError(
            f"{path}: {len(bad_vertices)} of {len(vertices)} vertices are NaN or infinite "
            f"(the first is vertex {bad_vertices[0]}, from 0); must be finite"
        )
    largest = float(np.abs(vertices).max())
    if largest > LARGEST_COORDINATE_M:
        raise InputError(f"{path}: found a coordinate of {largest:g} m; must be up to {LARGEST_COORDINATE_M:g}")


def _joined_uv(parts: list[MeshPart]) -> NDArray[np.float32] | None:
    """Texture coordinates of all parts, shape (n, 2); NaN for the parts that have none."""
    if all(part.uv is None for part in parts):
        return None
    with np.errstate(over="ignore"):  # beyond float32 is no place on a texture
        uv = np.concatenate(
            [np.full((len(p.vertices), 2), np.nan) if p.uv is None else p.uv for p in parts], dtype=np.float32
        )
    uv[~np.isfinite(uv)] = np.nan
    return uv


def _zero_area(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Faces whose height over their longest edge is lost in the rounding of their coordinates, shape (m,)."""
    rounding = 4 * np.finfo(np.float64).eps * float(np.abs(vertices).max())

    def some(start: int) -> NDArray[np.bool_]:
        a, b, c = (vertices[faces[start : start + _TOGETHER, i]] for i in range(3))
        edges = np.stack([b - a, c - b, a - c])
        longest = np.sqrt((edges**2).sum(axis=2).max(axis=0))
        normal = np.cross(edges[0], edges[2])
        zero: NDArray[np.bool_] = np.sqrt((normal**2).sum(axis=1)) <= rounding * longest
        return zero

    return np.concatenate(list(threads.in_threads([partial(some, k) for k in range(0, len(faces), _TOGETHER)])))


# ---- arrays of a mesh made in memory


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
