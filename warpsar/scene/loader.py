"""What a scene file refers to, read and checked."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io.images import read_channel, read_mask
from warpsar.scene.file import SceneFile, parse, parse_effects, read, refuse
from warpsar.world.mesh import Mesh, read_mesh
from warpsar.world.tables import (
    SURFACE_KEYS,
    Material,
    View,
    allowed_values,
    within,
)


def contents(path: Path) -> dict[str, Any]:
    """The fields of the `World` that a scene file describes. Effects are checked each by itself. Raises InputError."""
    text, raw = read(path)
    path = path.parent.resolve() / path.name
    file, problems = parse(raw)
    effects = parse_effects(raw, problems)
    refuse(path, problems)
    assert file is not None
    return _Loader(path, text, file, effects).contents()


def _has_uv(mesh: Mesh, corners: NDArray[np.int32]) -> bool:
    return mesh.uv is not None and not np.isnan(mesh.uv[corners]).any()


class _Loader:
    """What a sound `SceneFile` refers to; collects everything that is wrong with the files it names."""

    def __init__(self, path: Path, text: str, file: SceneFile, effects: dict[str, dict[str, Any]]) -> None:
        self.path, self.text, self.file, self.effects = path, text, file, effects
        self.problems: list[str] = []
        self.warnings: list[str] = []

    def contents(self) -> dict[str, Any]:
        file = self.file
        mesh_path = self.absolute(file.scene.mesh)
        mesh: Mesh | None = None
        try:
            mesh = read_mesh(mesh_path)
        except InputError as error:
            self.problems.append(f"scene.mesh: {error}")
        views = [self.view(index, view) for index, view in enumerate(file.views)]
        self.unique_names(views)
        materials = {name: self.material(name, table, mesh) for name, table in file.materials.items()}
        if mesh is not None and set(materials) != set(mesh.materials):
            self.problems.append(
                f"materials: found {', '.join(materials)}; must be those of the mesh {mesh_path}: "
                f"{', '.join(mesh.materials)}"
            )
        refuse(self.path, self.problems)
        assert mesh is not None
        return {
            "mesh": mesh,
            "radar": file.radar,
            "grid": file.image,
            "materials": {name: materials[name] for name in mesh.materials},
            "views": views,
            "sampling": file.sampling,
            "effects": self.effects,
            "reference_point_m": file.scene.reference_point_m,
            "origin": file.scene.origin,
            "path": self.path,
            "mesh_path": mesh_path,
            "warnings": (*(f"{mesh_path}: {warning}" for warning in mesh.warnings), *self.warnings),
            "source": self.text,
        }

    def absolute(self, name: str | Path) -> Path:
        path = self.path.parent / name
        return Path(os.path.realpath(path.parent)) / path.name

    def unique_names(self, views: list[View]) -> None:
        # Files are named after views, and file systems may not tell upper from lower case.
        seen: dict[str, int] = {}
        for index, view in enumerate(views):
            first = seen.setdefault(view.name.casefold(), index)
            if first != index:
                self.problems.append(
                    f"views[{index}].name: found {view.name!r} again; must differ from views[{first}]'s"
                )

    def view(self, index: int, view: View) -> View:
        key = f"views[{index}] ({view.name})"
        images = {polarization: self.absolute(name) for polarization, name in view.images.items()}
        for polarization, path in images.items():
            if polarization not in self.file.radar.polarizations:
                self.problems.append(
                    f"{key}.images: found {polarization}; must be one of radar.polarizations, "
                    f"{', '.join(self.file.radar.polarizations)}"
                )
            self.check_image(f"{key}.images.{polarization}", path, polarization)
        changed: dict[str, Any] = {"images": images} if images else {}
        if view.mask is not None:
            changed["mask"] = self.absolute(view.mask)
            self.check_mask(f"{key}.mask", changed["mask"])
        return view.model_copy(update=changed)

    def check_image(self, key: str, path: Path, polarization: str) -> None:
        try:
            image = read_channel(path, polarization, shape=self.file.image.shape)
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return
        finite = np.isfinite(image)
        missing, negative = int(image.size - finite.sum()), finite & (image < 0)
        if missing == image.size:
            self.problems.append(f"{key}: {path}: every pixel is NaN or infinite; must be linear power")
        elif negative.any():
            self.problems.append(
                f"{key}: {path}: {int(negative.sum())} pixels are negative "
                f"(down to {float(image[negative].min()):g}); must be linear power, 0 or more"
            )
        elif missing:
            self.warnings.append(f"{key}: {missing} of {image.size} pixels are NaN or infinite and masked")

    def check_mask(self, key: str, path: Path) -> None:
        try:
            mask = read_mask(path, shape=self.file.image.shape)
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return
        if not mask.any():
            self.problems.append(f"{key}: {path}: every pixel is 0; must be nonzero where pixels are used")

    def material(self, name: str, material: Material, mesh: Mesh | None) -> Material:
        """Check what the names in a material stand for; a texture's become absolute paths."""
        key = f"materials.{name}"
        changed: dict[str, Any] = {}
        corners = np.zeros(0, np.int32)
        if mesh is not None and name in mesh.materials:
            corners = mesh.faces[mesh.face_material == mesh.materials.index(name)]
        if material.layout == "texture" and mesh is not None and not _has_uv(mesh, corners):
            self.problems.append(f'{key}.layout: found "texture"; its faces must have UV in the mesh')
        for field_key in SURFACE_KEYS:
            value = getattr(material, field_key)
            if not isinstance(value, str):
                continue
            where = f"{key}.{field_key}"
            if material.layout == "texture":
                path = self.absolute(value)
                changed[field_key] = str(path)
                try:
                    self.check_values(f"{where}: {path}", field_key, read_channel(path, field_key))
                except InputError as error:
                    self.problems.append(f"{where}: {error}")
            elif mesh is not None:
                if value in mesh.vertex_scalars:
                    values = mesh.vertex_scalars[value][np.unique(corners)]
                    self.check_values(f"{where}: scalar {value!r}", field_key, values)
                else:
                    known = ", ".join(mesh.vertex_scalars) or "it has none"
                    self.problems.append(f"{where}: found {value!r}; must be a vertex scalar of the mesh ({known})")
        return material.model_copy(update=changed)

    def check_values(self, where: str, key: str, values: NDArray[Any]) -> None:
        bad = ~within(key, values)  # NaN is within nothing
        if bad.any():
            self.problems.append(
                f"{where}: {int(bad.sum())} of {values.size} values are out of range "
                f"(one is {float(values[bad][0]):g}); each must be {allowed_values(key)}"
            )
