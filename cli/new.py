"""`warpsar new`: a first scene file for a mesh."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from warpsar.cli import options

SENSORS = (
    *("sentinel-1", "palsar", "iceye", "capella", "rcm", "radarsat-2", "terrasar-x", "cosmo-skymed", "umbra", "nisar"),
)  # a copy from warpsar.world.sensors, which imports NumPy; a test compares them


@click.command(name="new", short_help="Write a first scene file for a mesh or for buildings.")
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.argument("mesh", required=False, type=options.FILE)
@click.option("--example", is_flag=True, help="Copy the example scene, a street corner with its mesh. Takes no MESH.")
@click.option(
    "--units", type=click.Choice(options.UNITS), help="Unit of the mesh's coordinates. Default: guessed, and printed."
)
@click.option(
    "--up",
    type=click.Choice(options.UP),
    help="Axis of the mesh's file that points up. Default: Y for glTF, else Z.",
)
@options.yes
@click.option(
    "--dem",
    type=options.FILE,
    help="Elevation model (GeoTIFF) under the buildings. Default: level ground.",
)
@click.option(
    "--sensor",
    type=click.Choice(SENSORS),
    help="Begin with frequency, resolution and noise of a public sensor. Default: X band, pixels that fit the mesh.",
)
@click.option("--force", is_flag=True, help="Replace an existing scene.toml.")
def command(
    folder: Path,
    mesh: Path | None,
    example: bool,
    units: str | None,
    up: str | None,
    yes: bool,
    dem: Path | None,
    sensor: str | None,
    force: bool,
) -> None:
    """Write a commented scene.toml for MESH into FOLDER.

    It has a grid that holds the whole mesh, three X-band views to learn from and a fourth to check by, a table with
    starting values for each material, bounces between surfaces, and the noise of a receiver. It refers to MESH where it
    lies. If the unit of MESH is not the metre, or Z is not up, FOLDER gets a copy in metres with Z up.

    MESH may also be a file of buildings: GeoJSON outlines with heights, or CityGML (LoD1, LoD2). They become a mesh
    with walls, roofs and ground, on the elevation model --dem or on level ground (needs warpsar[geo]).

    \b
    Examples:
      warpsar new corner/ --example
      warpsar new car/ ~/models/car.obj
      warpsar new car/ ~/models/car.stl --units mm --up y
      warpsar new town/ buildings.geojson --dem dem.tif
      warpsar new port/ port.obj --sensor sentinel-1
    """
    if example:
        given = {"MESH": mesh, "--units": units, "--up": up, "--dem": dem, "--sensor": sensor}
        for name, value in given.items():
            if value is not None:
                raise click.UsageError(f"{name}: found {value}; --example takes its own mesh and scene, leave it out")
        from warpsar.scene.new import copy_example

        _say_next(copy_example(folder, force=force))
        return
    if mesh is None:
        raise click.UsageError("MESH: found none; give a mesh or a file of buildings, or --example")
    from warpsar.scene.new import new_scene

    _say_next(new_scene(folder, mesh, units=units, up=up, yes=yes, dem=dem, force=force, sensor=sensor))


def _say_next(scene: Path) -> None:
    from warpsar.runtime import console

    click.echo(scene)
    console.say(f"next: warpsar simulate {shlex.quote(str(scene))} -o {shlex.quote(str(scene.parent / 'out'))}")
