"""Mesh files to `Mesh`: triangles in metres, Z up, with a material name on every face."""

from __future__ import annotations

import json
import logging
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, shown
from warpsar.io import geotiff
from warpsar.runtime import threads
from warpsar.world.mesh_door import LARGEST_COORDINATE_M, LARGEST_MESH, checked
from warpsar.world.mesh_memory import arrays_of

SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb", ".tif", ".tiff")
DEFAULT_MATERIAL = "default"
# A radar scene of more than 5 km that is not a DEM is far more often a building in millimetres.
SUSPICIOUS_EXTENT_M = 5e3
LARGEST_PER_BYTE = 1032
"""Heights of a DEM to a byte of its file: what deflate packs at most."""
LARGEST_DEM = 2**25
"""Pixels of a DEM: 67 million faces."""
# What trimesh, which has no errors of its own, raises on broken files: it stumbles over them.
_BROKEN: tuple[type[Exception], ...] = (ArithmeticError, AssertionError, AttributeError, EOFError, ImportError)
_BROKEN += (LookupError, NameError, NotImplementedError, OSError, RecursionError, TypeError, ValueError, struct.error)
logging.getLogger("trimesh").addHandler(logging.NullHandler())  # what it says of a broken file is in our message
_TOGETHER = 1 << 16  # faces that a core looks at: some 20 arrays of three numbers each stay in its cache
# PLY vertex properties that are not scalars of the surface.
_PLY_RESERVED = frozenset(
    ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha"] + ["u", "v", "s", "t", "texture_u", "texture_v"]  # noqa: RUF005
)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of the world.

    Coordinates are metres, right-handed, Z up, X east, Y north. Lists and arrays of other types are taken as well.
    Raises InputError for shapes and types that are no mesh, NaN or infinite vertices, and indices out of range.
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
    dropped_faces: int = 0
    """Faces of zero area that were left out."""
    warnings: tuple[str, ...] = ()
    """What a user should know about the file, one sentence each."""

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
        dropped, warnings = int(len(lit) - lit.sum()), _extent_warnings(mesh.vertices)
        if not dropped:
            return replace(mesh, warnings=warnings)
        warnings = (f"{dropped} of {len(lit)} faces have zero area and were dropped", *warnings)
        faces, face_material = mesh.faces[lit], mesh.face_material[lit]
        return replace(mesh, faces=faces, face_material=face_material, dropped_faces=dropped, warnings=warnings)


def _extent_warnings(vertices: NDArray[np.float64]) -> tuple[str, ...]:
    extent = float(np.ptp(vertices, axis=0).max())
    if extent <= SUSPICIOUS_EXTENT_M:
        return ()
    return (f"the mesh is {extent:g} m across: are its units millimetres? They must be metres",)


@dataclass(frozen=True)
class _Part:
    """One part of a file as read, before it is checked and joined to the others."""

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    uv: NDArray[np.float64] | None = None


