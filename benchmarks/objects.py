"""How long gradients of poses and vertices take, beside differences; and scenes of a thousand objects of one file.

python benchmarks/objects.py --table gradients --write
python benchmarks/objects.py --table instances --write
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tables
import tomlkit
from scenes import EXAMPLE

from warpsar import Material, Mesh, Scene, renderer, simulate
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.tables import Grid, Radar, View
from warpsar.world.world import posed

CPU = devices.resolve_device("cpu")
GROUND = Material(eps_r=6.0, rms_height_m=0.0012, correlation_length_m=0.010)
BODY = Material(eps_r=12.0, rms_height_m=0.001, correlation_length_m=0.008)
SIDES = ((10.0, 40.0), (100.0, 45.0), (190.0, 50.0), (280.0, 40.0))
PLACE = {"position_m": (1.3, -0.8, 0.0), "heading_deg": 35.0, "material": "body"}
BOX = {"primitive": "box", "size_m": (7.0, 4.0, 5.0), **PLACE}
CAR = {"primitive": "car", "size_m": (4.6, 1.8, 1.5), **PLACE}


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


WORK: dict[str, tuple[Callable[[], list[list[str]]], list[str]]] = {
    "gradients": (gradients, ["scene", "numbers", "adjoint [s]", "differences [s]", "apart"]),
    "instances": (
        instances,
        ["cars", "triangles", "arrays [MiB]", "load [s]", "place again [s]", "simulate [s]"],
    ),
}


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--table", choices=WORK, help="only this one")
    options = parser.parse_args()
    chosen = [options.table] if options.table else WORK
    result = tables.result_of(options, lambda: {"rows": {f"objects.{name}": WORK[name][0]() for name in chosen}})
    headers = {f"objects.{name}": header for name, (_, header) in WORK.items()}
    bodies = {name: tables.markdown(headers[name], rows) for name, rows in result["rows"].items()}
    tables.publish(bodies, result, options.write)


if __name__ == "__main__":
    main()
