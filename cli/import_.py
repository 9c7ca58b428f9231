"""`warpsar import`: a measured image onto the grid of a view, and into the scene file."""

from __future__ import annotations

from pathlib import Path

import click

from warpsar.cli import options
from warpsar.formats import registry

# A copy from warpsar.world.taper, which imports NumPy: `--help` must not. A test compares them.
TAPERS = ("none", "hann", "taylor")


@click.command(name="import", short_help="Bring a measured image onto the grid of a view.")
@click.argument(
    "sources",
    nargs=-1,
    required=True,
    type=options.FILE,
    metavar="SOURCE...",
)
@click.option(
    "--scene",
    required=True,
    type=options.SCENE,
    help="The scene.toml to edit.",
)
@click.option(
    "--view",
    help="Name of the view, for images. A view that the scene does not have is made from the file's own geometry.",
)
@click.option(
    "--table",
    type=options.FILE,
    help="In place of --view: a CSV of chip, azimuth_deg and depression_deg. Every SOURCE becomes a view.",
)
@options.file_format("--format", "Format of SOURCE.")
@click.option(
    "--quantity",
    type=click.Choice(("amplitude", "power")),
    help="Whether the numbers of a picture are amplitude or power; never guessed.",
)
@click.option("--amplitude", is_flag=True, help="Short for --quantity amplitude.")
@click.option(
    "--scale",
    type=click.Choice(("as declared", "unknown")),
    default="as declared",
    help="unknown: each image has a gain of its own; writes calibrated = false.",
)
@click.option(
    "--radar-at",
    type=click.Choice(("top", "bottom")),
    default="top",
    show_default=True,
    help="Where the radar is in a picture; bottom turns it upside down.",
)
@click.option("--spacing", nargs=2, type=float, metavar="RANGE AZIMUTH", help="Pixels of a picture [m].")
@options.polarization("Needed where the file has several polarizations, or names none.")
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
    show_default="train",
    help="Role of the view, of the views of a table, or of curves of radar cross-section.",
)
@click.option(
    "--train",
    type=click.IntRange(min=1),
    metavar="N",
    help="With --table: N views spread evenly in azimuth are train views, the others test views.",
)
@click.option(
    "--hold-back",
    nargs=2,
    type=click.FloatRange(-360, 360),
    multiple=True,
    metavar="FROM TO",
    help="With --table: views in this sector of azimuth [deg] are test views. Can be repeated.",
)
@click.option(
    "--azimuths",
    type=click.Choice(("clockwise", "counterclockwise")),
    default="clockwise",
    show_default=True,
    help="With --table: how its azimuths run, seen from above.",
)
@options.device
def command(
    sources: tuple[Path, ...],
    scene: Path,
    view: str | None,
    table: Path | None,
    file_format: str,
    quantity: str | None,
    amplitude: bool,
    scale: str,
    radar_at: str,
    spacing: tuple[float, float] | None,
    polarization: str | None,
    window_range: str,
    window_azimuth: str,
    subapertures: int,
    looks_range: int | None,
    looks_azimuth: int | None,
    surface: str,
    origin: tuple[float, float, float] | None,
    role: str | None,
    train: int | None,
    hold_back: tuple[tuple[float, float], ...],
    azimuths: str,
    device: str | None,
) -> None:
    """Bring the measurement SOURCE onto the grid of a view, and declare it in the scene file.

    With --table one call brings in many pictures and a table of their angles.

    Phase history is focused by backprojection; several files may be one aperture. Complex and detected images
    are resampled. The image is written beside the scene file, as float32 linear power.

    Curves of radar cross-section (CSV, or the Austin suite's text) need no view: they become `[[curves]]`.

    \b
    Examples:
      warpsar import pass1.cphd --scene scene.toml --view pass1
      warpsar import image.tif --scene scene.toml --view north --quantity power --polarization HH
      warpsar import a.jpg b.jpg --scene scene.toml --table angles.csv --scale unknown
    """
    if file_format == "rcs" or (file_format == "auto" and all(map(registry.get("rcs").named, sources))):
        from warpsar.measured.curves import import_curves

        for path in import_curves(sources, scene, polarization=polarization, role=role or "train"):  # type: ignore[arg-type]
            click.echo(str(path))
        return
    from warpsar.measured.chips import import_chips
    from warpsar.measured.importer import import_measured
    from warpsar.runtime import console

    if (view is None) == (table is None):
        raise click.UsageError("one of --view and --table is needed")
    if table is None and (train is not None or hold_back or azimuths != "clockwise"):
        raise click.UsageError("--train, --hold-back and --azimuths: only with --table")
    if role is not None and (train is not None or hold_back):
        raise click.UsageError("--role, and --train or --hold-back, contradict each other")
    if amplitude and quantity == "power":
        raise click.UsageError("--amplitude and --quantity power contradict each other")
    quantity = "amplitude" if amplitude else quantity
    if table is not None:
        one_by_one: dict[str, object] = {
            "--window-range": window_range != "none",
            "--window-azimuth": window_azimuth != "none",
        }
        one_by_one |= {"--subapertures": subapertures != 1, "--looks-range": looks_range, "--origin": origin}
        one_by_one |= {"--looks-azimuth": looks_azimuth, "--surface": surface != "reference"}
        if stated := [name for name, given in one_by_one.items() if given]:
            raise click.UsageError(f"{', '.join(stated)}: not with --table")
        chips = import_chips(
            sources,
            scene,
            table,
            file_format=file_format,
            quantity=quantity,  # type: ignore[arg-type]
            polarization=polarization,
            radar_at=radar_at,  # type: ignore[arg-type]
            spacing_m=spacing,
            scale=scale,  # type: ignore[arg-type]
            role=role,
            train=train,
            held_back=hold_back,
            azimuths=azimuths,  # type: ignore[arg-type]
        )
        for message in chips.messages:
            console.say(f"note: {message}")
        share = 100.0 * sum(chips.clipped) / len(chips.clipped)
        console.say(f"written: {chips.sheet}")
        click.echo(f"{scene}: {len(chips.views)} views; {share:.2f} % of their pixels are clipped")
        return
    assert view is not None
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
        radar_at=radar_at,  # type: ignore[arg-type]
        spacing_m=spacing,
        scale=scale,  # type: ignore[arg-type]
        role=role,  # type: ignore[arg-type]
    )
    for message in done.messages:
        console.say(f"note: {message}")
    console.say(f"written: {done.image_path}, {done.picture_path}; {scene} names the image")
    if done.slc_path is not None:
        console.say(f"written: {done.slc_path}, the complex samples")
    if (blur := done.point_spread) is not None:
        widths = " x ".join(f"{blur[key]:g} +- {sd:g} m" for key, sd in blur["tolerance"].items())
        console.say(f"point_spread, as the header has it: {widths}")
    looks = "not estimated" if done.looks is None else f"{done.looks:.2f}"
    samples = " x ".join(map(str, done.samples_per_pixel))
    click.echo(f"{done.image_path}: {done.polarization}, {samples} samples per pixel, looks {looks}")
