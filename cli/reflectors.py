"""`warpsar reflectors`: corner reflectors in radar products, measured beside predicted."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options
from warpsar.formats import registry


@click.command(name="reflectors", short_help="Measure corner reflectors, predict them, explain the difference.")
@click.argument("products", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--sites",
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="CSV of the reflectors: our own columns, or a table of GECORIS, UAVSAR, ISCE3 or NISAR.",
)
@click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for report.html, reflectors.csv, reflectors.json and sites_isce3.csv; made if missing.",
)
@click.option(
    "--polarization",
    type=click.Choice(["HH", "HV", "VH", "VV"]),
    help="The images to take. Default: all that are co-polarized.",
)
@click.option(
    "--radiometry",
    type=click.Choice(["beta0", "sigma0", "gamma0"]),
    help="Quantity of the image's power, for products that do not state it (GAMMA).",
)
@click.option(
    "--allowance",
    nargs=2,
    type=click.FloatRange(0.0, 1e4),
    default=(15.0, 15.0),
    show_default=True,
    metavar="AZIMUTH RANGE",
    help="How far off its place a reflector may be [m]: atmosphere, tides, timing.",
)
@click.option(
    "--window",
    type=click.FloatRange(0.5, 6.0),
    default=2.0,
    show_default=True,
    help="Half of the window that is integrated, in resolution cells.",
)
@click.option("--closed-form", is_flag=True, help="Predict by the closed form alone, without rays.")
@click.option(
    "--hold-back",
    metavar="DATE",
    help="Dates from this one on, such as 2024-06-01, are used for no fit: the earlier dates predict their RCS.",
)
@click.option(
    "--format",
    "file_format",
    type=click.Choice(["auto", *registry.names()]),
    default="auto",
    show_default=True,
    help="The products' format.",
)
@options.device
def command(
    products: tuple[Path, ...],
    sites: Path,
    out: Path,
    polarization: str | None,
    radiometry: str | None,
    allowance: tuple[float, float],
    window: float,
    closed_form: bool,
    hold_back: str | None,
    file_format: str,
    device: str | None,
) -> None:
    """Measure the corner reflectors of a table of sites in PRODUCTS: SAFE folders, annotation files, .mli, .h5.

    \b
    Examples:
      warpsar reflectors first.SAFE second.SAFE --sites sites.csv -o reflectors/
      warpsar reflectors first.mli second.mli --sites sites.csv --radiometry sigma0 -o reflectors/
    """
    from warpsar.calibration.command import run

    words = ["warpsar", "reflectors", *map(str, products), "--sites", str(sites), "-o", str(out)]
    words += ["--polarization", polarization] if polarization else []
    words += ["--radiometry", radiometry] if radiometry else []
    words += ["--allowance", *(f"{each:g}" for each in allowance), "--window", f"{window:g}"]
    words += ["--closed-form"] if closed_form else []
    words += ["--hold-back", hold_back] if hold_back else []
    run(
        products,
        sites,
        out,
        polarization=polarization,
        radiometry=radiometry,  # type: ignore[arg-type]
        allowance_m=allowance,
        window_cells=window,
        engine=not closed_form,
        hold_back=hold_back,
        file_format=file_format,
        device=device,
        command=words,
    )
