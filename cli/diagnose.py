"""`warpsar diagnose`: the effects that the measured images show and the scene does not declare."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="diagnose", short_help="Name the effects that the model lacks, and add them.")
@click.argument("scene", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for diagnosis.json, scene.toml with the effects that were found, and report.html; made if missing.",
)
@options.device
@click.option(
    "--family-error",
    type=click.FloatRange(min=0, max=1, min_open=True, max_open=True),
    default=0.01,
    show_default=True,
    help="Chance of any false alarm each time that effects are tested.",
)
@click.option("--draws", type=click.IntRange(min=1), default=1000, show_default=True, help="Draws of the bootstrap.")
@click.option("--starts", type=click.IntRange(min=0), default=2, show_default=True, help="Further starts of every fit.")
@click.option(
    "--most-effects",
    type=click.IntRange(min=0),
    default=15,
    show_default=True,
    help="Effects that may be added, at most; 15: all there are.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the bootstrap and the starts."
)
@options.resume
def command(
    scene: Path,
    out: Path,
    device: str | None,
    family_error: float,
    draws: int,
    starts: int,
    most_effects: int,
    seed: int,
    resume: bool,
) -> None:
    """Fit SCENE to its train views, find the effect that its model lacks, add it and fit again.

    Views with the role test decide nothing. The error on them is reported before and after.

    \b
    Examples:
      warpsar diagnose scene.toml -o diagnosed/
      warpsar diagnose scene.toml -o diagnosed/ --resume
    """
    from warpsar.diagnosis import command as diagnosis
    from warpsar.diagnosis.found import DiagnoseOptions

    chosen = DiagnoseOptions(
        family_error=family_error, draws=draws, starts=starts, most_effects=most_effects, seed=seed
    )
    with options.resumable(out):
        diagnosis.run(scene, out, device=device, options=chosen, resume=resume)
