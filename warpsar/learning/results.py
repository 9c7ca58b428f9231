"""What was learned, as a scene that simulates with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.io.images import write_exr
from warpsar.io.ply import write_ply
from warpsar.learning.problem import FitProblem
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.world.mesh import DEFAULT_MATERIAL
from warpsar.world.pixels import Pixels
from warpsar.world.tables import Material
from warpsar.world.tolerance import pinned


def learned_scene(problem: FitProblem, x: np.ndarray, folder: Path | None = None) -> Scene:
    """The problem's scene with x in place of its start; save it with `Scene.save`.

    Parameter maps (EXR) and, for vertex layouts, the mesh with its scalars (PLY) are written into `folder`. Without a
    folder the fields lie in memory, and so do those of a mesh with names that a PLY cannot hold.

    A tolerance stays about the value that was declared: a fit of this scene would else count the images twice.
    """
    scene, surface = problem.scene, problem.surface
    nodes = problem.nodes(x)
    materials = {name: _with_known(material) for name, material in scene.materials.items()}
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
    changed = replace(scene, materials=materials, effects=_tables(problem, x))
    if scalars:
        mesh = replace(scene.mesh, vertex_scalars={**scene.mesh.vertex_scalars, **scalars})
        changed = replace(changed, mesh=mesh, mesh_path=None)
        if folder is not None and mesh.materials == (DEFAULT_MATERIAL,):
            path = folder / "mesh.ply"
            write_ply(path, mesh.vertices, mesh.faces, mesh.vertex_scalars)
            changed = replace(changed, mesh_path=path.resolve())
    return changed


def _with_known(material: Material) -> Material:
    """The material with the values that its tolerances are about."""
    if not material.tolerance:
        return material
    stated = {key: getattr(material, key) for key in material.tolerance}
    numbers = {key: value[0] if isinstance(value, tuple) else value for key, value in stated.items()}
    known = {key: pinned(one, numbers[key]) for key, one in material.tolerance.items()}
    return material.model_copy(update={"tolerance": known})


def _tables(problem: FitProblem, x: np.ndarray) -> dict[str, dict[str, Any]]:
    """The tables `[effects.*]` with x in place, and with the values that their tolerances are about."""
    tables = problem.effect_tables(x)
    for name, table in tables.items():
        if "tolerance" in table:
            stated = problem.scene.effects[name]
            table["tolerance"] = {key: pinned(one, stated[key]) for key, one in table["tolerance"].items()}
    return tables
