"""Whether the mean power of complex images is the image of power: ten scenes by both engines.

    python benchmarks/engines_agree.py --out out/engines                # what is there already is not made again
    python benchmarks/engines_agree.py --out out/engines --scene town
    python benchmarks/engines_agree.py --out out/engines --write        # and the table of docs/coherent-checks.md

`warpsar simulate` adds powers; complex images (SLC) add fields, and have speckle. A look is an azimuth and a frequency.
`LOOKS` looks lie within one aperture and one band on either side of the scene's own: over them the parts of smooth
bodies in one cell go out of step. Each look has `DRAWS` draws of rough faces, one of what takes tubes, and one image of
power. The sensor is 1,000 km away, so that the products' (R0 / R)^4 is even over the scene.

Pixels are an eighth of the response wide, and cells as wide as it. A cell counts where either mean is above -30 dB of
the brightest. It agrees where the means differ by 1.5 dB or less beyond one standard error of their difference,
which the looks tell. The ratio of totals has its error from the looks, too.

OUT/NAME.npz has both means by pixel, OUT/NAME.json the numbers, OUT/NAME.png the picture.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import tables
import trimesh
from gallery_shapes import ShapeParts, all_of, turn
from numpy.typing import NDArray

import warpsar
from warpsar.effects.registry import validate
from warpsar.scene.new import fitted_grid
from warpsar.world.collection import Collection
from warpsar.world.frame import SPEED_OF_LIGHT, view_geometry
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.taper import width_in_cells

F64 = NDArray[np.float64]
LOOKS, DRAWS = 16, 4
RAYS = 8.0
PIXELS = 8
"""Of a cell's side."""
SMOOTH_M = 1e-5
"""Height of the roughness up to which nothing is drawn that would be seen."""
FAINT_DB, ALLOWED_DB = -30.0, 1.5
METAL = {"eps_r": (1e6, -1e6), "rms_height_m": 1e-6, "correlation_length_m": 0.1}
SOIL = {"eps_r": 6.0, "rms_height_m": 0.0025, "correlation_length_m": 0.03}
ROAD = {"eps_r": 5.0, "rms_height_m": 0.0015, "correlation_length_m": 0.03}
WALL = {"eps_r": 5.0, "rms_height_m": 0.0005, "correlation_length_m": 0.02}
ROCK = {"eps_r": 7.0, "rms_height_m": 0.006, "correlation_length_m": 0.05}


@dataclass(frozen=True)
class Place:
    """What stands in a scene, and how it is looked at; `width_m` is the response's in range and azimuth.

    `smooth`: materials that the complex image alone has with a roughness of 0, which an image of power cannot have.
    """

    words: str
    parts: ShapeParts
    materials: dict[str, dict[str, Any]]
    azimuth_deg: float = 20.0
    incidence_deg: float = 45.0
    width_m: float = 0.75
    frequency_hz: float = 5.4e9
    smooth: dict[str, dict[str, Any]] = field(default_factory=dict)


def plates(parts: ShapeParts, material: str, corner: Any, *pairs: tuple[Any, Any]) -> None:
    """Parallelograms from one corner."""
    at = np.asarray(corner, float)
    for one, other in pairs:
        p, q = np.asarray(one, float), np.asarray(other, float)
        parts.add(material, np.stack([at, at + p, at + p + q, at + q]), np.array([[0, 1, 2], [0, 2, 3]]))


def lawn() -> Place:
    parts = ShapeParts()
    parts.ground((20.0, 16.0), 1.0, lambda x, y: np.where(np.abs(x - 2.0) < 3.0, "road", "soil"))
    return Place("lawn and road", parts, {"soil": SOIL, "road": ROAD})


def dunes() -> Place:
    """Waves that shade one another and lie over."""
    parts = ShapeParts()

    def height(x: F64, y: F64) -> F64:
        return 1.3 * np.sin(0.9 * y + 0.5 * np.sin(0.4 * x)) + 0.4 * np.cos(0.7 * x)

    parts.ground((20.0, 20.0), 0.2, all_of("soil"), height)
    return Place("dunes, with layover and shadow", parts, {"soil": SOIL}, incidence_deg=50.0)


