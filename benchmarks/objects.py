"""Objects: a picture of each primitive, and how right derivatives, searches and intervals are.

    python benchmarks/objects.py --figure docs/figures/objects.png
    python benchmarks/objects.py --table derivatives --write
    python benchmarks/objects.py --table search --write
    python benchmarks/objects.py --table intervals --write
    python benchmarks/objects.py --table elsewhere --repeats 100

The picture is committed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_rates
import tables

from warpsar import Grid, Material, Mesh, Radar, Sampling, Scene, View, simulate
from warpsar.differentiable.geometry import exact_images
from warpsar.learning.pose_search import find_poses, group_pose
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.world.objects.table import Object

CPU = devices.resolve_device("cpu")
GROUND = Material(eps_r=6.0, rms_height_m=0.0012, correlation_length_m=0.010)
BODY = Material(eps_r=12.0, rms_height_m=0.001, correlation_length_m=0.008)
DARK = Material(eps_r=6.0, rms_height_m=1e-7, correlation_length_m=0.010)
SIDES = ((10.0, 40.0), (100.0, 45.0), (190.0, 50.0), (280.0, 40.0))
PLACE = {"position_m": (1.3, -0.8, 0.0), "heading_deg": 35.0, "material": "body"}
BOX = {"primitive": "box", "size_m": (7.0, 4.0, 5.0), **PLACE}
CAR = {"primitive": "car", "size_m": (4.6, 1.8, 1.5), **PLACE}
SHEET = {"primitive": "plate", "size_m": (0.0, 4.0, 4.0), **PLACE, "position_m": (1.3, -0.8, 3.0)}
PICTURED = {
    "box": {"size_m": (6.0, 3.0, 3.0)},
    "cylinder": {"size_m": (4.0, 4.0, 5.0)},
    "sphere": {"size_m": (5.0, 5.0, 5.0)},
    "plate": {"size_m": (0.0, 5.0, 4.0)},
    "dihedral": {"size_m": (4.0, 5.0, 4.0)},
    "trihedral": {"size_m": (5.0, 5.0, 4.0)},
    "car": {"size_m": (4.6, 1.8, 1.5), "side_curvature": 0.1},
    "truck": {"size_m": (8.0, 2.5, 3.4)},
}


def plain(sides: Any = SIDES, pixels: int = 64, spacing_m: float = 0.5) -> Scene:
    """A plain of 40 m, seen from some sides."""
    corners = 20.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    views = [View(name=f"v{k}", azimuth_deg=a, incidence_deg=i) for k, (a, i) in enumerate(sides)]
    return Scene(
        Mesh(corners, faces, np.zeros(2, np.int32), ("ground",)),
        Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        Grid(shape=(pixels, pixels), spacing_m=(spacing_m, spacing_m)),
        {"ground": GROUND},
        views,
    )


def with_one(scene: Scene, table: Mapping[str, Any], material: Material = BODY) -> Scene:
    return with_objects(scene, [Object(**table)], {"body": material})


# ---- pictures ----


def draw(path: Path) -> None:
    """Each primitive as triangles, and its image from the south-west over the stated place."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(11.0, 11.0), layout="constrained")
    for k, (name, more) in enumerate(PICTURED.items()):
        # a floor in the ground's own plane has no front
        place = (0.0, 0.0, 0.02 if name in ("dihedral", "trihedral") else 0.0)
        table = {"primitive": name, "material": "body", "position_m": place, **more}
        scene = with_one(plain([(20.0, 50.0)], 96, 0.2), table)
        assert scene.assembly is not None
        mesh = scene.assembly.placed(scene.objects[0])
        solid = figure.add_subplot(4, 4, 2 * k + 1, projection="3d")
        solid.plot_trisurf(
            *mesh.vertices.T, triangles=mesh.faces, color="tab:blue", edgecolor="k", linewidth=0.2, shade=True
        )
        solid.set_aspect("equal")
        solid.view_init(25, 60)
        solid.set_axis_off()
        solid.set_title(name)
        image = figure.add_subplot(4, 4, 2 * k + 2)
        with np.errstate(divide="ignore"):
            shown = 10.0 * np.log10(exact_images(scene, CPU)["v0"]["HH"].astype(float))
        image.set_facecolor("black")
        image.imshow(shown, cmap="gray", vmin=-25, vmax=3, extent=(-9.6, 9.6, 9.6, -9.6))
        image.set_title("azimuth [m], range [m]", fontsize=7)
        image.tick_params(labelsize=6)
    figure.savefig(path, dpi=90)


