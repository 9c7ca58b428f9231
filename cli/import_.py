"""`warpsar import`: a measured image onto the grid of a view, and into the scene file."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options

# Copies from warpsar.measured.focus and .formats: those import NumPy, and `--help` must not. A test compares them.
TAPERS = ("none", "hann", "taylor")
FORMATS = ("gotcha", "cphd", "sicd", "mstar", "nisar", "geotiff", "tiff", "exr", "npy", "rcs")

CURVES = (".csv", ".txt")


@click.command(name="import")
@click.argument(
    "sources",
    nargs=-1,
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    metavar="SOURCE...",
)
@click.option(
    "--scene",
    required=True,
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="The scene.toml to edit.",
)
@click.option(
    "--view",
    help="Name of the view, for images. If it is missing, it is made from the file's own geometry.",
)
@click.option(
    "--format",
    "file_format",
    type=click.Choice(("auto", *FORMATS)),
    default="auto",
    show_default=True,
    help="Format of SOURCE.",
)
@click.option(
    "--quantity",
    type=click.Choice(("amplitude", "power")),
    help="What the real numbers of a GeoTIFF, TIFF, EXR or NPY are; it is never guessed.",
)
@click.option(
    "--polarization",
    type=click.Choice(("HH", "HV", "VH", "VV")),
    help="Needed where the file has several polarizations, or names none.",
)
@click.option(
    "--window-range", type=click.Choice(TAPERS), default="none", show_default=True, help="Window over the band."
)
@click.option(
    "--window-azimuth",
    type=click.Choice(TAPERS),
    default="none",
    show_default=True,
    help="Window over each sub-aperture.",
)
@click.option(
    "--subapertures",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Sub-apertures: each is focused by itself, and their power is averaged.",
)
@click.option(
    "--looks-range",
    type=click.IntRange(min=1),
    help="Samples per pixel in range, averaged in power. Default: set by the resolution.",
)
@click.option("--looks-azimuth", type=click.IntRange(min=1), help="The same in azimuth.")
@click.option(
    "--surface",
    type=click.Choice(("reference", "mesh")),
    default="reference",
    show_default=True,
    help="Where pixels lie: at the height of the reference point, or on the mesh.",
)
@click.option(
    "--origin",
    nargs=3,
    type=float,
    metavar="LAT LON HEIGHT",
    help="Where the world's origin lies on the earth (degrees, metres above the ellipsoid).",
)
@click.option(
    "--role",
    type=click.Choice(("train", "test")),
    default="train",
    show_default=True,
    help="What curves of radar cross-section are for.",
)
@options.device
def command(
    sources: tuple[Path, ...],
    scene: Path,
    view: str | None,
    file_format: str,
    quantity: str | None,
    polarization: str | None,
    window_range: str,
    window_azimuth: str,
    subapertures: int,
    looks_range: int | None,
    looks_azimuth: int | None,
    surface: str,
    origin: tuple[float, float, float] | None,
    role: str,
    device: str | None,
) -> None:
    """Bring the measurement SOURCE onto the grid of a view, and declare it in the scene file.

    Phase history (CPHD, or one or several AFRL .mat files) is focused by backprojection. Complex and detected images
    (SICD, MSTAR, NISAR-style HDF5, GeoTIFF, TIFF, EXR, NPY) are resampled. The image is written beside the scene
    file, as float32 linear power.

    Curves of radar cross-section (CSV, or the Austin suite's text) need no view: they become `[[curves]]`.
    """
    if file_format == "rcs" or (file_format == "auto" and all(s.suffix.lower() in CURVES for s in sources)):
        from warpsar.measured.curves import import_curves

        for path in import_curves(sources, scene, polarization=polarization, role=role):  # type: ignore[arg-type]
            click.echo(str(path))
        return
    if view is None:
        raise click.UsageError("Missing option '--view'.")
    from warpsar.measured.importer import import_measured

    done = import_measured(
        sources,
        scene,
        view,
        file_format=file_format,
        quantity=quantity,  # type: ignore[arg-type]
        polarization=polarization,
        window_range=window_range,
        window_azimuth=window_azimuth,
        subapertures=subapertures,
        samples=(looks_range, looks_azimuth),
        surface=surface,  # type: ignore[arg-type]
        origin=origin,
        device=device,
    )
    for message in done.messages:
        click.echo(f"note: {message}", err=True)
    looks = "not estimated" if done.looks is None else f"{done.looks:.2f}"
    samples = " x ".join(map(str, done.samples_per_pixel))
    click.echo(f"{done.image_path}: {done.polarization}, {samples} samples per pixel, looks {looks}")