def rocks() -> Place:
    parts = ShapeParts()
    parts.ground((16.0, 16.0), 1.0, all_of("soil"))
    for i, (x, y) in enumerate([(-4, -3), (3, -4), (0, 3), (5, 5), (-5, 5)]):
        rock = trimesh.creation.icosphere(subdivisions=5)
        lumps = np.prod(1.0 + 0.2 * np.sin(3.0 * rock.vertices + i), axis=1, keepdims=True)
        parts.add("rock", rock.vertices * lumps * (1.5, 1.2, 1.0) + (x, y, 0.6), rock.faces)
    return Place("rocks on soil", parts, {"soil": SOIL, "rock": ROCK}, width_m=1.0, frequency_hz=3e9)


def trihedrals() -> Place:
    parts = ShapeParts()
    for x, y, side in ((-3.0, 0.0, 0.5), (0.5, 0.5, 1.0), (4.0, -1.0, 0.3)):
        axes = np.eye(3) * side @ turn(25.0).T
        plates(parts, "metal", (x, y, 0.0), (axes[0], axes[1]), (axes[1], axes[2]), (axes[2], axes[0]))
    return Place("trihedrals of metal", parts, {"metal": METAL}, 70.0, 54.7)


def dihedral() -> Place:
    parts = ShapeParts()
    x, y, z = np.diag([6.0, 5.0, 2.0]) @ turn(19.6).T
    plates(parts, "metal", (-3.0, 1.0, 0.0), (x, y), (x, z))
    return Place("dihedral of metal", parts, {"metal": METAL})


def smooth_block() -> Place:
    parts = ShapeParts()
    parts.ground((14.0, 14.0), 14.0, all_of("ground"))
    parts.box("block", (0.0, 0.0, 0.0), (4.0, 3.0, 2.5), 22.0)
    smooth = {**METAL, "eps_r": 5.0}
    return Place("smooth block on smooth ground", parts, {"ground": smooth, "block": smooth})


def balls() -> Place:
    """Slopes spread a glint over a part of the radius, which is small beside the cells here."""
    parts = ShapeParts()
    for x, y, radius in ((-3.0, 0.0, 0.6), (0.0, 1.5, 1.0), (3.0, -1.0, 0.4)):
        parts.solid("ball", trimesh.creation.icosphere(subdivisions=6, radius=radius), (x, y, 0.0))
    slopes = {"eps_r": 9.0, "rms_height_m": 0.004, "correlation_length_m": 0.1, "specular_fraction": 1.0}
    mirror = {"eps_r": 9.0, "rms_height_m": 0.0}
    return Place("smooth balls", parts, {"ball": slopes}, smooth={"ball": mirror})


def house() -> Place:
    parts = ShapeParts()
    parts.ground((20.0, 20.0), 1.0, all_of("soil"))
    parts.house("wall", "roof", (0.0, 0.0, 0.0), (6.0, 8.0, 3.5), 2.0, 12.0)
    return Place("house on soil", parts, {"soil": SOIL, "wall": WALL, "roof": ROAD}, width_m=1.0)


def town() -> Place:
    parts = ShapeParts()
    street = lambda x, y: np.where((np.abs(x) < 4.0) | (np.abs(y) < 4.0), "road", "soil")  # noqa: E731
    parts.ground((60.0, 60.0), 2.0, street)
    for x, y, high in ((-15.0, -15.0, 7.0), (15.0, -14.0, 10.0), (-14.0, 15.0, 5.0), (16.0, 16.0, 8.0)):
        parts.prism("wall", "roof", [(x - 7, y - 6), (x + 7, y - 6), (x + 7, y + 6), (x - 7, y + 6)], high)
    grounds = {"soil": {**SOIL, "rms_height_m": 0.01, "correlation_length_m": 0.1}}
    grounds["road"] = {**ROAD, "rms_height_m": 0.005, "correlation_length_m": 0.1}
    walls = {"wall": {**WALL, "rms_height_m": 0.002}, "roof": {**ROAD, "rms_height_m": 0.006}}
    return Place("town of four blocks", parts, grounds | walls, 8.0, 40.0, 1.5, 1.3e9)


