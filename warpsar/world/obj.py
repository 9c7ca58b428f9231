"""A mesh as Wavefront OBJ."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.io.images import replacing
from warpsar.world.mesh import Mesh


def write_obj(path: Path, mesh: Mesh) -> None:
    """Wavefront OBJ with a `usemtl` for every material, and UV where the mesh has them; coordinates to the bit.

    Groups that are no materials are written as `o`, and a face of several as the first one.
    """
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    form = "f {0} {1} {2}"
    if mesh.uv is not None:
        lines += [f"vt {u!r} {v!r}" for u, v in np.nan_to_num(mesh.uv).tolist()]
        form = "f {0}/{0} {1}/{1} {2}/{2}"
    last, named = -1, ""
    for face, material, group in zip(mesh.faces + 1, mesh.face_material, _groups(mesh), strict=True):
        if group != named:
            lines.append(f"o {group}")
            named = group
        if material != last:
            lines.append(f"usemtl {mesh.materials[material]}")
            last = material
        lines.append(form.format(*face))
    with replacing(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _groups(mesh: Mesh) -> list[str]:
    """Of every face the group that is no material, "rest" where others have one, "" where none has."""
    named = {name: faces for name, faces in mesh.groups.items() if name not in mesh.materials and len(faces)}
    found = np.full(len(mesh.faces), "rest" if named else "", dtype=object)
    for name, faces in reversed(named.items()):
        found[faces] = name
    return [str(name) for name in found]
