"""Objects: a picture of each primitive, and how right derivatives, searches and intervals are.

    python benchmarks/objects.py --figure docs/figures/objects.png
    python benchmarks/objects.py --table derivatives --write
    python benchmarks/objects.py --table search --write
    python benchmarks/objects.py --table gradients --write
    python benchmarks/objects.py --table instances --write
    python benchmarks/objects.py --table intervals --jobs 32 --write
    python benchmarks/objects.py --table elsewhere --jobs 32 --write
    python benchmarks/objects.py --table moved --jobs 32 --write      # needs WARPSAR_CASES

The picture is committed. The last three take many repeats, each with its own speckle. Each is a line of JSON in the
folder `--runs`, and is not made again.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_rates
import runs
import tables

from warpsar import Material, Mesh, Sampling, Scene, renderer, simulate
from warpsar.differentiable.geometry import exact_images
from warpsar.learning.pose_search import find_poses, group_pose
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.tables import Grid, Radar, View
from warpsar.world.world import posed

EXAMPLE = Path(__file__).resolve().parent.parent / "data" / "example" / "scene.toml"
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
CPU = devices.resolve_device("cpu")
GROUND = Material(eps_r=6.0, rms_height_m=0.0012, correlation_length_m=0.010)
BODY = Material(eps_r=12.0, rms_height_m=0.001, correlation_length_m=0.008)
DARK = Material(eps_r=6.0, rms_height_m=1e-7, correlation_length_m=0.010)
SIDES = ((10.0, 40.0), (100.0, 45.0), (190.0, 50.0), (280.0, 40.0))
PLACE = {"position_m": (1.3, -0.8, 0.0), "heading_deg": 35.0, "material": "body"}
BOX = {"primitive": "box", "size_m": (7.0, 4.0, 5.0), **PLACE}
CAR = {"primitive": "car", "size_m": (4.6, 1.8, 1.5), **PLACE}
SHEET = {"primitive": "plate", "size_m": (0.0, 4.0, 4.0), **PLACE, "position_m": (1.3, -0.8, 3.0)}


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


# ---- gradients of the renderer ----


def gradients() -> list[list[str]]:
    """Seconds of one gradient by the adjoint and by differences of exact images, and how far they lie apart."""
    every = ("position", "heading", "pitch", "roll", "scale", "size")
    scenes = {
        "box": (with_objects(plain(), [Object(**{**BOX, "learn": every})], {"body": BODY}), False),
        "car": (with_objects(plain(SIDES, 64, 0.25), [Object(**{**CAR, "learn": every})], {"body": BODY}), False),
        "box, its vertices": (with_one(plain(), BOX), True),
        "car, its vertices": (with_one(plain(SIDES, 64, 0.25), CAR), True),
        "example scene, its vertices": (Scene.load(EXAMPLE), True),
    }
    rows = []
    for name, (scene, vertices) in scenes.items():
        render = renderer(scene, device="cpu", vertices=vertices)
        values, images = render.values, render()
        free = {key: values[key] for key in render.moves.parameters}
        weights = {
            v: {p: np.random.default_rng(7).normal(size=i.shape) for p, i in o.items()} for v, o in images.items()
        }
        render.vjp(values, weights)
        began = time.perf_counter()
        gradient = render.vjp(values, weights)
        adjoint = time.perf_counter() - began
        count = sum(value.size for value in free.values())
        numbers = [(key, at) for key, value in free.items() for at in np.ndindex(value.shape)]
        chosen = (
            numbers if count <= 30 else [numbers[k] for k in np.random.default_rng(7).choice(count, 6, replace=False)]
        )
        off, total = 0.0, 0.0
        began = time.perf_counter()
        for key, at in chosen:
            along = {key: np.zeros(values[key].shape)}
            along[key][at] = 1.0
            slopes = render.jvp(values, along)
            by_difference = sum(float(np.sum(weights[v][p] * i)) for v, o in slopes.items() for p, i in o.items())
            off += (by_difference - float(gradient[key][at])) ** 2
            total += by_difference**2
        each = (time.perf_counter() - began) / len(chosen)
        apart = f"{100.0 * np.sqrt(off / total):.2g} %" if len(chosen) == count and not vertices else ""
        rows.append([name, str(count), f"{adjoint:.2g}", f"{each * count:.2g}", apart])
    return rows


# ---- instances ----


def instances() -> list[list[str]]:
    """A thousand cars of one file: seconds to load, to place again and to simulate, and the size of the arrays."""
    rows = []
    for halvings, count in ((0, 1), (0, 1000), (2, 1000)):
        with tempfile.TemporaryDirectory() as folder:
            path = car_park(Path(folder), halvings, count)
            began = time.perf_counter()
            scene = Scene.load(path)
            loaded = time.perf_counter()
            places, images = [], []
            for _ in range(3):
                at = time.perf_counter()
                posed(scene, scene.objects)
                placed = time.perf_counter()
                simulate(scene, device="cpu")
                places.append(placed - at)
                images.append(time.perf_counter() - placed)
        mesh = scene.mesh
        size = sum(array.nbytes for array in (mesh.vertices, mesh.faces, mesh.face_material)) / 2**20
        row = [f"{count:,}", f"{len(mesh.faces):,}", f"{size:.2g}"]
        spans = (loaded - began, min(places), min(images))  # the least of three: others may use the machine
        rows.append(row + [f"{span:.2g}" for span in spans])
    return rows


def car_park(folder: Path, halvings: int, count: int) -> Path:
    """A scene file with instances of one car, 6 m apart; each triangle of the car is cut into 4 `halvings` times."""
    import trimesh

    made = body(Object(**CAR))
    mesh = trimesh.Trimesh(made.vertices, made.faces, process=False)
    for _ in range(halvings):
        mesh = mesh.subdivide()
    mesh.export(folder / "car.obj")
    side = int(np.ceil(np.sqrt(count)))
    objects: list[dict[str, Any]] = [
        {"name": "floor", "primitive": "plate", "size_m": [6.0 * side, 6.0 * side, 0.0], "material": "ground"}
    ]
    for k in range(count):
        place = [6.0 * (k % side - (side - 1) / 2), 6.0 * (k // side - (side - 1) / 2), 0.0]
        heading = float(37 * k % 360)
        objects.append(
            {"name": f"c{k}", "mesh": "car.obj", "position_m": place, "heading_deg": heading, "material": "body"}
        )
    surface = ("eps_r", "rms_height_m", "correlation_length_m")
    scene = {
        "scene": {},
        "radar": {"frequency_hz": 9.6e9, "polarizations": ["HH"]},
        "image": {"shape": [512, 512], "spacing_m": [0.5, 0.5]},
        "materials": {n: {key: getattr(m, key) for key in surface} for n, m in (("ground", GROUND), ("body", BODY))},
        "objects": objects,
        "views": [{"name": "a", "azimuth_deg": 20.0, "incidence_deg": 40.0}],
    }
    path = folder / "scene.toml"
    path.write_text(tomlkit.dumps(scene))
    return path


# ---- repeats: intervals ----

MATERIAL_KEYS = ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction")


def car(seed: int) -> runs.Row:
    """A car of three views, on coarse pixels: each repeat is a whole fit."""
    one = Object(**{**CAR, "learn": ("position", "heading", "scale")})
    scene = measured(with_objects(plain(SIDES[:3], 24, 0.5), [one], {"body": BODY}), 1000 + seed)
    told = find_poses(scene, CPU, search=False).objects["car"]
    found = [*told["position_m"], told["heading_deg"], told["scale"][0]]
    said = [*told["position_sd_m"], told["heading_sd_deg"], told["scale_sd"]]
    return interval(("east", "north", "up", "heading", "scale"), found, said, (1.3, -0.8, 0.0, 35.0, 1.0))


def hut(seed: int) -> runs.Row:
    """A hut that stands elsewhere than its group of the mesh: found as `diagnose` does, from where the mesh has it."""
    truth, declared = diagnosis_rates.truth(geometry="object_pose"), diagnosis_rates.truth()
    place = diagnosis_rates.ELSEWHERE
    scene = replace(declared, views=measured(truth, 2000 + seed).views)
    return group_interval(scene, "hut", place["position_m"], place["heading_deg"])


def tower(seed: int) -> runs.Row:
    """The case moved_object of WARPSAR_CASES, with images of its true pose and surfaces by the project's own engine."""
    folder = Path(os.environ["WARPSAR_CASES"]) / "moved_object"
    told = json.loads((folder / "truth.json").read_text())
    _, east, north, turn = told["effects"]["moved"]
    pose = {"position_m": (east, north, 0.0), "heading_deg": turn}
    return group_interval(fresh_images(folder, pose, told, seed), "tower", **pose)