def vehicle() -> Place:
    parts = ShapeParts()
    parts.ground((14.0, 12.0), 1.0, all_of("road"))
    for primitive, size, x, y, heading in (
        ("car", (4.6, 1.8, 1.5), -3.0, 0.0, 65.0),
        ("truck", (7.0, 2.4, 3.0), 3.0, 0.0, 10.0),
    ):
        made = body(Object(name=primitive, primitive=primitive, size_m=size, material="paint"))
        vertices, faces = made.vertices, made.faces
        for _ in range(3):  # complex images round wedges flatter than 30 degrees, as far as the faces beside them reach
            vertices, faces = trimesh.remesh.subdivide(vertices, faces)
        parts.add("paint", vertices @ turn(heading).T + (x, y, 0.02), faces)
    paint = {**METAL, "rms_height_m": 0.0003, "correlation_length_m": 0.02}
    return Place("car and truck on a road", parts, {"road": ROAD, "paint": paint}, width_m=0.5)


SCENES: dict[str, Callable[[], Place]] = {
    "lawn": lawn,
    "dunes": dunes,
    "rocks": rocks,
    "trihedrals": trihedrals,
    "dihedral": dihedral,
    "block": smooth_block,
    "balls": balls,
    "house": house,
    "town": town,
    "vehicle": vehicle,
}


@dataclass(frozen=True)
class Direction:
    azimuth_deg: float
    frequency_hz: float


def looks_of(place: Place, count: int) -> list[Direction]:
    """A Latin square of azimuths and frequencies, within one aperture and one band on either side."""
    cell = place.width_m / width_in_cells("taylor")
    aperture = np.rad2deg(SPEED_OF_LIGHT / place.frequency_hz / (2.0 * cell) / np.sin(np.deg2rad(place.incidence_deg)))
    band = SPEED_OF_LIGHT / (2.0 * cell)
    steps = 2.0 * (np.arange(count) + 0.5) / count - 1.0
    order = np.random.default_rng(7).permutation(count)
    return [
        Direction(place.azimuth_deg + a * aperture, place.frequency_hz + f * band)
        for a, f in zip(steps, steps[order], strict=True)
    ]


def scene_of(place: Place, looks: list[Direction]) -> warpsar.Scene:
    """The scene for complex images, without a view; its image holds all of the mesh from everywhere."""
    mesh = place.parts.mesh()
    pixel = place.width_m / PIXELS
    sides = [view_geometry(one.azimuth_deg, place.incidence_deg, one.frequency_hz) for one in looks]
    grid = fitted_grid(mesh.vertices, np.zeros(3), sides, pixel)
    rows, columns = grid.shape
    shape = (rows + 8 * PIXELS, columns + 8 * PIXELS)
    return warpsar.Scene(
        mesh=mesh,
        radar=warpsar.Radar(frequency_hz=place.frequency_hz, polarizations=("VV",), max_bounces=3),
        grid=warpsar.Grid(shape=shape, spacing_m=(pixel, pixel)),
        materials={name: warpsar.Material(**place.materials[name]) for name in mesh.materials},
        views=[],
        sampling=warpsar.Sampling(rays_per_pixel=RAYS),
        collection=Collection(focus="direct", slant_range_m=1e6, scatterers_per_cell=4.0),
        effects={"point_spread": effect("point_spread", place.width_m)},
    )


def effect(name: str, width: float | None = None) -> dict[str, Any]:
    table: dict[str, Any] = {"strength": 1.0, "max_bounces": 3}
    if width is not None:
        table = {"range_fwhm_m": width, "azimuth_fwhm_m": width, "window": "taylor"}
    return validate(name, table, f"effects.{name}")


