"""`warpsar uv`: texture coordinates for meshes that have none. Texture layouts need them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from warpsar.errors import InputError
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.obj import write_obj

# Room between charts, in texels of xatlas's own atlas of about 1024: two of a texture of 256, so that bilinear
# interpolation does not mix them.
PADDING = 8


def unwrap(mesh: Mesh) -> Mesh:
    """The mesh with UV in every material, made by xatlas (extra `uv`).

    A material without UV gets charts that fill [0, 1] x [0, 1] and do not overlap. Faces and materials stay as they
    are. A vertex on the edge of a chart is split, and its scalars with it. Raises InputError where xatlas is missing.
    """
    try:
        import xatlas
    except ImportError as error:
        raise InputError('uv: unwrapping needs xatlas: pip install "warpsar[uv]"') from error
    faces = mesh.faces.copy()
    numbers, uvs = [], []
    count = 0
    for material in range(len(mesh.materials)):
        mine = mesh.face_material == material
        used, corners = np.unique(mesh.faces[mine], return_inverse=True)
        corners = corners.reshape(-1, 3)
        if mesh.uv is not None and np.isfinite(mesh.uv[used]).all():
            number, uv = used, mesh.uv[used]
        else:
            near = (mesh.vertices[used] - mesh.vertices[used].mean(axis=0)).astype(np.float32)
            atlas = xatlas.Atlas()
            atlas.add_mesh(near, corners.astype(np.uint32))
            options = xatlas.PackOptions()
            options.padding = PADDING
            atlas.generate(pack_options=options)
            split, corners, uv = atlas[0]
            number = used[split]
        faces[mine] = corners.astype(np.int64) + count
        numbers.append(number)
        uvs.append(uv)
        count += len(number)
    order = np.concatenate(numbers)
    scalars = {name: values[order] for name, values in mesh.vertex_scalars.items()}
    return replace(
        mesh,
        vertices=mesh.vertices[order],
        faces=faces,
        uv=np.concatenate(uvs).astype(np.float32),
        vertex_scalars=scalars,
    )


def run(scene_path: Path | str, out: Path | str) -> Scene:
    """`warpsar uv`: `mesh.obj` with UV, and a scene.toml that refers to it, in `out`. Returns that scene.

    Raises InputError where nothing is without UV, and for vertex layouts, whose scalars an OBJ cannot hold.
    """
    scene = Scene.load(scene_path)
    mesh, out = scene.mesh, Path(out)
    if (out / "scene.toml").resolve() == scene.path:
        raise InputError(
            f"--out: found {out}, where the scene file itself lies and would be replaced; allowed is another"
        )
    if scene.objects:
        raise InputError(f"{scene.path}: objects: found {len(scene.objects)}; must be none: give UV to each mesh alone")
    for name, material in scene.materials.items():
        if material.layout == "vertex":
            raise InputError(
                f'{scene.path}: materials.{name}.layout: found "vertex"; its scalars would be lost in a mesh with UV; '
                f'allowed are "uniform" and "texture"'
            )
    if mesh.uv is not None and np.isfinite(mesh.uv[mesh.faces]).all():
        raise InputError(f"{scene.mesh_path}: found a mesh with UV in every material; there is nothing to unwrap")
    unwrapped = unwrap(mesh)
    path = out.resolve() / "mesh.obj"
    write_obj(path, unwrapped)
    changed = replace(scene, mesh=unwrapped, mesh_path=path)
    changed.save(out / "scene.toml")
    console.say(f"{path}: {len(mesh.vertices)} vertices became {len(unwrapped.vertices)}, split where charts end")
    console.say_written(out, "mesh.obj", "scene.toml")
    return changed
