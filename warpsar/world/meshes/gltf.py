"""glTF 2.0 and its binary form GLB."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

from warpsar.errors import InputError, shown
from warpsar.world.meshes.part import DEFAULT_MATERIAL, MeshPart
from warpsar.world.meshes.through_trimesh import load, material_name, parts, refusing_broken
from warpsar.world.upright import z_up


def read(path: Path, warnings: list[str], up: str | None = None) -> list[MeshPart]:
    """The primitives at their places, by material, else by the name of the mesh.

    glTF is Y up by its standard and is turned to Z up. trimesh writes coordinates as they are: its files stay so, and
    that goes into `warnings`. `up`, "y" or "z", says which it is.
    """
    tree, binary = _chunks(path)
    with refusing_broken(path):
        buffers = _buffers(path, tree)
        _check(path, tree, path.stat().st_size + sum(map(len, buffers.values())))
        generator = str(tree["asset"].get("generator", ""))
        # Only the names of materials are needed: no picture that they refer to is opened.
        if "materials" in tree:
            tree["materials"] = [{"name": str(m["name"])} if "name" in m else {} for m in tree["materials"]]
        text = json.dumps({**tree, "images": [], "textures": []}).encode()
    if binary is not None:
        text = _glb(text, binary)
    scene = load(path, BytesIO(text), file_type=path.suffix[1:].lower(), resolver=buffers)
    found = parts(path, scene, lambda key, geometry: material_name(geometry) or str(key) or DEFAULT_MATERIAL)
    if up is None and "trimesh" in generator:
        warnings.append("glTF by trimesh: coordinates taken as they are, Z up")
        up = "z"
    return found if up == "z" else [replace(part, vertices=z_up(part.vertices)) for part in found]


def _chunks(path: Path) -> tuple[dict[str, Any], bytes | None]:
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


def _buffers(path: Path, tree: dict[str, Any]) -> dict[str, bytes]:
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


def _check(path: Path, tree: dict[str, Any], size: int) -> None:
    """Refuse what trimesh would believe: it makes room for what accessors claim, and reads sparse ones as zeros."""
    counts = [accessor["count"] for accessor in tree.get("accessors", [])]
    if any(not isinstance(count, int) or count < 0 for count in counts) or sum(counts) > size:
        raise InputError(f"{path}: the accessors claim {shown(counts)} elements in {size} bytes; must be fewer")
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            used = (primitive.get("indices"), *(primitive["attributes"].get(k) for k in ("POSITION", "TEXCOORD_0")))
            if any("sparse" in tree["accessors"][index] for index in used if index is not None):
                raise InputError(f"{path}: found a sparse accessor; must be a plain one")