def read_mesh(path: str | Path) -> Mesh:
    """Read an OBJ, PLY, STL, glTF/GLB file or a GeoTIFF DEM.

    Material names are an OBJ's `usemtl`, or `o`/`g` where a face has none; a glTF's material, or its mesh;
    else "default". A PLY keeps the order of its vertices. STL corners at one place become one vertex.

    glTF is Y up by its standard and is turned to Z up, unless trimesh wrote it: it stores coordinates as
    they are.

    A DEM (extra `geo`) becomes two triangles for each cell between four valid pixel centres, material
    "default". X and Y are metres east and north of the raster's centre, heights are as in the file. A
    projected CRS is taken as it is (feet become metres); a geographic one is projected
    azimuthal-equidistantly about the centre.

    Raises `InputError` for a file that cannot be read, is empty, has no faces, indices out of range,
    coordinates that are not finite, or only faces of zero area.
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
        parts = _read_obj(path)
    elif suffix == ".ply":
        parts, scalars = _read_ply(path, warnings)
    elif suffix == ".stl":
        parts = _read_stl(path)
    elif suffix in (".tif", ".tiff"):
        parts = _read_dem(path, warnings)
    else:
        parts = _read_gltf(path, warnings)
    return _join(path, parts, scalars, warnings)


@contextmanager
def _stumbling(path: Path) -> Iterator[None]:
    """Around trimesh, and what it makes of a file: what that raises becomes one message, and nonsense no noise."""
    suffix = path.suffix.lower()
    try:
        with np.errstate(all="ignore"):
            yield
    except _BROKEN as error:
        what = f"{type(error).__name__}: {' '.join(str(error).split())[:500]}"
        if isinstance(error, IndexError) and suffix == ".obj":
            what = f"a face refers to an entry that is not there: {error}"
        elif isinstance(error, ModuleNotFoundError) and error.name == "charset_normalizer":
            what = "truncated, or text that is not UTF-8"  # trimesh wanted to guess the encoding
        raise InputError(f"{path}: cannot be read as {suffix[1:].upper()} ({what})") from error


def _load(path: Path, source: Any, **how: Any) -> Any:
    """A `trimesh.Scene`; of the files that it refers to only those in `resolver` are there."""
    import trimesh

    with _stumbling(path):
        return trimesh.load_scene(source, process=False, **{"resolver": {}, **how})


def _join(path: Path, parts: list[_Part], scalars: dict[str, Any], warnings: list[str]) -> Mesh:
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
    names = tuple(dict.fromkeys(part.name for part in parts))
    index_of = {name: index for index, name in enumerate(names)}
    starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    vertices = np.ascontiguousarray(np.concatenate([part.vertices for part in parts]), dtype=np.float64)
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
    faces = faces.astype(np.int32)
    face_material = np.repeat(
        np.array([index_of[part.name] for part in parts], np.int32), [len(part.faces) for part in parts]
    )
    bad_vertices = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad_vertices):
        raise InputError(
            f"{path}: {len(bad_vertices)} of {len(vertices)} vertices are NaN or infinite "
            f"(the first is vertex {bad_vertices[0]}, from 0); must be finite"
        )
    largest = float(np.abs(vertices).max())
    if largest > LARGEST_COORDINATE_M:
        raise InputError(f"{path}: found a coordinate of {largest:g} m; must be up to {LARGEST_COORDINATE_M:g}")

    lit = ~_zero_area(vertices, faces)
    if not lit.any():
        raise InputError(f"{path}: all {len(faces)} faces have zero area; must hold triangles")
    dropped = int(len(faces) - lit.sum())
    if dropped:
        faces, face_material = faces[lit], face_material[lit]
        warnings.append(f"{dropped} of {len(lit)} faces have zero area and were dropped")
    if path.suffix.lower() not in (".tif", ".tiff"):
        warnings += _extent_warnings(vertices)
    uv = None
    if any(part.uv is not None for part in parts):
        with np.errstate(over="ignore"):  # beyond float32 is no place on a texture
            uv = np.concatenate(
                [np.full((len(p.vertices), 2), np.nan) if p.uv is None else p.uv for p in parts], dtype=np.float32
            )
        uv[~np.isfinite(uv)] = np.nan
    return Mesh(vertices, faces, face_material, names, uv, scalars, dropped, tuple(warnings))


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


def _parts(path: Path, scene: Any, name_of: Any) -> list[_Part]:
    """The geometries of a `trimesh.Scene`, each at its place in the world."""
    with _stumbling(path):
        return _placed(scene, name_of)


def _placed(scene: Any, name_of: Any) -> list[_Part]:
    import trimesh

    parts = []
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
        parts.append(_Part(name_of(key, geometry), vertices, faces, uv))
    return parts


def _material_name(geometry: Any) -> str | None:
    return getattr(getattr(getattr(geometry, "visual", None), "material", None), "name", None)


# ---- OBJ ----


def _read_obj(path: Path) -> list[_Part]:
    """Through trimesh, which knows only names that are in the .mtl: give it names and .mtl of our own."""
    text, names = _canonical_obj(path)
    mtl = "".join(f"newmtl m{i}\nKd 1 1 1\n" for i in range(len(names)))
    scene = _load(path, BytesIO(text), file_type="obj", resolver={"names.mtl": mtl.encode()}, validate=False)
    parts = _parts(path, scene, lambda _key, geometry: _material_name(geometry))
    # Our .mtl names the material of every face: a part without one is a point cloud.
    parts = [_Part(names[int((p.name or "m0")[1:])], p.vertices, p.faces, p.uv) for p in parts]
    order = {name: index for index, name in enumerate(names)}
    return sorted(parts, key=lambda part: order[part.name])


def _canonical_obj(path: Path) -> tuple[bytes, list[str]]:
    """The OBJ with `usemtl m<index>` before each run of faces, and absolute indices; and the names."""
    text = b"\n" + path.read_bytes() + b"\n"
    for old, new in ((b"\r\n", b"\n"), (b"\r", b"\n"), (b"\\\n", b" "), (b"\t", b" ")):
        text = text.replace(old, new)
    if b"\n " in text:
        text = re.sub(rb"\n +", b"\n", text)
    if b"\n#" in text:
        text = re.sub(rb"\n#[^\n]*", b"", text)
    if b"#" in text:
        text = re.sub(rb"\n((?:vt?n?|f) [^\n#]*)#[^\n]*", rb"\n\1", text)
    if re.search(rb"\nf[^\n]*?[ /][-0]", text):
        text = b"\n".join(_absolute_indices(path, text))
    names = {DEFAULT_MATERIAL: 0}
    pieces = [b"\nmtllib names.mtl\nusemtl m0"]
    group = material = ""
    end = 0
    for match in re.finditer(rb"\n(usemtl|o|g|mtllib)(?: ([^\n]*))?(?=\n)", text):
        pieces.append(text[end : match.start()])
        end = match.end()
        stated = (match[2] or b"").decode("utf-8", "replace").strip()
        if match[1] == b"usemtl":
            material = stated
        elif match[1] != b"mtllib":
            group = stated
        name = material or group or DEFAULT_MATERIAL
        pieces.append(b"\nusemtl m%d" % names.setdefault(name, len(names)))
    pieces.append(text[end:])
    text = b"".join(pieces)
    if not text.isascii():  # the names are out, so this is nothing a mesh needs, and trimesh would guess at it
        text = text.decode("ascii", "replace").encode("ascii", "replace")
    return text, list(names)


def _absolute_indices(path: Path, text: bytes) -> Iterator[bytes]:
    """Lines with relative indices (-1: the last so far) made absolute: trimesh counts from the file's end."""
    counts = {b"v": 0, b"vt": 0, b"vn": 0}

    def absolute(part: bytes, count: int) -> bytes:
        if not part:
            return part
        try:
            index = int(part)
        except ValueError as error:  # no whole number, or one of thousands of digits
            raise InputError(f"{path}: a face has the index {shown(part)}; must be a whole number") from error
        if index == 0 or index < -count:
            raise InputError(
                f"{path}: a face has the index {index} after {count} entries; must be 1 or more, or -1 to {-count}"
            )
        return b"%d" % (index if index > 0 else count + index + 1)

    for line in text.split(b"\n"):
        keyword, _, rest = line.partition(b" ")
        if keyword in counts:
            counts[keyword] += 1
        elif keyword == b"f":
            corners = [zip(corner.split(b"/"), counts.values(), strict=False) for corner in rest.split()]
            line = b"f " + b" ".join(b"/".join(absolute(*pair) for pair in corner) for corner in corners)
        yield line


