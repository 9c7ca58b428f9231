"""`warpsar uv`: texture coordinates for a mesh that has none, so that it can hold textures."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="uv", short_help="Give a mesh texture coordinates.")
@options.scene
@options.out("Folder for mesh.obj with UV, and for a scene.toml that names it; made if missing.")
def command(scene: Path, out: Path) -> None:
    """Give the mesh of SCENE texture coordinates, a square for each material (needs the extra `uv`).

    \b
    Example:
      warpsar uv scene.toml -o with_uv/
    """
    from warpsar.scene import unwrap

    unwrap.run(scene, out)
