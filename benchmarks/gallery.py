"""The gallery: ten scenes, each made by one command, with the mesh beside the image.

    python benchmarks/gallery.py ship --out out/gallery          # one scene; without a name all ten
    python benchmarks/gallery.py --pictures docs/figures/gallery # and the pictures of docs/gallery.md

OUT/NAME holds scene.obj (or dem.tif) and scene.toml, ready for `warpsar simulate`, and the files of that command. The
meshes are made by benchmarks/gallery_scenes.py, and are free to use.
"""

from __future__ import annotations

import argparse
import time
from io import BytesIO
from pathlib import Path

import numpy as np
from gallery_scenes import SCENES, Shot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray
from PIL import Image

from warpsar.evaluation.meshview import look
from warpsar.io.figures import new
from warpsar.io.grey_scale import GreyScale
from warpsar.io.images import read_channel
from warpsar.io.quick_look import QuickLook, add_bar, add_legend, shades
from warpsar.runtime.devices import resolve_device
from warpsar.scene.scene import Scene
from warpsar.simulation.command import run
from warpsar.simulation.rays import covered_in
from warpsar.surface.stage import Stage

LOOKS = 4.0
RESPONSE_PX = 2.0
"""Width of the response in pixels: at 1.5 side lobes are narrower than a pixel, and their lines look dashed."""
WIDTH_IN = 5.4
"""Of a picture: a font of 9 points has 9 pixels where the picture is shown 400 pixels wide."""
COLOURS = {
    "asphalt": (0.30, 0.30, 0.33),
    "concrete": (0.72, 0.71, 0.68),
    "brick": (0.68, 0.36, 0.28),
    "roof_tiles": (0.62, 0.25, 0.18),
    "grass": (0.45, 0.65, 0.32),
    "gravel": (0.70, 0.63, 0.52),
    "soil_wet": (0.55, 0.45, 0.35),
    "default": (0.62, 0.56, 0.44),
    "water_calm": (0.35, 0.52, 0.70),
    "water_rough": (0.30, 0.48, 0.66),
    "glass": (0.60, 0.78, 0.85),
    "metal": (0.78, 0.80, 0.84),
    "painted_steel": (0.85, 0.62, 0.25),
    "crowns": (0.20, 0.45, 0.22),
    "trunks": (0.45, 0.33, 0.22),
    "blades": (0.95, 0.95, 0.95),
    "tower": (0.90, 0.90, 0.92),
    "aircraft": (0.88, 0.89, 0.92),
    "terminal": (0.60, 0.78, 0.85),
    "facades": (0.68, 0.36, 0.28),
    "offices": (0.72, 0.71, 0.68),
    "cranes": (0.85, 0.62, 0.25),
    "ship": (0.62, 0.25, 0.20),
    "containers": (0.45, 0.52, 0.62),
    "hangars": (0.78, 0.80, 0.84),
    "roofs": (0.95, 0.80, 0.50),
    "hull": (0.50, 0.50, 0.33),
    "tracks": (0.35, 0.35, 0.36),
}

_TEXT = """# {words}
# Made by benchmarks/gallery.py. Materials without a table are those of the library (`warpsar materials`).

[scene]
mesh = "{mesh}"
reference_point_m = {reference}

[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]

[image]
shape = {shape}
spacing_m = [{spacing}, {spacing}]

[sampling]
rays_per_pixel = {rays}

# The system: its resolution and its noise.
[effects.point_spread]
range_fwhm_m = {width:.3g}
azimuth_fwhm_m = {width:.3g}
window = "taylor"

[effects.noise_floor]
level = 0.0005
"""


def scene_text(shot: Shot, rays: float) -> str:
    text = _TEXT.format(
        words=shot.words,
        mesh=shot.mesh,
        reference=list(shot.reference_m),
        shape=list(shot.shape),
        spacing=shot.spacing_m,
        rays=rays,
        width=RESPONSE_PX * shot.spacing_m,
    )
    for name, table in shot.effects.items():
        lines = [f"{key} = {str(value).replace(chr(39), chr(34))}" for key, value in table.items()]
        text += f"\n[effects.{name}]\n" + "\n".join(lines) + "\n"
    view = f'\n[[views]]\nname = "view"\nazimuth_deg = {shot.azimuth_deg}\nincidence_deg = {shot.incidence_deg}\n'
    return text + shot.extra + view