# ---- derivatives ----

CASES: dict[str, tuple[Mapping[str, Any], Material, float]] = {
    "box": (BOX, BODY, 0.5),
    "car": (CAR, BODY, 0.25),
    "a sheet that returns nothing: its shadow alone": (SHEET, DARK, 0.5),
}
MOVES = {"east": 1.0, "up": 1.0, "heading": 10.0, "scale": 0.2}  # in the unit of each, about a metre at the edge


def moved(table: Mapping[str, Any], key: str, by: float) -> dict[str, Any]:
    if key in ("east", "up"):
        return {**table, "position_m": tuple(np.add(table["position_m"], by * np.eye(3)[0 if key == "east" else 2]))}
    return {**table, "scale": 1.0 + by} if key == "scale" else {**table, "heading_deg": table["heading_deg"] + by}


def image(scene: Scene, rays: float | None) -> np.ndarray:
    if rays is None:
        return exact_images(scene, CPU)["v0"]["HH"].astype(float)
    return simulate(replace(scene, sampling=Sampling(rays_per_pixel=rays)), device="cpu")[0].beta0["HH"].astype(float)


def slope(case: str, key: str, step: float, rays: float | None = None) -> np.ndarray:
    """d beta0 per unit of the key, by a central difference over `step` metres at the edge."""
    table, material, spacing = CASES[case]
    scene, by = plain(SIDES[:1], 64, spacing), step * MOVES[key]
    up, down = (image(with_one(scene, moved(table, key, sign * by), material), rays) for sign in (1, -1))
    return (up - down) / (2.0 * by)


def derivatives() -> list[list[str]]:
    """How far differences are from those of exact images over 0.2 mm, relative to the gradient's norm, in per cent."""
    rows = []
    for case in CASES:
        for key in MOVES:
            limit = slope(case, key, 2e-4)
            row = [case, key]
            for step, rays in ((2e-3, None), (2e-2, None), (2e-2, 64.0), (2e-2, 1024.0), (0.2, 1024.0)):
                off = np.linalg.norm(slope(case, key, step, rays) - limit) / np.linalg.norm(limit)
                row.append(f"{100.0 * off:.2g} %")
            rows.append(row)
    return rows


# ---- searches and intervals ----


def measured(scene: Scene, seed: int, looks: float = 16.0) -> Scene:
    """The scene with its own images, times speckle."""
    random = np.random.default_rng(seed)
    images = exact_images(scene, CPU)

    def seen(view: View) -> View:
        speckle = random.gamma(looks, 1.0 / looks, scene.grid.shape)
        return view.model_copy(
            update={"images": {"HH": (images[view.name]["HH"] * speckle).astype(np.float32)}, "looks": looks}
        )

    return replace(scene, views=[seen(view) for view in scene.views])


def search(starts: int) -> list[list[str]]:
    """Random starts within 3 m, 20 degrees and 20 % of each size, and how many end within 0.1 m and 1 degree."""
    rows = []
    for name, table, spacing in (("box", BOX, 0.5), ("car", CAR, 0.25)):
        one = Object(**{**table, "learn": ("position", "heading", "size")})
        truth = measured(with_objects(plain(SIDES, 64, spacing), [one], {"body": BODY}), 1)
        good, spent = 0, []
        for seed in range(starts):
            random = np.random.default_rng(seed)
            shift = random.normal(size=2)
            shift *= 3.0 * np.sqrt(random.random()) / np.linalg.norm(shift)
            size = np.array(table["size_m"])
            start = one.model_copy(
                update={
                    "position_m": (1.3 + shift[0], -0.8 + shift[1], 0.0),
                    "heading_deg": 35.0 + random.uniform(-20.0, 20.0),
                    "size_m": tuple(size * random.uniform(0.8, 1.2, 3)),
                }
            )
            began = time.perf_counter()
            told = find_poses(with_objects(truth, [start]), CPU, held=True).objects[name]
            spent.append(time.perf_counter() - began)
            east, north, up = told["position_m"]
            change = np.array(told["size_m"]) - size
            # a body sunk into the ground looks like a lower one: the roof counts
            error = max(abs(east - 1.3), abs(north + 0.8), abs(up + change[2]), *np.abs(change[:2]))
            good += bool(error < 0.1 and abs(told["heading_deg"] - 35.0) < 1.0)
        rows.append([name, f"{good} of {starts}", f"{np.median(spent):.0f}"])
    return rows


