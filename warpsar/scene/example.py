"""`warpsar new --example`: the scene of the first pages, for whoever has no mesh at hand."""

from __future__ import annotations

import shutil
from pathlib import Path

from warpsar.errors import InputError

EXAMPLE = Path(__file__).parent / "assets" / "example"  # in a checkout a link to data/example
SCENE = "scene.toml"


def copy_example(folder: Path | str, *, force: bool = False) -> Path:
    """Copy the example scene, its mesh and its material file into `folder`, which is made if missing.

    Returns the path of the scene file. Raises InputError where one of the files is there and `force` is false.
    """
    folder = Path(folder)
    names = sorted(path.name for path in EXAMPLE.iterdir())
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        raise InputError(f"{folder / there[0]}: found a file there already; --force replaces it")
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        shutil.copyfile(EXAMPLE / name, folder / name)
    return folder / SCENE
