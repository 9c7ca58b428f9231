"""`Scene`: a scene file and all that it names, checked when it is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from warpsar.effects.registry import check
from warpsar.scene.loader import contents
from warpsar.scene.writer import save
from warpsar.world.world import World


@dataclass(frozen=True, eq=False)
class Scene(World):
    """A `World` that is read from a scene file and written to one."""

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read and check a scene file, its mesh, images, masks and maps.

        Raises `InputError`, one message with everything that is wrong: in the file itself, or, where that is sound, in
        the files that it names.
        """
        scene = cls(**contents(Path(path)))
        check(scene)
        return scene

    def save(self, path: str | Path) -> None:
        """Write the scene file, atomically, with the comments of the one it was loaded from.

        Only what was stated or changed is written. File names become relative to the new place; the files stay where
        they are. Needs `mesh_path`.
        """
        save(self, Path(path))
