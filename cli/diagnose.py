"""`warpsar diagnose`: the effects that the measured images show and the scene does not declare."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="diagnose", short_help="Name the effects that the model lacks, and add them.")
@options.scene
@options.out("Folder for diagnosis.json, report.html, and scene.toml with the named effects; made if missing.")
@options.device
@click.option(
    "--family-error",
    type=click.FloatRange(min=0, max=1, min_open=True, max_open=True),
    default=0.01,
    show_default=True,
    help="Chance of any false alarm each time that effects are tested.",
)
@click.option(
    "--draws",
    type=click.IntRange(min=1),
    default=1000,
    show_default=True,
    help="Most draws of speckle for the scores of a turn.",
)
@click.option("--starts", type=click.IntRange(min=0), default=2, show_default=True, help="Further starts of every fit.")
@click.option(
    "--most-effects",
    type=click.IntRange(min=0),
    show_default="all there are",
    help="Effects that may be added, at most.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the bootstrap and the starts."
)
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    metavar="MINUTES",
    help="End the search after this time with the best verdict so far, and list the open questions; --resume goes on.",
)
@click.option(
    "--folds",
    type=click.IntRange(min=2),
    metavar="N",
    help="Judge by train views that are left out, in N parts, each of arcs of azimuth, in place of tests of speckle: "
    "for many views of one target. On curves, also hold back the train frequencies in N parts.",
)
@options.resume
def command(
    scene: Path,
    out: Path,
    device: str | None,
    family_error: float,
    draws: int,
    starts: int,
    most_effects: int | None,
    seed: int,
    time_limit: float | None,
    folds: int | None,
    resume: bool,
) -> None:
    """Fit SCENE to its train views, find the effect that its model lacks, add it and fit again.

    No fit uses the views with the role test. The error on them is reported before and after.

    Exit status: 0 if only speckle is left, 4 if a part of the residual has no explanation.

    \b
    Examples:
      warpsar diagnose scene.toml -o diagnosed/
      warpsar diagnose scene.toml -o diagnosed/ --time-limit 10
      warpsar diagnose scene.toml -o diagnosed/ --resume
      warpsar diagnose scene.toml -o diagnosed/ --folds 3
    """
    from warpsar.diagnosis import command as diagnosis

    if folds is not None:
        of_tests = ("family_error", "draws", "starts", "most_effects", "seed")
        _refuse(of_tests, "--folds")
        from warpsar.diagnosis.held_out import command as held_out

        limit_s = None if time_limit is None else 60.0 * time_limit
        with options.resumable(out):
            content = held_out.run(scene, out, folds=folds, device=device, time_limit_s=limit_s, resume=resume)
        if content.get("unexplained"):
            click.get_current_context().exit(diagnosis.UNEXPLAINED)
        return
    from warpsar.diagnosis.found import DiagnoseOptions

    chosen = DiagnoseOptions(
        family_error=family_error,
        draws=draws,
        starts=starts,
        seed=seed,
        time_limit_s=None if time_limit is None else 60.0 * time_limit,
    )
    if most_effects is not None:
        chosen = replace(chosen, most_effects=most_effects)
    with options.resumable(out):
        content = diagnosis.run(scene, out, device=device, options=chosen, resume=resume)
    if content.get("unexplained"):
        click.get_current_context().exit(diagnosis.UNEXPLAINED)


def _refuse(names: tuple[str, ...], beside: str) -> None:
    """Raise UsageError for options that were given and mean nothing beside another one."""
    context = click.get_current_context()
    given = [n for n in names if context.get_parameter_source(n) is click.core.ParameterSource.COMMANDLINE]
    if given:
        words = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise click.UsageError(f"{words}: not with {beside}")
