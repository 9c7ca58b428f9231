"""Objects placed in a scene that is in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from warpsar.scene.file import refuse
from warpsar.world.mesh import Mesh, read_mesh
from warpsar.world.objects.assembly import Assembly
from warpsar.world.objects.groups import with_groups
from warpsar.world.objects.table import Object
from warpsar.world.sound_objects import doubled
from warpsar.world.tables import Material
from warpsar.world.world import World

W = TypeVar("W", bound=World)


def with_objects(scene: W, objects: Sequence[Object], materials: Mapping[str, Material] | None = None) -> W:
    """The scene's own mesh with these objects, in place of those that it had.

    `materials` are those that the objects bring along. Raises InputError for a group that the mesh does not have, for
    objects that are the same twice, and for materials that do not fit.
    """
    refuse(Path(scene.name), doubled(objects))
    base = scene.mesh if scene.assembly is None else scene.assembly.base
    bodies: dict[Path, Mesh] = {} if scene.assembly is None else dict(scene.assembly.bodies)
    for one in objects:
        if one.mesh is not None and one.mesh not in bodies:
            bodies[one.mesh] = read_mesh(one.mesh)
    wanted = [one.group for one in objects if one.group is not None]
    if base is not None and wanted:
        base = with_groups(base, scene.mesh_path, wanted)
    assembly = Assembly.of(base, objects, bodies)
    known = {**scene.materials, **(materials or {})}
    mesh = assembly.mesh(objects)
    used = {name: known[name] for name in mesh.materials if name in known}
    return replace(scene, objects=tuple(objects), assembly=assembly, mesh=mesh, materials=used)
