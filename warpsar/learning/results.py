"""What was learned, as a scene that simulates with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from warpsar.io.images import write_exr
from warpsar.io.ply import write_ply
from warpsar.learning.problem import FitProblem
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.world.mesh import DEFAULT_MATERIAL
from warpsar.world.pixels import Pixels


def learned_scene(problem: FitProblem, x: np.ndarray, folder: Path | None = None) -> Scene:
    """The problem's scene with x in place of its start; save it with `Scene.save`.

    Parameter maps (EXR) and, for vertex layouts, the mesh with its scalars (PLY) are written into `folder`. Without a
    folder the fields lie in memory, and so do those of a mesh with names that a PLY cannot hold.
    """
    scene, surface = problem.scene, problem.surface
    nodes = problem.nodes(x)
    materials = dict(scene.materials)
    scalars: dict[str, np.ndarray] = {}
    for block in surface.blocks:
        if not block.learn:
            continue
        key = block.kind.key
        values = surface.values(block.material, key, nodes)
        declared = getattr(materials[block.material], key)
        new: str | float | tuple[float, ...] | Pixels
        if block.layout == "texture" and folder is None:
            new = Pixels(values)
        elif block.layout == "texture" and folder is not None:
            path = folder / f"{file_stem(surface.materials, block.material, key)}.exr"
            write_exr(path, {key: values.astype(np.float32)})
            new = str(path.resolve())
        elif block.layout == "vertex":
            whole = scalars.setdefault(declared, np.array(scene.mesh.vertex_scalars[declared], float))
            whole[block.first_vertex : block.first_vertex + block.size] = values
            new = declared
        else:
            number = float(values[0])
            new = (number, *declared[1:]) if isinstance(declared, tuple) else number
            if isinstance(declared, tuple) and key == "correlation_length_m":
                new = (number, number * declared[1] / declared[0])
        materials[block.material] = materials[block.material].model_copy(update={key: new})
    changed = replace(scene, materials=materials, effects=problem.effect_tables(x))
    if scalars:
        mesh = replace(scene.mesh, vertex_scalars={**scene.mesh.vertex_scalars, **scalars})
        changed = replace(changed, mesh=mesh, mesh_path=None)
        if folder is not None and mesh.materials == (DEFAULT_MATERIAL,):
            path = folder / "mesh.ply"
            write_ply(path, mesh.vertices, mesh.faces, mesh.vertex_scalars)
            changed = replace(changed, mesh_path=path.resolve())
    return changed
