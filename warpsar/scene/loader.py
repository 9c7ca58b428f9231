"""The files that a scene file names, read and checked."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.io.images import read_channel, read_mask
from warpsar.scene import checks
from warpsar.scene.file import SceneFile, beside_the_radar, parse, parse_effects, read, refuse
from warpsar.world.collection import RENAMED, Collection
from warpsar.world.curve import Curve
from warpsar.world.library.fill import beyond, named
from warpsar.world.mesh import Mesh, read_mesh
from warpsar.world.objects.assembly import Assembly
from warpsar.world.objects.groups import with_groups
from warpsar.world.objects.poses import posed
from warpsar.world.objects.table import Object
from warpsar.world.sound_objects import doubled
from warpsar.world.tables import (
    SURFACE_KEYS,
    Material,
    View,
)
from warpsar.world.upright import y_up
from warpsar.world.world import NO_IMAGE

FEW_PIXELS = 3.0  # across a body: what is smaller has no shape in an image


def contents(path: Path) -> dict[str, Any]:
    """The fields of the `World` that a scene file describes. Raises InputError.

    Every effect is checked by itself; whether effects go together is not checked here.
    """
    text, raw = read(path)
    path = path.parent.resolve() / path.name
    file, problems = parse(raw)
    effects = parse_effects(raw, problems)
    refuse(path, problems)
    assert file is not None
    return _Loader(path, text, file, effects).contents()


class _Loader:
    """Reads what a sound `SceneFile` names, and collects everything that is wrong with it."""

    def __init__(self, path: Path, text: str, file: SceneFile, effects: dict[str, dict[str, Any]]) -> None:
        self.path, self.text, self.file, self.effects = path, text, file, effects
        self.grid = file.image or NO_IMAGE
        self.problems: list[str] = []
        self.warnings: list[str] = []

    def contents(self) -> dict[str, Any]:
        file = self.file
        mesh_path = None if file.scene.mesh is None else self.absolute(file.scene.mesh)
        mesh = None if mesh_path is None else self.mesh("scene.mesh", mesh_path)
        warned = [] if mesh is None else [f"{mesh_path}: {warning}" for warning in mesh.warnings]
        objects = [each for index, one in enumerate(file.objects) for each in self.posed(index, self.object(one))]
        objects, stated, self.effects, problems = with_own_materials(objects, file.materials, self.effects)
        self.problems += problems
        assembly = self.assembly(mesh, mesh_path, objects) if objects and not self.problems else None
        mesh = mesh if assembly is None else assembly.mesh(objects)
        if assembly is not None:
            self.warnings += self.sizes(assembly, objects)
        views = [self.view(index, view) for index, view in enumerate(file.views)]
        found = [self.curve(index, curve, mesh) for index, curve in enumerate(file.curves)]
        self.problems += checks.view_names(views)
        frequency_hz = file.radar.frequency_hz
        unstated = [] if mesh is None else [name for name in mesh.materials if name not in stated]
        of_library = named(unstated, frequency_hz)
        self.problems += beside_the_radar(file, {name: name for name in of_library})
        tables = {**stated, **of_library}
        materials = {name: self.material(name, table, mesh) for name, table in tables.items()}
        self.warnings += [w for name, table in tables.items() if (w := beyond(name, table, frequency_hz))]
        if mesh is not None:
            where = f"the mesh {mesh_path}" if assembly is None else "the mesh and the objects"
            self.problems += checks.material_names(list(materials), mesh, where)
        collection = self.collection(file.collection, [one.label for one in objects])
        refuse(self.path, self.problems)
        assert mesh is not None
        return {
            "mesh": mesh,
            "radar": file.radar,
            "grid": self.grid,
            "materials": {name: materials[name] for name in mesh.materials},
            "views": views,
            "sampling": file.sampling,
            "effects": self.effects,
            "reference_point_m": file.scene.reference_point_m,
            "accuracy_m": file.scene.accuracy_m,
            "origin": file.scene.origin,
            "path": self.path,
            "mesh_path": mesh_path,
            "warnings": (*warned, *self.warnings),
            "source": self.text,
            "objects": tuple(objects),
            "assembly": assembly,
            "curves": tuple(found),
            "collection": collection,
        }

    def mesh(self, key: str, path: Path) -> Mesh | None:
        try:
            return read_mesh(path)
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return None

    def object(self, one: Object) -> Object:
        return one if one.mesh is None else one.model_copy(update={"mesh": self.absolute(one.mesh)})

    def posed(self, index: int, one: Object) -> list[Object]:
        """The object itself, or all that its file of poses places."""
        if one.poses is None:
            return [one]
        try:
            return posed(one, self.absolute(one.poses))
        except InputError as error:
            self.problems += [f"objects[{index}] ({one.label}).poses: {line}" for line in str(error).splitlines()]
            return []

    def assembly(self, mesh: Mesh | None, path: Path | None, objects: list[Object]) -> Assembly | None:
        """The scene's mesh and its objects. The mesh of several objects is read once."""
        self.problems += doubled(objects)
        bodies: dict[Path, Mesh] = {}
        upright: dict[Path, str | None] = {}
        for index, one in enumerate(objects):
            if one.mesh is not None and one.mesh not in bodies:
                found = self.mesh(f"objects[{index}] ({one.label}).mesh", one.mesh)
                bodies |= {} if found is None else {one.mesh: found}
            if one.mesh in bodies and one.up == "+Z" and one.mesh not in upright:
                body = bodies[one.mesh]
                upright[one.mesh] = y_up(body.vertices, body.faces)
                if upright[one.mesh] is not None:
                    key = f"objects[{index}] ({one.label}).mesh: {one.mesh}"
                    self.warnings.append(f'{key}: {upright[one.mesh]}; up = "+Y" with front = "+Z" turns it')
        if self.problems:
            return None
        try:
            groups = [one.group for one in objects if one.group is not None]
            base = with_groups(mesh, path, groups) if groups and mesh is not None else mesh
            return Assembly.of(base, objects, bodies)
        except InputError as error:
            self.problems.append(str(error))
            return None

    def absolute(self, name: str | Path) -> Path:
        path = self.path.parent / name
        return Path(os.path.realpath(path.parent)) / path.name

    def sizes(self, assembly: Assembly, objects: Sequence[Object]) -> list[str]:
        """Of bodies whose scale is sought: the doubt that one is in another unit, where no image could show it."""
        if self.file.image is None:
            return []
        image_m = max(n * step for n, step in zip(self.grid.shape, self.grid.spacing_m, strict=True))
        found = []
        for index, one in enumerate(objects):
            if one.mesh is None or "scale" not in one.learn:
                continue
            extent_m = float(np.ptp(assembly.vertices_of(one), axis=0).max())
            if not FEW_PIXELS * max(self.grid.spacing_m) < extent_m < image_m:
                found.append(
                    f"objects[{index}] ({one.label}).mesh: {extent_m:.3g} m across in units of {one.units!r}, and an "
                    f"image shows {image_m:.3g} m: check units and scale"
                )
        return found

    def view(self, index: int, view: View) -> View:
        key = f"views[{index}] ({view.name})"
        images = {polarization: self.absolute(name) for polarization, name in view.images.items()}
        self.problems += checks.polarizations(key, view, self.file.radar.polarizations)
        for polarization, path in images.items():
            self.check_image(f"{key}.images.{polarization}", path, polarization)
        changed: dict[str, Any] = {"images": images} if images else {}
        if view.slc:
            changed["slc"] = {polarization: self.absolute(name) for polarization, name in view.slc.items()}
            for polarization, path in changed["slc"].items():
                if not path.is_file():
                    self.problems.append(f"{key}.slc.{polarization}: found {path}; there is no such file")
        if view.mask is not None:
            changed["mask"] = self.absolute(view.mask)
            self.check_mask(f"{key}.mask", changed["mask"])
        return view.model_copy(update=changed)

    def collection(self, table: Collection | None, labels: list[str]) -> Collection | None:
        """The table with its file's place; movers must be objects."""
        if table is None:
            return None
        self.problems += checks.declared_twice(self.effects, table)
        for key in table.old_keys:
            message = f"{self.path}: collection.{key}: is [{RENAMED[key]}] now, which acts on images of power, too"
            warnings.warn(message, FutureWarning, stacklevel=2)
        for name in table.velocity_m_s:
            if name not in labels:
                known = ", ".join(labels) or "none"
                self.problems.append(f"collection.velocity_m_s: found {name!r}; must name one of [[objects]] ({known})")
        table = table.with_files(self.absolute)
        for key, path in table.files.items():
            if not path.is_file():
                self.problems.append(f"collection.{key}: found {path}; there is no such file")
        return table

    def curve(self, index: int, curve: Curve, of_scene: Mesh | None) -> Curve:
        """The curve with its file's place; what does not fit the file or the radar is a problem."""
        key, path = f"curves[{index}]", self.absolute(curve.file)
        mesh = None if curve.mesh is None else self.absolute(curve.mesh)
        curve = curve.model_copy(update={"file": path, "mesh": mesh})
        body = None if mesh is None else self.mesh(f"{key}.mesh", mesh)
        known_names = () if of_scene is None else of_scene.materials
        for name in sorted(set(() if body is None else body.materials) - set(known_names)):
            allowed = f"must be one of the scene's mesh, {', '.join(known_names) or 'which has none'}"
            self.problems.append(f"{key}.mesh: {mesh}: found the material {name!r}; {allowed}")
        try:
            rows = curve.rows()
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return curve
        pol, known = rows.polarization[0], self.file.radar.polarizations
        if pol not in known:
            self.problems.append(f"{key}: {path}: found {pol}; must be one of radar.polarizations, {', '.join(known)}")
        used = rows.used(curve.mask)
        if not used.any():
            self.problems.append(f"{key}.mask: {path}: leaves no row; must leave one or more")
        elif missing := int((~np.isfinite(rows.rcs_m2)).sum()):
            self.warnings.append(f"{key}: {missing} of {rows.rcs_m2.size} rows are no number and left out")
        return curve

    def check_image(self, key: str, path: Path, polarization: str) -> None:
        try:
            image = read_channel(path, polarization, shape=self.grid.shape)
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
            mask = read_mask(path, shape=self.grid.shape)
        except InputError as error:
            self.problems.append(f"{key}: {error}")
            return
        if not mask.any():
            self.problems.append(f"{key}: {path}: every pixel is 0; must be nonzero where pixels are used")

    def material(self, name: str, material: Material, mesh: Mesh | None) -> Material:
        """Check the fields that a material names; names of textures become absolute paths."""
        changed: dict[str, Any] = {}
        if mesh is not None:
            self.problems += checks.fields(name, material, mesh)
        if material.sigma0 is not None:
            changed["sigma0"] = self.absolute(material.sigma0)
        if material.learned_term is not None:
            changed["learned_term"] = self.absolute(material.learned_term)
        for key in SURFACE_KEYS if material.layout == "texture" else ():
            value = getattr(material, key)
            if not isinstance(value, str):
                continue
            path, where = self.absolute(value), f"materials.{name}.{key}"
            changed[key] = str(path)
            try:
                self.problems += checks.values(f"{where}: {path}", key, read_channel(path, key))
            except InputError as error:
                self.problems.append(f"{where}: {error}")
        found = material.model_copy(update=changed) if changed else material
        self.problems += checks.models(name, found, self.file.radar, self.effects)
        return found