def fresh_images(folder: Path, pose: Mapping[str, Any], told: Mapping[str, Any], seed: int) -> Scene:
    """The case's scene file, with speckle of `seed` on the images of the truth."""
    declared, images = _clean_tower(folder, json.dumps(pose), json.dumps(told["materials"]))
    random = np.random.default_rng(3000 + seed)
    views = []
    for view in declared.views:
        assert view.looks is not None
        speckle = random.gamma(view.looks, 1.0 / view.looks, declared.grid.shape)
        seen = (images[view.name]["HH"] * speckle).astype(np.float32)
        views.append(view.model_copy(update={"images": {"HH": seen}}))
    return replace(declared, views=views)


@cache
def _clean_tower(folder: Path, pose: str, materials: str) -> tuple[Scene, Any]:
    declared = Scene.load(folder / "scene.toml")
    true = {
        name: Material(**dict(zip(MATERIAL_KEYS, values, strict=True)))
        for name, values in json.loads(materials).items()
    }
    return declared, exact_images(with_objects(declared, [Object(group="tower", **json.loads(pose))], true), CPU)


def group_interval(scene: Scene, group: str, position_m: tuple[float, ...], heading_deg: float) -> runs.Row:
    told = group_pose(scene, CPU, group).objects[group]
    found, said = [*told["position_m"], told["heading_deg"]], [*told["position_sd_m"], told["heading_sd_deg"]]
    return interval(("east", "north", "up", "heading"), found, said, (*position_m, heading_deg))