# ---- the other formats ----


def _read_ply(path: Path, warnings: list[str]) -> tuple[list[_Part], dict[str, Any]]:
    # fix_texture splits vertices at the seams of per-face texture coordinates; the order is kept without it.
    scene = _load(path, path, fix_texture=False)
    if not scene.geometry:
        return [], {}
    (geometry,) = scene.geometry.values()
    elements = geometry.metadata["_ply_raw"]
    for name, element in elements.items():
        data = element.get("data")
        with _stumbling(path):
            rows = len(next(iter(data.values())) if isinstance(data, dict) else data) if data is not None else 0
        if rows != element["length"]:  # trimesh takes the lines that there are
            raise InputError(f"{path}: found {rows} of {element['length']} {name} entries: truncated")
    scalars: dict[str, NDArray[np.float64]] = {}
    if "texcoord" in elements.get("face", {}).get("properties", {}):
        scene = _load(path, path, fix_texture=True)
        warnings.append("texture coordinates are per face: vertices were split, their scalars are not available")
    else:
        with _stumbling(path):
            vertex = elements["vertex"]
            scalars = {
                name: np.asarray(vertex["data"][name], np.float64).reshape(-1)
                for name, kind in vertex["properties"].items()
                if name not in _PLY_RESERVED and "LIST" not in kind
            }
    return _parts(path, scene, lambda _key, _geometry: DEFAULT_MATERIAL), scalars