def both(place: Place, base: warpsar.Scene, look: Direction, draws: int, seed: int) -> tuple[F64, F64]:
    """The power of one look by pixel: the mean over draws of its complex images, and the image of power."""
    view = warpsar.View(name="look", azimuth_deg=look.azimuth_deg, incidence_deg=place.incidence_deg)
    seen = replace(base, radar=base.radar.model_copy(update={"frequency_hz": look.frequency_hz}), views=[view])
    power = replace(seen, collection=None, effects={**seen.effects, "multibounce": effect("multibounce")})
    image = warpsar.simulate(power, seed=seed)[0].beta0["VV"].astype(float)
    mirrors = {name: warpsar.Material(**table) for name, table in place.smooth.items()}
    seen = replace(seen, materials={**seen.materials, **mirrors})

    def fields(seed: int, terms: tuple[str, ...] = seen.radar.terms) -> NDArray[np.complex128]:
        asked = replace(seen, radar=seen.radar.model_copy(update={"terms": terms}))
        return warpsar.slc(asked, seed=seed)[0].images["VV"].astype(complex)

    made = [fields(seed * draws)]
    if draws > 1:  # terms add up as fields: tubes, which take the time, are drawn once
        rest = made[0] - fields(seed * draws, ("rough",))
        made += [rest + fields(seed * draws + n, ("rough",)) for n in range(1, draws)]
    return np.mean(np.abs(made) ** 2, axis=0), image


