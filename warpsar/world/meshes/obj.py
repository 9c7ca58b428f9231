"""Wavefront OBJ."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path

from warpsar.world.meshes import broken_lines
from warpsar.world.meshes.part import DEFAULT_MATERIAL, MeshPart
from warpsar.world.meshes.through_trimesh import load, material_name, parts, refusing_broken

_SHORT = re.compile(rb"\n(?:(?:v|vn|f)(?: +[^ \n]+){0,2}|vt) *(?=\n)")
"""A line of too few numbers or corners. trimesh leaves such faces out, and takes vertices of which all are short."""


def read(path: Path, *, groups: bool = False) -> list[MeshPart]:
    """The faces by material: `usemtl`, else the group (`o` or `g`), else "default".

    With `groups` also by each of the three names, which the parts then have.

    trimesh knows only the names that are in the .mtl file, so it is given names and a .mtl of our own.
    """
    data = path.read_bytes()
    fault = partial(broken_lines.of_obj, data)
    with refusing_broken(path, fault):
        text, names = _canonical_obj(data, groups)
    mtl = "".join(f"newmtl m{i}\nKd 1 1 1\n" for i in range(len(names)))
    scene = load(
        path, BytesIO(text), file_type="obj", resolver={"names.mtl": mtl.encode()}, validate=False, fault=fault
    )
    # Our .mtl names the material of every face: a part without one is a point cloud.
    found = parts(path, scene, lambda _key, geometry: str(int((material_name(geometry) or "m0")[1:])))
    ordered = sorted(found, key=lambda part: int(part.material))
    return [replace(p, material=names[int(p.material)][0], groups=names[int(p.material)][1:]) for p in ordered]


def _canonical_obj(data: bytes, groups: bool) -> tuple[bytes, list[tuple[str, ...]]]:
    """The OBJ with `usemtl m<index>` before each run of faces, and absolute indices; and the names.

    Each is the material, and with `groups` the `usemtl`, `o` and `g` in force. Raises ValueError for broken lines.
    """
    text = b"\n" + data + b"\n"
    for old, new in ((b"\r\n", b"\n"), (b"\r", b"\n"), (b"\\\n", b" "), (b"\t", b" ")):
        text = text.replace(old, new)
    if b"\n " in text:
        text = re.sub(rb"\n +", b"\n", text)
    if b"\n#" in text:
        text = re.sub(rb"\n#[^\n]*", b"", text)
    if b"#" in text:
        text = re.sub(rb"\n((?:vt?n?|f) [^\n#]*)#[^\n]*", rb"\n\1", text)
    if short := _SHORT.search(text):
        raise ValueError(f"a line is too short: {short[0]!r}")
    if re.search(rb"\nf[^\n]*?[ /][-0]", text):
        text = b"\n".join(_absolute_indices(text))
    names: dict[tuple[str, ...], int] = {(DEFAULT_MATERIAL, *(("", "", "") if groups else ())): 0}
    pieces = [b"\nmtllib names.mtl\nusemtl m0"]
    group = material = ""
    named = {b"o": "", b"g": ""}
    end = 0
    for match in re.finditer(rb"\n(usemtl|o|g|mtllib)(?: ([^\n]*))?(?=\n)", text):
        pieces.append(text[end : match.start()])
        end = match.end()
        stated = (match[2] or b"").decode("utf-8", "replace").strip()
        if match[1] == b"usemtl":
            material = stated
        elif match[1] != b"mtllib":
            group = named[match[1]] = stated
        name = (material or group or DEFAULT_MATERIAL, *((material, named[b"o"], named[b"g"]) if groups else ()))
        pieces.append(b"\nusemtl m%d" % names.setdefault(name, len(names)))
    pieces.append(text[end:])
    text = b"".join(pieces)
    if not text.isascii():  # the names are out, so this is nothing a mesh needs, and trimesh would guess at it
        text = text.decode("ascii", "replace").encode("ascii", "replace")
    return text, list(names)


def _absolute_indices(text: bytes) -> Iterator[bytes]:
    """Lines with relative indices (-1: the last so far) made absolute: trimesh counts from the file's end.

    Raises ValueError for an index that is no whole number, 0, or before the first entry.
    """
    counts = {b"v": 0, b"vt": 0, b"vn": 0}

    def absolute(part: bytes, count: int) -> bytes:
        if not part:
            return part
        index = int(part)
        if index == 0 or index < -count:
            raise ValueError(f"index {index} after {count} entries")
        return b"%d" % (index if index > 0 else count + index + 1)

    for line in text.split(b"\n"):
        keyword, _, rest = line.partition(b" ")
        if keyword in counts:
            counts[keyword] += 1
        elif keyword == b"f":
            corners = [zip(corner.split(b"/"), counts.values(), strict=False) for corner in rest.split()]
            line = b"f " + b" ".join(b"/".join(absolute(*pair) for pair in corner) for corner in corners)
        yield line
