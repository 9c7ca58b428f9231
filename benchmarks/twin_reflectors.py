"""The twin of images with a corner reflector: Sentinel-1 over Samford (CoRAL, five dates), ALOS PALSAR (four channels).

    python benchmarks/twin_reflectors.py twin $DATA -o out/twin_reflectors [--write]
    python benchmarks/twin_reflectors.py scene $DATA -o out/coral
    warpsar diagnose out/coral/scene.toml -o out/coral/diagnosed --time-limit 4

No elevation model lies beside them, so the ground is level, at the reflector's height: about 100 m above the ellipsoid
at Samford (a guess), 0 m for ALOS. `twin` writes a folder for each image, with its residual maps, and a table. `scene`
makes a scene of level ground about CoRAL's reflector, 64 x 64 pixels, with the three dates that show it.
"""

import sys
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tables

from warpsar import twin
from warpsar.formats import registry
from warpsar.measured.importer import import_measured
from warpsar.products.product import Product, Radiometry
from warpsar.terrain import command
from warpsar.terrain.comparison import TerrainComparison, compared
from warpsar.terrain.differences import TerrainDifferences, differences
from warpsar.terrain.result import SimulatedProduct

CORAL = ("20180726", "20180807", "20180819", "20180831", "20180912")
CORAL_M, CORAL_PLACE = 100.0, (110, 87)
"""Height, and line and pixel of the reflector by its authors; it is there from the third date on."""
ALOS = "alos_polcal/calib_RSLC_ALPSRP025826990_RIO_BRANCO_CR.h5"
ALOS_PLACE = (50, 25)
HALF_M = 900.0
SIDE = 64
DATA = click.argument("data", type=click.Path(exists=True, file_okay=False, path_type=Path))
OUT = click.option("-o", "--out", required=True, type=click.Path(file_okay=False, path_type=Path))


def level(path: Path, product: Product, height_m: float) -> Path:
    """An elevation model of one height under all of a product, and 30 pixels beyond; posts of one arc second."""
    import rasterio
    from rasterio.transform import from_origin

    grid, more, step = product.grid, 30, 1.0 / 3600.0
    lines, pixels = (-more, grid.lines + more), (-more, grid.pixels + more)
    corners = product.to_ground(np.repeat(lines, 2), np.tile(pixels, 2), height_m)
    (south, west), (north, east) = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    shape = int((north - south) / step) + 2, int((east - west) / step) + 2
    with rasterio.open(
        path, "w", driver="GTiff", width=shape[1], height=shape[0], count=1, dtype="float32", crs="EPSG:4326",
        transform=from_origin(west, north, step, step),
    ) as file:  # fmt: skip
        file.write(np.full(shape, height_m, np.float32), 1)
    return path


def row(name: str, found: SimulatedProduct, place: tuple[int, int]) -> list[str]:
    """What the twin says of one image, and of the cell that shows the reflector."""
    against, differs = compared(found), differences(found)
    if not isinstance(against, TerrainComparison) or not isinstance(differs, TerrainDifferences):
        return [name, *["too few cells"] * 6]
    cell = tuple((at - first[0]) // n for at, first, n in zip(
        place, (found.window.lines, found.window.pixels), against.cell, strict=True
    ))  # fmt: skip
    left = differs.after_db - np.nanmedian(differs.after_db)
    brighter = int((left > left[cell]).sum())
    return [
        name,
        f"{against.correlation:+.2f} ({against.by_chance:+.2f})",
        f"{against.bright_shared:.0%}",
        f"{against.left_db:.2f}, {against.left_without_db:.2f}",
        "terrain" if against.seen else "nothing",
        ", ".join(one.name for one in differs.found) or "nothing",
        f"{left[cell]:+.1f} dB; {brighter} of {int(np.isfinite(left).sum())} are brighter",
    ]


@click.group()
def main() -> None:
    """Reflector stacks through `twin`, and through `diagnose`."""


@main.command(name="twin")
@DATA
@OUT
@click.option("--write", is_flag=True, help="Put the table into its page in docs/.")
def through_twin(data: Path, out: Path, write: bool) -> None:
    """Folders of `warpsar twin`, and a table."""
    out.mkdir(parents=True, exist_ok=True)
    images: list[tuple[str, Path, float, Radiometry, str, tuple[int, int]]] = [
        (date, data / "coral_s1" / f"{date}_VV.mli", CORAL_M, "sigma0", "VV", CORAL_PLACE) for date in CORAL
    ]
    images += [(f"ALOS {kind}", data / ALOS, 0.0, "beta0", kind, ALOS_PLACE) for kind in ("HH", "HV", "VH", "VV")]
    body = []
    for name, path, height, radiometry, kind, place in images:
        product = registry.products(path, polarization=kind)[0]
        model = level(out / f"{name}.tif", product, height)
        kept = {"geoid_offset_m": 0.0, "radiometry": radiometry, "polarization": kind}
        command.run(path, model, out / name, **kept)  # type: ignore[arg-type]
        body.append(row(name, twin(path, model, **kept), place))  # type: ignore[arg-type]
    head = ["image", "correlation (far shifts)", "bright tenth shared", "left with, without [dB]", "seen", "differs"]
    tables.publish(
        {"twin.reflectors": tables.markdown([*head, "cell of the reflector"], body)}, {"made": tables.made()}, write
    )


@main.command()
@DATA
@OUT
def scene(data: Path, out: Path) -> None:
    """A scene of CoRAL's last three dates on level ground; the last one is kept back from fits."""
    out.mkdir(parents=True, exist_ok=True)
    paths = [data / "coral_s1" / f"{date}_VV.mli" for date in CORAL[2:]]
    product = registry.products(paths[0])[0]
    at = product.to_ground(*CORAL_PLACE, CORAL_M)
    seen = product.to_image(at)
    azimuth_m, slant_m = product.spacing_m(seen)
    corners = [(-HALF_M, -HALF_M), (HALF_M, -HALF_M), (HALF_M, HALF_M), (-HALF_M, HALF_M)]
    vertices = "".join(f"v {x} {y} 0\n" for x, y in corners)
    (out / "ground.obj").write_text(f"usemtl ground\n{vertices}f 1 2 3\nf 1 3 4\n")
    text = (
        f'[scene]\nmesh = "ground.obj"\norigin = {{latitude_deg = {at[0]:.8f}, longitude_deg = {at[1]:.8f}, height_m = '
        f"{CORAL_M}}}\n\n[radar]\nfrequency_hz = {product.frequency_hz}\npolarizations = [\"VV\"]\n\n[image]\nshape = "
        f"[{SIDE}, {SIDE}]\nspacing_m = [{slant_m:.4f}, {azimuth_m:.4f}]\ncalibrated = false\n\n[sampling]\n"
        'rays_per_pixel = 16\n\n[materials.ground]\nlibrary = "grass"\n'
    )  # fmt: skip
    for date in CORAL[2:]:
        text += (
            f'\n[[views]]\nname = "d{date}"\nazimuth_deg = {seen.azimuth_deg:.4f}\nincidence_deg = '
            f'{seen.incidence_deg:.4f}\nrole = "{"test" if date == CORAL[-1] else "train"}"\n'
        )
    (out / "scene.toml").write_text(text)
    for date, path in zip(CORAL[2:], paths, strict=True):
        import_measured([path], out / "scene.toml", f"d{date}")


if __name__ == "__main__":
    main()
