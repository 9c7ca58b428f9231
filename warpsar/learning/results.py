"""What was learned, as a scene that simulates with it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.io.images import write_exr
from warpsar.io.ply import write_ply
from warpsar.learning.problem import FitProblem
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.world.mesh import DEFAULT_MATERIAL
from warpsar.world.tables import Material
from warpsar.world.tolerance import pinned


def learned_scene(problem: FitProblem, x: np.ndarray, folder: Path | None = None) -> Scene:
    """The problem's scene with x in place of its start; save it with `Scene.save`.

    Parameter maps (EXR) and, for vertex layouts, the mesh with its scalars (PLY) are written into `folder`. Without a
    folder the fields lie in memory, and so do those of a mesh with names that a PLY cannot hold.

    A tolerance stays about the value that was declared: a fit of this scene would else count the images twice.
    """
    scene, surface = problem.scene, problem.surface
    nodes, found = problem.nodes(x), dict[Parameter, Any]()
    for block in surface.blocks:
        if not block.learn:
            continue
        parameter = scene.parameters[f"materials.{block.material}.{block.kind.key}"]
        values = surface.values(block.material, block.kind.key, nodes)
        if block.layout == "vertex":
            found[parameter] = parameter.value
            found[parameter][parameter.used] = values
        else:
            found[parameter] = values if block.layout == "texture" else values[0]
    changed = at(scene, found)
    materials = {name: _with_known(scene.materials[name], material) for name, material in changed.materials.items()}
    vertex = any(parameter.layout == "vertex" for parameter in found)
    if folder is not None:
        maps = [parameter for parameter in found if parameter.layout == "texture"]
        for parameter in maps:
            name, key = parameter.owner, parameter.key
            path = folder / f"{file_stem(surface.materials, name, key)}.exr"
            write_exr(path, {key: found[parameter].astype(np.float32)})
            materials[name] = materials[name].model_copy(update={key: str(path.resolve())})
    changed = replace(changed, materials=materials, effects=_tables(problem, x))
    if vertex:
        mesh = changed.mesh
        changed = replace(changed, mesh_path=None)
        if folder is not None and mesh.materials == (DEFAULT_MATERIAL,):
            path = folder / "mesh.ply"
            write_ply(path, mesh.vertices, mesh.faces, mesh.vertex_scalars)
            changed = replace(changed, mesh_path=path.resolve())
    return changed


def _with_known(declared: Material, material: Material) -> Material:
    """The material with the values that its tolerances are about, which are those that were `declared`."""
    if not material.tolerance:
        return material
    stated = {key: getattr(declared, key) for key in material.tolerance}
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
