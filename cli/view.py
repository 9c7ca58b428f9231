"""`warpsar view`: a scene in 3D in a browser."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="view", short_help="Show a scene, its images and residuals in 3D in a browser.")
@click.argument("scene", type=click.Path(exists=True, path_type=Path))
@options.out("Folder for view.html; made if missing.")
@click.option(
    "--before",
    type=click.Path(exists=True, path_type=Path),
    help="A scene to compare with, such as the one before learn or diagnose.",
)
@click.option(
    "--scatterers",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="A VIEW_scatterers.csv of simulate --scatterers: its places are shown as points, by their RCS.",
)
@options.device
def command(scene: Path, out: Path, before: Path | None, scatterers: Path | None, device: str | None) -> None:
    """Show SCENE in 3D in a browser: its mesh, the views, and the surfaces that each view lights.

    SCENE is a scene file, or the folder that learn or diagnose wrote. The page is one file and fetches nothing.
    Measured images, the model's and their residual are laid on the surface that reflects them.

    \b
    Examples:
      warpsar view scene.toml -o shown/
      warpsar view learned/ --before scene.toml -o shown/
      warpsar view scene.toml --scatterers out/az030_scatterers.csv -o shown/
    """
    from warpsar.viewer.command import run

    click.echo(run(scene, out, before=before, scatterers=scatterers, device=device))