def intervals(repeats: int) -> list[list[str]]:
    """Speckle drawn anew: how often 95 % intervals hold the truth, and the errors over the deviations said."""
    one = Object(**{**CAR, "learn": ("position", "heading", "scale")})
    scene = with_objects(plain(SIDES, 40, 0.25), [one], {"body": BODY})
    names = ("east", "north", "up", "heading", "scale")
    errors, said = [], []
    for seed in range(repeats):
        told = find_poses(measured(scene, 1000 + seed), CPU, search=False).objects["car"]
        found = [*told["position_m"], told["heading_deg"], told["scale"][0]]
        errors.append(np.subtract(found, [1.3, -0.8, 0.0, 35.0, 1.0]))
        said.append([*told["position_sd_m"], told["heading_sd_deg"], told["scale_sd"]])
    return coverage(names, np.array(errors), np.array(said))


def coverage(names: Sequence[str], e: np.ndarray, s: np.ndarray) -> list[list[str]]:
    """A row for each number, of errors and standard deviations of shape (repeats, numbers)."""
    held = np.abs(e) < 1.96 * s
    return [
        [name, f"{np.median(s[:, k]):.2g}", f"{np.std(e[:, k]):.2g}", f"{int(held[:, k].sum())} of {len(e)}"]
        for k, name in enumerate(names)
    ]


def elsewhere(repeats: int) -> list[list[str]]:
    """A hut that stands elsewhere than its group of the mesh: found as `diagnose` does, from where the mesh has it."""
    truth, declared = diagnosis_rates.truth(geometry="object_pose"), diagnosis_rates.truth()
    place = diagnosis_rates.ELSEWHERE
    names = ("east", "north", "up", "heading")
    errors, said = [], []
    for seed in range(repeats):
        scene = replace(declared, views=measured(truth, 2000 + seed).views)
        told = group_pose(scene, CPU, "hut").objects["hut"]
        errors.append(
            np.subtract([*told["position_m"], told["heading_deg"]], [*place["position_m"], place["heading_deg"]])
        )
        said.append([*told["position_sd_m"], told["heading_sd_deg"]])
    return coverage(names, np.array(errors), np.array(said))


HEADERS = {
    "objects.elsewhere": ["number of the hut", "sd said, median", "sd of the errors", "95 % interval holds"],
    "objects.derivatives": [
        "scene", "moves", "exact, 2 mm", "exact, 20 mm", "64 rays, 20 mm", "1024 rays, 20 mm", "1024 rays, 200 mm",
    ],
    "objects.search": ["object", "found", "seconds, median"],
    "objects.intervals": ["number of the car", "sd said, median", "sd of the errors", "95 % interval holds"],
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, help="only draw the primitives, into this file")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=40)
    parser.add_argument("--table", choices=("derivatives", "search", "intervals", "elsewhere"), help="only this one")
    tables.add_options(parser)
    options = parser.parse_args()
    if options.figure:
        draw(options.figure)
        return
    if options.source:
        result = tables.stored(options.source)
    else:
        result = {"benchmark": "objects", "made": tables.made(), "rows": {}}
        work = {
            "derivatives": derivatives,
            "search": partial(search, options.starts),
            "intervals": partial(intervals, options.repeats),
            "elsewhere": partial(elsewhere, options.repeats),
        }
        for name in [options.table] if options.table else work:
            result["rows"][f"objects.{name}"] = work[name]()
        tables.save(options.out, result)
    bodies = {name: tables.markdown(HEADERS[name], rows) for name, rows in result["rows"].items()}
    tables.publish(bodies, result, options.write)


if __name__ == "__main__":
    main()
