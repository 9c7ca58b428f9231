"""`warpsar uv`: a scene whose mesh has no UV in, one that can hold textures out."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="uv")
@click.argument("scene", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for mesh.obj with UV and a scene.toml that refers to it; made if missing.",
)
def command(scene: Path, out: Path) -> None:
    """Give the mesh of SCENE texture coordinates (extra `uv`), each material its own square."""
    from warpsar.scene import unwrap

    unwrap.run(scene, out)