def with_own_materials(
    objects: Sequence[Object], materials: Mapping[str, Material], effects: Mapping[str, Mapping[str, Any]]
) -> tuple[list[Object], dict[str, Material], dict[str, dict[str, Any]], list[str]]:
    """Objects with `own_material` have one that is called as they are, and begins as the one that they state.

    Effects that name the stated one name the own ones beside it, with the same numbers. A material that no object
    states any longer is left out. Also returns what is wrong with names.
    """
    given, problems = dict(materials), []
    owns: dict[str, list[str]] = {}
    for index, one in enumerate(objects):
        if not one.own_material or one.material is None or one.material not in materials:
            continue
        if one.label in materials:
            message = f"found a material {one.label!r} in the file; must have another name, or no own_material"
            problems.append(f"objects[{index}] ({one.label}).own_material: {message}")
        given[one.label] = materials[one.material]
        owns.setdefault(one.material, []).append(one.label)
    found = [_with_its_own(one) if one.own_material else one for one in objects]
    left = set(owns) - {one.material for one in found}
    tables = {name: _with_names(name, table, owns, left) for name, table in effects.items()}
    return found, {name: one for name, one in given.items() if name not in left}, tables, problems


def _with_its_own(one: Object) -> Object:
    stated = one.model_dump(mode="python", exclude_unset=True, exclude={"own_material"}, warnings=False)
    return Object.model_validate({**stated, "material": one.label})


def _with_names(
    effect: str, table: Mapping[str, Any], owns: Mapping[str, Sequence[str]], left: set[str]
) -> dict[str, Any]:
    """An effect's table with own materials wherever it names the one that they began as."""
    found = dict(table)
    for key in ("materials", *(p.name for p in get(effect).parameters if p.per_material)):
        stated = table.get(key)
        if isinstance(stated, Mapping):
            more = {own: stated[name] for name in stated for own in owns.get(name, ())}
            found[key] = {name: value for name, value in {**stated, **more}.items() if name not in left}
        elif stated:
            names = [own for name in stated for own in (name, *owns.get(name, ()))]
            found[key] = [name for name in names if name not in left]
    return found