def interval(names: Sequence[str], found: Sequence[float], said: Sequence[float], truth: Any) -> runs.Row:
    return {"names": list(names), "error": np.subtract(found, truth).tolist(), "sd": list(map(float, said))}


def coverage(found: Sequence[runs.Row]) -> list[list[str]]:
    """A row for each number: how often its 95 % interval holds the truth, and the errors over the deviations said."""
    e, s = (np.array([one[key] for one in found]) for key in ("error", "sd"))
    held = np.abs(e) < 1.96 * s
    return [
        [name, f"{np.median(s[:, k]):.2g}", f"{np.std(e[:, k]):.2g}", f"{int(held[:, k].sum())} of {len(e)}"]
        for k, name in enumerate(found[0]["names"])
    ]


STUDIES: dict[str, Callable[[int], runs.Row]] = {"intervals": car, "elsewhere": hut, "moved": tower}


def repeat(seed: int, name: str) -> runs.Row:
    return {"number": seed, **STUDIES[name](seed)}


HEADERS = {
    "objects.derivatives": [
        "scene", "moves", "exact, 2 mm", "exact, 20 mm", "64 rays, 20 mm", "1024 rays, 20 mm", "1024 rays, 200 mm",
    ],
    "objects.search": ["object", "found", "seconds, median"],
    "objects.intervals": ["number of the car", "sd said, median", "sd of the errors", "95 % interval holds"],
    "objects.elsewhere": ["number of the hut", "sd said, median", "sd of the errors", "95 % interval holds"],
    "objects.moved": ["number of the tower", "sd said, median", "sd of the errors", "95 % interval holds"],
    "objects.gradients": ["scene", "numbers", "adjoint [s]", "differences [s]", "apart"],
    "objects.instances": ["cars", "triangles", "arrays [MiB]", "load [s]", "place again [s]", "simulate [s]"],
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--figure", type=Path, help="only draw the primitives, into this file")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1, help="repeats side by side, a core for each")
    parser.add_argument("--runs", type=Path, default=Path("out/objects"), help="folder of the repeats")
    plain_tables = ("derivatives", "search", "gradients", "instances")
    parser.add_argument(
        "--table", choices=(*plain_tables, *STUDIES), help="only this one; default: those without repeats"
    )
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
            "gradients": gradients,
            "instances": instances,
        }
        if options.table in STUDIES:
            folder = options.runs / options.table
            runs.append(
                folder, range(options.repeats), repeat, lambda one: f"{options.table} {one['number']}", options.table,
                jobs=options.jobs,
            )  # fmt: skip
            found = runs.stored(folder)
            result |= runs.oldest(found)
            result["rows"][f"objects.{options.table}"] = coverage(found)
        else:
            for name in [options.table] if options.table else work:
                result["rows"][f"objects.{name}"] = work[name]()
        tables.save(options.out, result)
    bodies = {name: tables.markdown(HEADERS[name], rows) for name, rows in result["rows"].items()}
    tables.publish(bodies, result, options.write)


if __name__ == "__main__":
    main()
