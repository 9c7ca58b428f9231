"""`warpsar materials`: the library of surfaces."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="materials", short_help="List the surfaces that a scene file may name.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--frequency",
    type=click.FloatRange(min=1e6, max=1e13),
    default=9.6e9,
    show_default=True,
    metavar="HZ",
    help="Carrier frequency [Hz].",
)
@click.option(
    "-o",
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.png",
    help="Also draw sigma0 against incidence, for HH and VV.",
)
def command(names: tuple[str, ...], frequency: float, out: Path | None) -> None:
    """List the surfaces that a scene file may name, or the NAMEs among them.

    \b
    Examples:
      warpsar materials
      warpsar materials asphalt grass --frequency 5.4e9 -o materials.png

    A scene file uses one by `library = "asphalt"` in a table of [materials], or by its name alone where the mesh or an
    object uses that name.
    """
    from warpsar.simulation.materials import run

    for line in run(names, frequency, out):
        click.echo(line)