def made(name: str, out: Path, device: str | None, rays: float) -> tuple[Shot, Scene]:
    """The scene `name` in its folder, simulated with speckle."""
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    shot = SCENES[name](folder)
    (folder / "scene.toml").write_text(scene_text(shot, rays), encoding="utf-8")
    run(folder / "scene.toml", folder, device=device, looks=LOOKS)
    return shot, Scene.load(folder / "scene.toml")


def mesh_picture(stage: Stage, scene: Scene, shot: Shot) -> NDArray[np.uint8]:
    """The mesh in parallel projection, seen so that the radar is above, as in the image beside it."""
    seen = look(stage, shot.azimuth_deg + 180.0, 48.0, width=560)
    colours = np.array([COLOURS.get(name, (0.6, 0.6, 0.6)) for name in scene.mesh.materials])
    return seen.paint(colours[seen.material])


def draw(scene: Scene, shot: Shot, folder: Path, path: Path) -> None:
    """Mesh and image side by side, as WebP; words are large enough to be read at a width of 400 pixels."""
    stage = Stage.of(scene, resolve_device("cpu"))
    power = read_channel(folder / "view_looks4.exr", "HH")
    (view,) = scene.views
    image = QuickLook.of(path, "", {"HH": power}, scene.grid.spacing_m, covered_in(scene, stage, view))
    scale = GreyScale.of_counts(shades([image]))
    deep, wide = image.size_m
    figure, (left, right) = new(WIDTH_IN, 1.1 + 2.2 * deep / wide, ncols=2, width_ratios=[1.0, 1.4])
    left.imshow(mesh_picture(stage, scene, shot))
    left.set_axis_off()
    left.set_title("mesh", fontsize=9)
    extent = (-wide / 2.0, wide / 2.0, deep / 2.0, -deep / 2.0)
    right.imshow(image.rgb("HH", scale), extent=extent, interpolation="antialiased")
    right.set_title(f"HH, 9.6 GHz, incidence {shot.incidence_deg:g}°, {LOOKS:g} looks", fontsize=9)
    right.set_xlabel("azimuth [m]", fontsize=9)
    right.set_ylabel("slant range [m]", fontsize=9)
    right.locator_params(nbins=5)
    right.tick_params(labelsize=8)
    for axis, at in ((left, (0.12, 1.15)), (right, (0.1, 0.99))):
        word = axis.text(*at, "radar", transform=axis.transAxes, color="darkorange", fontsize=9, ha="center", va="top")
        arrow = {"arrowstyle": "-|>", "color": "darkorange", "lw": 1.5}
        axis.annotate("", (0.5, -1.3), (0.5, 0.0), xycoords=word, textcoords=word, arrowprops=arrow)
    beside = right.inset_axes((1.05, 0.0, 0.06, 1.0))  # as tall as the image
    add_bar(figure, scale, 9, cax=beside)
    add_legend(figure, [image], 9)
    stream = BytesIO()
    assert isinstance(figure.canvas, FigureCanvasAgg)
    figure.savefig(stream, format="png", dpi=1000.0 / WIDTH_IN)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.open(stream).convert("RGB").save(path, quality=62, method=6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SCENES)}; all without one")
    parser.add_argument("--out", type=Path, default=Path("out/gallery"))
    parser.add_argument("--pictures", type=Path, help="folder for the pictures; OUT if not stated")
    parser.add_argument("--device")
    parser.add_argument("--rays-per-pixel", type=float, default=64.0)
    options = parser.parse_args()
    if unknown := set(options.names) - set(SCENES):
        parser.error(f"no such scene: {', '.join(sorted(unknown))}")
    for name in options.names or SCENES:
        started = time.perf_counter()
        shot, scene = made(name, options.out, options.device, options.rays_per_pixel)
        draw(scene, shot, options.out / name, (options.pictures or options.out) / f"{name}.webp")
        print(f"{name}: {len(scene.mesh.faces)} faces, {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