def _read_stl(path: Path) -> list[_Part]:
    scene = _load(path, path)
    with _stumbling(path):
        for geometry in scene.geometry.values():
            if np.isfinite(geometry.vertices).all():
                geometry.merge_vertices()
    return _parts(path, scene, lambda _key, _geometry: DEFAULT_MATERIAL)


def _read_gltf(path: Path, warnings: list[str]) -> list[_Part]:
    tree, binary = _gltf_chunks(path)
    with _stumbling(path):
        buffers = _gltf_buffers(path, tree)
        _check_gltf(path, tree, path.stat().st_size + sum(map(len, buffers.values())))
        generator = str(tree["asset"].get("generator", ""))
        # Names are all that is asked of materials: no picture that they refer to is opened.
        if "materials" in tree:
            tree["materials"] = [{"name": str(m["name"])} if "name" in m else {} for m in tree["materials"]]
        text = json.dumps({**tree, "images": [], "textures": []}).encode()
    if binary is not None:
        text = _glb(text, binary)
    scene = _load(path, BytesIO(text), file_type=path.suffix[1:].lower(), resolver=buffers)
    parts = _parts(path, scene, lambda key, geometry: _material_name(geometry) or str(key) or DEFAULT_MATERIAL)
    if "trimesh" in generator:
        warnings.append("glTF by trimesh: coordinates taken as they are, Z up")
        return parts
    y_up_to_z_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return [_Part(p.name, p.vertices @ y_up_to_z_up, p.faces, p.uv) for p in parts]


def _gltf_chunks(path: Path) -> tuple[dict[str, Any], bytes | None]:
    """The JSON of a glTF, and what comes after it in a GLB (chunks with their heads; None for a .gltf)."""
    data = path.read_bytes()
    binary = None
    if path.suffix.lower() == ".glb":  # magic, version, length; length and type of the first chunk, which is JSON
        if len(data) < 20 or data[:4] != b"glTF" or data[16:20] != b"JSON":
            raise InputError(f"{path}: cannot be read as GLB (no glTF header, or no JSON after it)")
        (version, length, size) = struct.unpack_from("<III", data, 4)
        if version != 2 or length > len(data) or 20 + size > len(data):
            raise InputError(
                f"{path}: cannot be read as GLB (found version {version}, {length} bytes, JSON of {size}; must be 2, "
                f"and within the file's {len(data)} bytes)"
            )
        data, binary = data[20 : 20 + size], data[20 + size :]
    try:
        tree = json.loads(data)
    except (ValueError, RecursionError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: cannot be read as {path.suffix[1:].upper()} ({what})") from error
    if not isinstance(tree, dict):
        raise InputError(f"{path}: cannot be read as {path.suffix[1:].upper()} (its JSON is no object)")
    return tree, binary


def _glb(text: bytes, binary: bytes) -> bytes:
    text += b" " * (-len(text) % 4)
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(binary), len(text), b"JSON") + text + binary


