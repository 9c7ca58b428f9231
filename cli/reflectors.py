"""`warpsar reflectors`: corner reflectors in radar products, measured beside predicted."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="reflectors", short_help="Measure corner reflectors, predict them, explain the difference.")
@click.argument("products", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--sites",
    required=True,
    type=options.FILE,
    help="CSV of the reflectors: our own columns, or a table of GECORIS, UAVSAR, ISCE3 or NISAR.",
)
@options.out("Folder for report.html, reflectors.csv, reflectors.json and sites_isce3.csv; made if missing.")
@options.polarization("The images to take. Default: all that are co-polarized.")
@options.radiometry("an image")
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
@options.file_format("--format", "The products' format.")
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
        command=options.words(),
    )
