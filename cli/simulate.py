"""`warpsar simulate`: from scene files to one calibrated image for each view."""

from __future__ import annotations

from pathlib import Path

import click
from click.core import ParameterSource

from warpsar.cli import options
from warpsar.effects.base.product import Product
from warpsar.simulation.formats import registry

PRODUCTS = ("beta0", "slc", "phase-history")


@click.command(name="simulate", short_help="Make an image of every view.")
@click.argument("scenes", nargs=-1, required=True, type=options.SCENE)
@options.out("Folder for images (beta0), quick looks (PNG, dB) and simulate.json; made if missing.")
@click.option(
    "--product",
    type=click.Choice(PRODUCTS),
    default="beta0",
    show_default=True,
    help="Power, complex images (SICD), or phase history (CPHD); the last two need [collection].",
)
@click.option(
    "--format",
    "formats",
    type=click.Choice(registry.names()),
    multiple=True,
    default=("exr",),
    show_default=True,
    help="Format of the images; may be given several times. A format that needs an extra names it.",
)
@click.option(
    "--azimuths", metavar="START:STOP:STEP", help="Azimuths of the views [deg], in place of the file's views; or A,B,C."
)
@click.option(
    "--incidences", metavar="START:STOP:STEP", help="Incidences [deg]. With --azimuths: a view at every pair of angles."
)
@options.device
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    help="Seed of the rays' jitter and of speckle. The same seed gives the same images.",
)
@click.option(
    "--looks",
    type=click.FloatRange(min=0, min_open=True, max=1e9),
    metavar="L",
    help="Also write VIEW_looksL.exr: the image with speckle of L looks. VIEW.exr stays free of it.",
)
@click.option(
    "--declare",
    is_flag=True,
    help="With --looks: also write scene.toml, which names the speckled images as measured, for `warpsar learn`.",
)
@click.option(
    "--layers", is_flag=True, help="Also write incidence, layover count, shadow mask and material of each pixel."
)
@click.option(
    "--scatterers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Also list the N strongest contributions of each view: place, faces, RCS (CSV, and PLY for 3-D programs).",
)
@click.option("--variance", is_flag=True, help="Also write the sampling variance of each pixel, from a second seed.")
@click.option(
    "--per-ray",
    is_flag=True,
    help="Keep the hit of every ray. By default hits of one face in one pixel are merged.",
)
@click.option(
    "--max-memory",
    type=click.FloatRange(min=0, min_open=True),
    metavar="GIB",
    help="Memory for rays and hits, or for scatterers: less only takes longer. A product that does not fit is refused.",
)
@options.yes
def command(
    scenes: tuple[Path, ...],
    out: Path,
    product: Product,
    formats: tuple[str, ...],
    azimuths: str | None,
    incidences: str | None,
    device: str | None,
    seed: int | None,
    layers: bool,
    scatterers: int | None,
    variance: bool,
    per_ray: bool,
    max_memory: float | None,
    looks: float | None,
    declare: bool,
    yes: bool,
) -> None:
    """Simulate every view of SCENES, each a scene.toml beside its mesh.

    With several scenes, or with --azimuths or --incidences, images go to folders of a thousand each, and index.csv
    lists them. Images of an earlier run are kept if their inputs are the same.

    \b
    Examples:
      warpsar simulate scene.toml -o out/
      warpsar simulate scene.toml -o out/ --looks 4 --declare
      warpsar simulate scene.toml -o out/ --format geotiff --layers
      warpsar simulate scene.toml -o out/ --azimuths 0:360:10 --incidences 30,45
    """
    if product != "beta0":
        _with_phase(scenes, out, product, device, seed, max_memory, yes)
        return
    if len(scenes) > 1 or azimuths is not None or incidences is not None:
        from warpsar.simulation import batch

        if looks is not None or declare or scatterers or formats != ("exr",):
            raise click.UsageError(
                "--format, --looks, --declare and --scatterers are for one scene, with the views that its file has; "
                "several scenes, or --azimuths, make EXR without speckle"
            )
        batch.run(
            scenes,
            out,
            azimuths=azimuths,
            incidences=incidences,
            device=device,
            seed=seed,
            layers=layers,
            variance=variance,
            per_ray=per_ray,
            max_memory_gib=max_memory,
            yes=yes,
        )
        return
    from warpsar.simulation.command import run

    run(
        scenes[0],
        out,
        device=device,
        seed=seed,
        layers=layers,
        variance=variance,
        per_ray=per_ray,
        max_memory_gib=max_memory,
        formats=formats,
        looks=looks,
        declare=declare,
        scatterers=scatterers or 0,
        yes=yes,
    )


def _with_phase(
    scenes: tuple[Path, ...],
    out: Path,
    product: Product,
    device: str | None,
    seed: int | None,
    max_memory: float | None,
    yes: bool,
) -> None:
    context = click.get_current_context()
    known = ("scenes", "out", "product", "device", "seed", "quiet", "max_memory", "yes")
    given = [
        p.opts[0]
        for p in context.command.params
        if p.name not in known and context.get_parameter_source(str(p.name)) is ParameterSource.COMMANDLINE
    ]
    if len(scenes) > 1 or given:
        found = ", ".join(given) or f"{len(scenes)} scenes"
        raise click.UsageError(
            f"--product {product}: found {found}; allowed: a scene, --out, --device, --seed, --max-memory, --yes"
        )
    from warpsar.collection.command import run

    run(scenes[0], out, product, device=device, seed=seed, max_memory_gib=max_memory, yes=yes)