def cells(image: F64) -> F64:
    """Means over blocks of `PIXELS` x `PIXELS`, of the last two axes."""
    rows, columns = (n // PIXELS for n in image.shape[-2:])
    cut = image[..., : rows * PIXELS, : columns * PIXELS]
    return cut.reshape(*image.shape[:-2], rows, PIXELS, columns, PIXELS).mean(axis=(-3, -1))


def decibels(power: Any) -> Any:
    with np.errstate(divide="ignore", invalid="ignore"):
        return 10.0 * np.log10(power)


def compared(slc: F64, power: F64) -> dict[str, Any]:
    """Of the powers of all looks, (looks, rows, columns): the ratio of totals, and how many cells agree."""
    totals = slc.sum(axis=(1, 2)), power.sum(axis=(1, 2))
    ratio = totals[0].mean() / totals[1].mean()
    spread = (totals[0] - ratio * totals[1]).std(ddof=1) / np.sqrt(len(slc)) / totals[0].mean()
    one, other = cells(slc), cells(power)
    error = (one - other).std(axis=0, ddof=1) / np.sqrt(len(slc))
    one, other = one.mean(axis=0), other.mean(axis=0)
    counts = np.maximum(one, other) > 10.0 ** (FAINT_DB / 10.0) * other.max()
    allowed = 10.0 ** (ALLOWED_DB / 10.0)
    agrees = (one <= allowed * other + error) & (other <= allowed * one + error)
    return {
        "totals_db": decibels(ratio),
        "totals_error_db": 10.0 / np.log(10.0) * spread,
        "cells": int(counts.sum()),
        "share": float(agrees[counts].mean()),
        "median_db": float(np.median(decibels(one / other)[counts])),
    }


def panels(figure: Any, axes: Any, width: float, slc: F64, power: F64) -> None:
    """Both means on one scale of greys, and their ratio where cells count."""
    size = [n * width / PIXELS / 2.0 for n in slc.shape]
    extent = (-size[1], size[1], size[0], -size[0])
    one, other = cells(slc), cells(power)
    top = decibels(other.max())
    for axis, image in zip(axes, (power, slc), strict=False):
        shown = axis.imshow(np.maximum(decibels(image), top - 60.0), "gray", vmin=top - 40.0, vmax=top, extent=extent)
    figure.colorbar(shown, ax=axes[:2], label="beta0 [dB]", shrink=0.85)
    counts = np.maximum(one, other) > 10.0 ** (FAINT_DB / 10.0) * other.max()
    ratio = np.where(counts, np.clip(decibels(one / other), -99.0, 99.0), np.nan)
    rows, columns = (n * width for n in ratio.shape)
    place = (-size[1], columns - size[1], rows - size[0], -size[0])
    shown = axes[2].imshow(ratio, "RdBu_r", vmin=-6.0, vmax=6.0, extent=place, interpolation="nearest")
    figure.colorbar(shown, ax=axes[2], label="[dB]", shrink=0.85)
    for axis, title in zip(
        axes, ("image of power", "mean of complex images", "the second over the first"), strict=True
    ):
        axis.set_title(title)
        axis.set_xlabel("azimuth [m]")
        axis.set_facecolor("0.75")
    axes[0].set_ylabel("slant range [m]")


def draw(names: Sequence[str], out: Path, path: Path, dpi: int) -> None:
    """The pictures of some scenes, one below the other, from their files."""
    figure = plt.figure(figsize=(11.0, 4.1 * len(names)), layout="constrained")
    for row, name in zip(np.atleast_1d(figure.subfigures(len(names), 1)), names, strict=True):
        place, made = SCENES[name](), np.load(out / f"{name}.npz")
        row.suptitle(place.words)
        axes = row.subplots(1, 3, sharex=True, sharey=True)
        panels(row, axes, place.width_m, *(made[key].astype(float).mean(axis=0) for key in ("slc", "power")))
    figure.savefig(path, dpi=dpi)
    plt.close(figure)


def one_look(name: str, looks: int, draws: int, number: int) -> tuple[F64, F64]:
    """`both` of one look of a scene."""
    place = SCENES[name]()
    seen = looks_of(place, looks)
    base = scene_of(place, seen)
    highest = max(float(material.rms_height_m) for material in base.materials.values())
    draws = draws if highest > SMOOTH_M and not place.smooth else 1
    return both(place, base, seen[number], draws, number)


def run(name: str, out: Path, looks: int, draws: int, jobs: int) -> dict[str, Any]:
    """The numbers of a scene; made, or read where its files are there."""
    told = out / f"{name}.json"
    if told.exists():
        return tables.stored(told)
    started, made = time.perf_counter(), []
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        for number, images in enumerate(pool.map(partial(one_look, name, looks, draws), range(looks))):
            made.append(images)
            print(f"{name}: look {number + 1} of {looks}, {time.perf_counter() - started:.0f} s", file=sys.stderr)
    slc, power = (np.array(images) for images in zip(*made, strict=True))
    seconds = time.perf_counter() - started
    np.savez_compressed(out / f"{name}.npz", slc=slc.astype(np.float32), power=power.astype(np.float32))
    draw([name], out, out / f"{name}.png", 72)
    found = {"name": name, "words": SCENES[name]().words, **compared(slc, power), "seconds": seconds}
    told.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return found


def main() -> None:
    parser = tables.parser(__doc__, stored=False)
    parser.add_argument("--out", type=Path, required=True, help="folder")
    parser.add_argument("--scene", choices=SCENES, action="append", help="one scene; all without it")
    parser.add_argument("--looks", type=int, default=LOOKS)
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--jobs", type=int, default=1, help="looks side by side")
    parser.add_argument("--picture", type=Path, help="a picture of all of them")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name in options.scene or SCENES:
        found = run(name, options.out, options.looks, options.draws, options.jobs)
        numbers = f"{found['totals_db']:+.2f}", f"{found['totals_error_db']:.2f}", found["cells"]
        of_cells = f"{100 * found['share']:.1f} %", f"{found['median_db']:+.2f}"
        rows.append((found["words"], *numbers, *of_cells, f"{found['seconds']:.0f}"))
    if options.picture is not None:
        draw(options.scene or list(SCENES), options.out, options.picture, 50)
    header = ("scene", "totals, complex over power [dB]", "its error [dB]", "cells above -30 dB", "of these agree",
              "their median ratio [dB]", "seconds")  # fmt: skip
    tables.publish({"engines_agree": tables.markdown(header, rows)}, {"made": tables.made()}, options.write)


if __name__ == "__main__":
    main()
