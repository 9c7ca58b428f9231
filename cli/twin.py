"""`warpsar twin`: what a radar product should show of an elevation model."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="twin", short_help="Simulate a radar product from a DEM, on the product's own grid.")
@click.argument("product", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--dem",
    required=True,
    type=options.FILE,
    help="GeoTIFF of heights [m], in any coordinate system that PROJ knows.",
)
@options.out("Folder for report.html, twin.json, the layers and pictures; made if missing.")
@click.option(
    "--geoid-offset",
    type=float,
    metavar="M",
    help="Height of the DEM's zero above the WGS 84 ellipsoid [m]; 0 for ellipsoidal heights. Must be said where the "
    "DEM does not name a vertical datum, or PROJ lacks its grid.",
)
@click.option(
    "--crop",
    nargs=4,
    type=float,
    metavar="WEST SOUTH EAST NORTH",
    help="The part to simulate, longitudes and latitudes [deg]. Default: the whole DEM.",
)
@click.option(
    "--surface",
    default="grass",
    show_default=True,
    metavar="NAME",
    help="Surface of the ground where --landcover gives none: one of the library (`warpsar materials` lists them).",
)
@click.option(
    "--landcover",
    type=options.FILE,
    help="GeoTIFF of land cover classes, in any coordinate system.",
)
@click.option(
    "--landcover-table",
    default="worldcover",
    show_default=True,
    metavar="NAME|FILE",
    help="Classes of --landcover: worldcover (ESA), corine, or a TOML file with [surfaces] and lines such as 10 = "
    '"grass".',
)
@click.option(
    "--buildings",
    type=options.FILE,
    help="Buildings on the DEM: GeoJSON outlines with heights, or CityGML.",
)
@options.polarization("The image to take, where the product has several.")
@options.radiometry("the image")
@click.option(
    "--format",
    "formats",
    multiple=True,
    type=click.Choice(["geotiff", "netcdf", "zarr"]),
    default=("geotiff",),
    show_default=True,
    help="Format of the layers; may be given several times.",
)
@options.file_format("--product-format", "The product's format.")
@options.device
def command(
    product: Path,
    dem: Path,
    out: Path,
    geoid_offset: float | None,
    crop: tuple[float, float, float, float] | None,
    surface: str,
    landcover: Path | None,
    landcover_table: str,
    buildings: Path | None,
    polarization: str | None,
    radiometry: str | None,
    formats: tuple[str, ...],
    file_format: str,
    device: str | None,
) -> None:
    """Simulate what PRODUCT should show of the ground: a SAFE folder, an annotation file, .mli, .h5.

    \b
    Examples:
      warpsar twin scene.SAFE --dem dem.tif -o twin/
      warpsar twin scene.SAFE --dem dem.tif --geoid-offset 48.6 --crop 12.45 41.95 12.55 42.05 -o twin/
      warpsar twin scene.SAFE --dem dem.tif --landcover worldcover.tif --buildings town.geojson -o twin/
    """
    from warpsar.terrain.command import run

    run(
        product,
        dem,
        out,
        surface=surface,
        landcover=landcover,
        landcover_table=landcover_table,
        buildings=buildings,
        crop=crop,
        geoid_offset_m=geoid_offset,
        polarization=polarization,
        radiometry=radiometry,  # type: ignore[arg-type]
        file_format=file_format,
        formats=formats,
        device=device,
        command=options.words(),
    )