def _gltf_buffers(path: Path, tree: dict[str, Any]) -> dict[str, bytes]:
    """The files that a glTF's buffers name: those in its own folder or below."""
    found = {}
    for buffer in tree.get("buffers", []):
        name = buffer.get("uri")
        if name is None or "base64," in name:
            continue
        file = (path.parent / name).resolve()
        if not file.is_relative_to(path.parent.resolve()) or not file.is_file():
            raise InputError(f"{path}: a buffer is in {name}; must be a file in the same folder")
        found[name] = file.read_bytes()
    return found


def _check_gltf(path: Path, tree: dict[str, Any], size: int) -> None:
    """trimesh makes the arrays that are claimed, and takes sparse ones for zeros."""
    counts = [accessor["count"] for accessor in tree.get("accessors", [])]
    if any(not isinstance(count, int) or count < 0 for count in counts) or sum(counts) > size:
        raise InputError(f"{path}: the accessors claim {shown(counts)} elements in {size} bytes; must be fewer")
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            used = (primitive.get("indices"), *(primitive["attributes"].get(k) for k in ("POSITION", "TEXCOORD_0")))
            if any("sparse" in tree["accessors"][index] for index in used if index is not None):
                raise InputError(f"{path}: found a sparse accessor; must be a plain one")


def _read_dem(path: Path, warnings: list[str]) -> list[_Part]:
    with geotiff.opened(path) as source:
        _check_dem(path, source)
        band = source.read(1, masked=True)
        heights = np.ma.filled(band.astype(np.float64), np.nan) * source.scales[0] + source.offsets[0]
        affine, crs = source.transform, source.crs
    with geotiff.projecting(path):
        from rasterio.warp import transform as project

        row, col = (index.ravel() + 0.5 for index in np.indices(heights.shape))
        x = affine.a * col + affine.b * row + affine.c
        y = affine.d * col + affine.e * row + affine.f
        centre_x, centre_y = float(x.mean()), float(y.mean())  # of an affine grid: its middle
        if crs is not None and crs.is_geographic:
            local = f"+proj=aeqd +lat_0={centre_y} +lon_0={centre_x} +datum=WGS84 +units=m"
            east, north = (np.asarray(values) for values in project(crs, local, x, y))
        else:
            if crs is None:
                warnings.append("the DEM has no coordinate system: its coordinates are taken as metres")
            metres = crs.linear_units_factor[1] if crs is not None else 1.0
            east, north = (x - centre_x) * metres, (y - centre_y) * metres
    rows, cols = heights.shape
    valid = np.isfinite(heights)
    whole = valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]
    corner = np.arange(rows * cols).reshape(rows, cols)[:-1, :-1][whole]
    faces = np.concatenate(
        [
            np.stack([corner, corner + cols, corner + 1], axis=1),
            np.stack([corner + 1, corner + cols, corner + cols + 1], axis=1),
        ]
    )
    used = np.zeros(rows * cols, bool)
    used[faces] = True
    index = np.cumsum(used) - 1
    vertices = np.stack([east, north, heights.ravel()], axis=1)[used]
    return [_Part(DEFAULT_MATERIAL, vertices, index[faces])]


def _check_dem(path: Path, source: Any) -> None:
    """What a raster's header says, before its pixels are read."""
    if source.count != 1:
        raise InputError(f"{path}: found {source.count} bands; a DEM must have one, of heights [m]")
    size = path.stat().st_size
    most = min(LARGEST_DEM, LARGEST_PER_BYTE * size)
    if source.width * source.height > most:
        raise InputError(
            f"{path}: found {source.height} x {source.width} heights; must be at most {most}, by its {size} bytes"
        )
    if np.dtype(source.dtypes[0]).kind not in "fiu":
        raise InputError(f"{path}: found heights of type {source.dtypes[0]}; must be real numbers")
