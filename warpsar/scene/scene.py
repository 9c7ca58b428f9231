"""The scene file and all that it refers to, checked once, at the door."""

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

        Raises `InputError`, one message with everything that is wrong: first of the file itself, and, where
        that is sound, of all that it refers to.
        """
        scene = cls(**contents(Path(path)))
        check(scene)
        return scene

    def save(self, path: str | Path) -> None:
        """Write the scene file, atomically, with the comments of the one it was loaded from.

        Only what was stated or changed is written. File names are relative to the new place and the files
        stay where they are. Needs `mesh_path`.
        """
        save(self, Path(path))
