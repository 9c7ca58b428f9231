"""`warpsar rcs`: radar cross-sections of a scene over angles and frequencies."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="rcs", short_help="Radar cross-sections and complex amplitudes, with phase.")
@click.argument("body", type=options.FILE)
@click.option(
    "-o",
    "--out",
    default="rcs",
    show_default=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for report.html, rcs.csv, rcs.png, rcs_polar.png and rcs.json (and rcs.parquet where pyarrow is "
    "there); made if missing.",
)
@click.option(
    "--material",
    metavar="NAME",
    help="Of a mesh file: metal (a smooth perfect conductor), or a surface of the library (warpsar materials).",
)
@click.option(
    "--units",
    type=click.Choice(options.UNITS),
    help="Of a mesh file: the unit of its coordinates. Default: guessed, and printed.",
)
@click.option(
    "--up",
    type=click.Choice(options.UP),
    help="Of a mesh file: its axis that points up. Default: Y for glTF, else Z.",
)
@click.option(
    "--azimuths",
    required=True,
    metavar="START:STOP:STEP",
    help="Azimuths of the radar, clockwise from north [deg]; or A,B,C. STOP is left out.",
)
@click.option(
    "--incidences",
    default="90",
    show_default=True,
    metavar="START:STOP:STEP",
    help="Angles from the zenith to the radar, 0 to 180 [deg]; or A,B,C.",
)
@click.option(
    "--frequencies",
    metavar="F,F,...",
    help="Frequencies, ascending [Hz]; or START:STOP:STEP. Default: that of [radar]. A mesh file needs them.",
)
@click.option(
    "--rays-per-wavelength",
    type=click.FloatRange(min=4, max=100),
    default=10.0,
    show_default=True,
    help="Ray tubes across a wavelength of the highest frequency.",
)
@click.option(
    "--isar",
    is_flag=True,
    help="Also write range profiles and an image of the body, of even steps of frequency and azimuth.",
)
@click.option("--layers", is_flag=True, help="Also write layers.csv: each term, and each number of bounces, by itself.")
@click.option(
    "--contributors",
    type=click.FloatRange(-360.0, 360.0),
    metavar="AZIMUTH",
    help="Also write contributors.html: the body in 3D, each face and edge by what it sends back at this azimuth.",
)
@click.option(
    "--max-memory",
    type=click.FloatRange(min=0, min_open=True),
    metavar="GIB",
    help="Memory of the sweep. A sweep that does not fit is refused before the work.",
)
@options.device
def command(
    body: Path,
    out: Path,
    material: str | None,
    units: str | None,
    up: str | None,
    azimuths: str,
    incidences: str,
    frequencies: str | None,
    rays_per_wavelength: float,
    isar: bool,
    layers: bool,
    contributors: float | None,
    max_memory: float | None,
    device: str | None,
) -> None:
    """Radar cross-sections and complex amplitudes of BODY for plane waves, at every pair of angles.

    BODY is a scene file, which needs no [image] and no [[views]], or a mesh file with one --material. Polarizations,
    terms and max_bounces are those of [radar]; of a mesh file HH and VV, and all terms.

    \b
    Examples:
      warpsar rcs body.stl --material metal --frequencies 10e9 --azimuths 0:360:0.5
      warpsar rcs part.stl --units mm --material metal --frequencies 10e9 --azimuths 0:360:0.5
      warpsar rcs scene.toml -o out/ --azimuths 0:180.5:0.5
      warpsar rcs scene.toml -o out/ --azimuths 0,45,90 --incidences 60 --frequencies 5e9,10e9
      warpsar rcs scene.toml -o out/ --azimuths 0:90:1 --contributors 45
      warpsar rcs scene.toml -o out/ --azimuths=-20:20:0.5 --frequencies 8e9:12e9:50e6 --isar
    """
    from warpsar.coherent.command import run
    from warpsar.runtime import console
    from warpsar.simulation.naming import angles

    found = run(
        body,
        out,
        material=material,
        units=units,
        up=up,
        azimuths=azimuths,
        incidences=incidences,
        frequencies=frequencies,
        device=device,
        rays_per_wavelength=rays_per_wavelength,
        isar=isar,
        layers=layers,
        max_memory_gib=max_memory,
    )
    if contributors is not None:
        from warpsar.viewer import contributors as viewer

        first = float(angles(incidences, "--incidences", 0.0, 180.0, ends=True)[0])
        page = viewer.run(
            body,
            out,
            contributors,
            first,
            float(found["frequencies_hz"][-1]),
            material=material,
            units=units,
            up=up,
            device=device,
            rays_per_wavelength=rays_per_wavelength,
        )
        console.say(str(page))
