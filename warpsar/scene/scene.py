"""`Scene`: a scene file and all that it names, checked when it is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from warpsar.effects.registry import check
from warpsar.scene import checks
from warpsar.scene.beside import written_beside
from warpsar.scene.file import refuse
from warpsar.scene.loader import contents
from warpsar.scene.writer import save
from warpsar.world.sound_objects import misplaced
from warpsar.world.world import World


@dataclass(frozen=True, eq=False)
class Scene(World):
    """A `World` that is read from a scene file and written to one, or made in memory.

    In memory: a `Mesh`, a `Radar`, a `Grid`, a `Material` for each of the mesh's, and a list of `View`, whose measured
    images may be arrays. Raises InputError, one message with everything that does not fit together.
    """

    def __post_init__(self) -> None:
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
        refuse(Path(self.name), problems)
        object.__setattr__(self, "materials", {name: self.materials[name] for name in self.mesh.materials})

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read and check a scene file, its mesh, images, masks and maps.

        Raises `InputError`, one message with everything that is wrong: in the file itself, or, where that is sound, in
        the files that it names.
        """
        scene = cls(**contents(Path(path)))
        check(scene)
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
        save(written_beside(self, Path(path)), Path(path))
