"""What of a scene lies in memory, written beside its scene file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from warpsar.errors import InputError
from warpsar.io.images import write_tiff
from warpsar.io.ply import write_ply
from warpsar.world.obj import write_obj
from warpsar.world.pixels import Pixels
from warpsar.world.tables import SURFACE_KEYS, Material, View
from warpsar.world.world import World

W = TypeVar("W", bound=World)


def written_beside(scene: W, path: Path) -> W:
    """The scene with files in place of arrays, which are written into the folder of the scene file `path`."""
    stem = path.parent.resolve() / path.stem

    def file(pixels: Any, name: str) -> Any:
        if not isinstance(pixels, Pixels):
            return pixels
        place = stem.with_name(f"{stem.name}_{name}.tif")
        write_tiff(place, pixels.values)
        return place

    def view(one: View) -> View:
        images = {name: file(image, f"{one.name}_{name}") for name, image in one.images.items()}
        changed = {"images": images, "mask": file(one.mask, f"{one.name}_mask")}
        return one.model_copy(update={key: value for key, value in changed.items() if value})

    def material(name: str, one: Material) -> Material:
        maps = {key: getattr(one, key) for key in SURFACE_KEYS}
        found: dict[str, Any] = {
            key: str(file(value, file_stem(scene.mesh.materials, name, key)))
            for key, value in maps.items()
            if isinstance(value, Pixels)
        }
        return one.model_copy(update=found)

    return replace(
        scene,
        mesh_path=scene.mesh_path or _written_mesh(scene, stem),
        materials={name: material(name, one) for name, one in scene.materials.items()},
        views=[view(one) for one in scene.views],
    )


def file_stem(materials: Sequence[str], material: str, key: str) -> str:
    """Name of a material's map: a mesh's names may hold what a file's may not."""
    safe = re.sub(r"[^\w.+-]", "_", material)
    return f"{safe}_{key}" if safe == material else f"{safe}_{materials.index(material)}_{key}"


def _written_mesh(scene: World, stem: Path) -> Path | None:
    """An OBJ holds names and UV, a PLY scalars; no format that is read here holds both.

    Of a scene with objects only its own mesh is written; None where it has none.
    """
    if scene.assembly is not None and scene.assembly.base is None:
        return None
    mesh = scene.mesh if scene.assembly is None else scene.assembly.base
    assert mesh is not None
    if not any(material.layout == "vertex" for material in scene.materials.values()):
        path = stem.with_name(f"{stem.name}_mesh.obj")
        write_obj(path, mesh)
        return path
    if mesh.uv is not None or mesh.materials != ("default",):
        raise InputError(
            f'{stem.name}: found the layout "vertex" in a mesh with the materials {", ".join(mesh.materials)}'
            f"{' and UV' if mesh.uv is not None else ''}; a mesh with vertex scalars is saved as PLY, which holds one "
            f'material, "default", and no UV. Allowed are that, or the layouts "uniform" and "texture"'
        )
    path = stem.with_name(f"{stem.name}_mesh.ply")
    write_ply(path, mesh.vertices, mesh.faces, mesh.vertex_scalars)
    return path
