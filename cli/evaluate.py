"""`warpsar evaluate`: how well a scene explains its measured images."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="evaluate", short_help="Compare model and measured images, in a report.")
@options.scene
@options.out("Folder for evaluate.json, report.html, residual images and learned.ply; made if missing.")
@click.option(
    "--before",
    type=options.SCENE,
    help="Another scene file of the same images: the report shows that model's numbers and residuals beside SCENE's.",
)
@options.device
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the rays' jitter. Default: the scene's own.")
def command(scene: Path, out: Path, before: Path | None, device: str | None, seed: int | None) -> None:
    """Compare the measured images of SCENE, of train and test views, with the images of its model.

    \b
    Examples:
      warpsar evaluate scene.toml -o evaluated/
      warpsar evaluate learned/scene.toml --before scene.toml -o evaluated/
    """
    from warpsar.evaluation.command import run

    run(scene, out, before=before, device=device, seed=seed)
