"""`Scene`: a scene file and all that it names, checked when it is loaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar, overload

from warpsar.effects.registry import check
from warpsar.errors import InputError, shown
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.parameters.tree import Parameters, parameters_of
from warpsar.scene import checks
from warpsar.scene.beside import written_beside
from warpsar.scene.file import refuse
from warpsar.scene.loader import contents
from warpsar.scene.writer import save
from warpsar.world.sound_objects import misplaced
from warpsar.world.world import World

W = TypeVar("W", bound=World)


@dataclass(frozen=True, eq=False, repr=False)
class Scene(World):
    """A `World` that is read from a scene file and written to one, or made in memory.

    In memory: a `Mesh`, a `Radar`, a `Grid`, a `Material` or the name of a surface of the library for each material of
    the mesh, and a list of `View`, whose measured images may be arrays. Raises InputError, one message with everything
    that does not fit together.
    """

    def __repr__(self) -> str:
        curves = f", {len(self.curves)} curves" if self.curves else ""
        effects = f", effects {', '.join(self.effects)}" if self.effects else ""
        views = "1 view" if len(self.views) == 1 else f"{len(self.views)} views"
        return f"<Scene {self.name}: {views}{curves}, {len(self.mesh.faces)} triangles{effects}>"

    def __post_init__(self) -> None:
        where = self.path or Path(self.name)
        refuse(where, checks.kinds(self))
        named, problems, warnings = checks.with_surfaces(self.materials, self.radar, self.views)
        refuse(where, problems)
        object.__setattr__(self, "materials", named)
        object.__setattr__(self, "warnings", (*self.warnings, *warnings))
        object.__setattr__(self, "views", [checks.with_pixels(view) for view in self.views])
        names = list(self.materials)
        problems = [*checks.view_names(self.views), *checks.material_names(names, self.mesh, "the mesh")]
        for index, view in enumerate(self.views):
            key = f"views[{index}] ({view.name})"
            problems += checks.polarizations(key, view, self.radar.polarizations)
            problems += checks.pixels(key, view, self.grid)
        for name, material in self.materials.items():
            problems += checks.fields(name, material, self.mesh)
            problems += checks.models(name, material, self.radar, self.effects)
        refuse(where, problems)
        object.__setattr__(self, "materials", {name: named[name] for name in self.mesh.materials})

    @cached_property
    def parameters(self) -> Parameters[Parameter]:
        """Every number that can be learned, moved or diagnosed, under one dotted name."""
        return parameters_of(self)

    def with_values(self, values: Mapping[str, Any]) -> Scene:
        """The scene with other values of some parameters, by name; the rest stays.

        >>> turned = scene.with_values({"views.north.azimuth_deg": 26.2, "objects.car.position_m": (1.0, 3.0, 0.0)})

        Raises InputError for a name that is no parameter, and for a value that one may not have.
        """
        for name in values:
            if name not in self.parameters and name not in self.parameters.old_names:
                near = get_close_matches(name, self.parameters, 3) or list(self.parameters)[:3]
                raise InputError(
                    f"{name}: found no such parameter; must be one of Scene.parameters ({', '.join(near)}, ...)"
                )
        given = {self.parameters[name]: value for name, value in values.items()}
        return at(self, {parameter: parameter.checked(value) for parameter, value in given.items()})

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read and check a scene file, its mesh, images, masks and maps.

        Raises `InputError`, one message with everything that is wrong: in the file itself, or, where that is sound, in
        the files that it names.
        """
        scene = cls(**contents(_path(path)))
        check(scene)
        if scene.views:
            refuse(Path(scene.name), misplaced(scene))
        return scene

    def save(self, path: str | Path) -> None:
        """Write the scene file, atomically, with the comments of the one it was loaded from.

        Only what was stated or changed is written. File names become relative to the new place; the files stay where
        they are. What lies in memory is written beside the scene file and named after it. Beside `scene.toml` the mesh
        without `mesh_path` becomes `scene_mesh.obj`, or a PLY where a material has the layout "vertex". Images, masks
        and maps become float32 TIFF: `scene_<view>_<polarization>.tif`. Raises InputError for a mesh that neither
        format holds.
        """
        save(written_beside(self, _path(path)), _path(path))


def _path(given: object) -> Path:
    if not isinstance(given, str | PathLike):
        raise InputError(f"path: found {shown(given)}; must be the path of a scene file")
    return Path(given)


@overload
def scene_or_file(scene: W) -> W: ...


@overload
def scene_or_file(scene: PathLike[str] | str) -> Scene: ...


def scene_or_file(scene: World | PathLike[str] | str) -> World:
    """A scene itself, or that of a scene file. Raises InputError for what is neither, and as `Scene.load` does."""
    if isinstance(scene, World):
        return scene
    if isinstance(scene, str | PathLike):
        return Scene.load(Path(scene))
    raise InputError(f"scene: found {shown(scene)}; must be a warpsar.Scene, or the path of a scene file")
