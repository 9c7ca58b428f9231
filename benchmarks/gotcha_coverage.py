"""How often the intervals of the Gotcha cars hold: simulated car parks whose cars are not those of the model.

    python benchmarks/gotcha_coverage.py -o OUT [--repeats 4]

The truth is a car whose sides bow between front and rear, so it lights up where a side faces the radar, on ground
that is not quite at z = 0, with a size, a heading, a side's curvature and a bright place of its own. The fit has the
straight cars of benchmarks/gotcha.py, begins where a reading would be off, and says intervals. OUT gets
coverage.json: by number, the share of 95 % intervals that hold, and the rms error over the standard deviation that
was said.
"""

from __future__ import annotations

import argparse
import json
import runpy
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

sys.path.insert(0, str(Path(__file__).resolve().parent))

import gotcha_cars as cars
import tables
from gotcha import CAR, KNOWN_SPREAD, MAKE_OBJECTS, TRAIN, with_detail
from gotcha_objects import beside, correlation_area, described, towards_radar
from measured_loop import rounded

from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import Object
from warpsar.world.pixels import Pixels

APART_M, SIDE = 18.0, 5  # of the cars' places, and how many along either side
BOW_M = (0.05, 0.15)  # by how much a side bends in at the car's ends: radii of 18 to 50 m
APEX_M = 0.3  # standard deviation of the bow's highest point about the car's middle
GROUND_M = 0.15  # of the ground's height
FINER = 2  # times that a truth's faces are halved, so that its sides can bow
ROUNDS = 3
PLACE_M, OVER = (0.3, 0.3, 0.3), 20.0  # the size of a bright place, and its rms height over its car's, at most
LOOKS = 1.25  # as those of the measured images
RESPONSE = (0.9, 1.0)  # standard deviation of the response, in samples of 1/6 and 1/2 m: 3 x 2 to a pixel


def bowed(folder: Path, one: Object, bow_m: float, apex_m: float) -> Object:
    """The car with sides that bow in towards its ends, as a mesh."""
    made = body(one)
    corners = np.asarray(made.vertices, float)[np.asarray(made.faces)]
    for _ in range(FINER):
        a, b, c = np.moveaxis(corners, 1, 0)
        ab, bc, ca = (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0
        corners = np.concatenate(
            [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        )
    assert one.size_m is not None
    length, width, _ = one.size_m
    corners[..., 0] *= 1.0 - bow_m * ((corners[..., 1] - apex_m) / (length / 2.0)) ** 2 / (width / 2.0)
    path = folder / f"{one.name}.obj"
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in corners.reshape(-1, 3)]
    lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in range(len(corners))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Object(
        name=one.name, mesh=path, position_m=one.position_m, heading_deg=one.heading_deg, material=one.material
    )


def speckle(shape: tuple[int, int], generator: np.random.Generator) -> np.ndarray:
    """Speckle of the measured images: 3 x 2 samples of a smooth complex field to each pixel, of mean 1."""
    rows, cols = shape
    field = np.stack([gaussian_filter(generator.normal(size=(3 * rows, 2 * cols)), RESPONSE) for _ in range(2)])
    power = (field**2).sum(axis=0).reshape(rows, 3, cols, 2).mean(axis=(1, 3))
    return np.asarray(power / power.mean())


def truths(scene: Scene, folder: Path, generator: np.random.Generator) -> tuple[list[Object], list[Object]]:
    """Cars as the model would have them at the true place, and the bowed ones that the images show."""
    plain, seen = [], []
    places = (np.arange(SIDE) - (SIDE - 1) / 2.0) * APART_M
    for k, (east, north) in enumerate((e, n) for e in places for n in places):
        size = (4.6 * generator.normal(1.0, 0.05), 1.8 * generator.normal(1.0, 0.03), 1.5 * generator.normal(1.0, 0.08))
        one = Object(
            name=f"car{k:03d}",
            primitive="car",
            size_m=size,
            side_curvature=float(generator.uniform(0.02, 0.12)),
            position_m=(east, north, float(generator.normal(0.0, GROUND_M))),
            heading_deg=float(generator.normal(0.0, cars.KNOWN["heading"]) + 90.0 * (k % 3 == 0)),
            material=f"car{k:03d}",
        )
        plain.append(one)
        seen.append(bowed(folder, one, float(generator.uniform(*BOW_M)), float(generator.normal(0.0, APEX_M))))
    return plain, seen


def repeat(out: Path, seed: int) -> list[dict[str, float]]:
    """One car park: every car's errors and the standard deviations that the fit says."""
    generator = np.random.default_rng(seed)
    folder = out / f"scene{seed}"
    made = Scene.load(runpy.run_path(str(MAKE_OBJECTS))["write"](folder))
    views = [v for v in made.views if v.name in TRAIN]
    ones = Pixels(np.ones(made.grid.shape, np.float32))
    views = [v.model_copy(update={"images": {"HH": ones}, "looks": LOOKS}) for v in views]
    plain, seen = truths(made, folder, generator)
    spots = [spot(one, generator) for one in plain]
    metal = made.materials[str(made.objects[0].material)]
    levels = {str(one.material): float(np.exp(generator.normal(0.0, 0.5))) for one in plain}
    levels |= {
        str(one.material): levels[str(car.material)] * float(generator.uniform(0.0, OVER)) + 0.01
        for one, car in zip(spots, plain, strict=True)
    }
    materials = {
        name: metal.model_copy(update={"rms_height_m": metal.rms_height_m * level}) for name, level in levels.items()
    }
    truth = cars.with_effects(
        with_objects(replace(made, views=views), [*seen, *spots], materials), point_spread=KNOWN_SPREAD
    )
    images = [each.model * speckle(made.grid.shape, generator) for each in cars.seen_in(truth, TRAIN)]
    views = [
        v.model_copy(update={"images": {"HH": Pixels(image.astype(np.float32))}})
        for v, image in zip(views, images, strict=True)
    ]
    starts = [start_of(one, generator) for one in plain]
    given = with_objects(replace(made, views=views), starts, {str(one.material): metal for one in plain})
    given = with_detail(cars.with_effects(given, point_spread=KNOWN_SPREAD))
    given = cars.fit_common(given, TRAIN)
    for number in range(ROUNDS):
        given, found = cars.fit_round(given, starts, TRAIN, CAR, told=number == ROUNDS - 1)
        given = cars.fit_common(given, TRAIN)
    towards, spread = towards_radar(given), correlation_area(cars.seen_in(given, TRAIN))
    rows = []
    for k, one in enumerate(plain):
        rows.append(beside(one, described(found[k], towards, spread), towards))
    return rows


def spot(one: Object, generator: np.random.Generator) -> Object:
    """A bright place somewhere on a car: above its roof, where nothing hides it."""
    assert one.size_m is not None
    offset = generator.uniform(-0.5, 0.5, 2) * one.size_m[1::-1]
    turn = np.radians(one.heading_deg)
    east = one.position_m[0] + offset[0] * np.cos(turn) + offset[1] * np.sin(turn)
    north = one.position_m[1] - offset[0] * np.sin(turn) + offset[1] * np.cos(turn)
    name = str(one.name).replace("car", "spot")
    place = (float(east), float(north), one.size_m[2] + 0.2)
    return Object(name=name, primitive="box", size_m=PLACE_M, position_m=place, material=name)


def start_of(one: Object, generator: np.random.Generator) -> Object:
    """A common saloon where the reading would be off, facing along its row."""
    east, north, _ = one.position_m
    square = 90.0 * round(one.heading_deg / 90.0)
    place = (east + generator.normal(0.0, 0.4), north + generator.normal(0.0, 0.6), 0.0)
    return one.model_copy(
        update={"size_m": (4.6, 1.8, 1.5), "side_curvature": 0.06, "position_m": place, "heading_deg": square}
    )


NUMBERS = (("line_off_m", "line_sd_m"), ("along_off_m", "along_sd_m"))  # heading is held where it was read


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """By number: cars, share of 95 % intervals that hold, mean and rms error, rms of error over its said sd."""
    found = {}
    for off, sd in NUMBERS:
        errors, said = (np.array([row[key] for row in rows], float) for key in (off, sd))
        found[off] = {
            "cars": len(rows),
            "held_95": float(np.mean(np.abs(errors) < 1.96 * said)),
            "mean": float(errors.mean()),
            "rms": float(np.sqrt(np.mean(errors**2))),
            "rms_over_sd": float(np.sqrt(np.mean((errors / said) ** 2))),
            "sd": float(np.median(said)),
        }
    return found


def table_of(numbers: dict[str, Any]) -> str:
    words = {"line_off_m": "near side's line [m]", "along_off_m": "along it [m]"}
    head = ["error of", "mean", "rms", "standard deviation said, median", "95 % intervals that hold", "cars"]
    keys = ("mean", "rms", "sd", "held_95", "cars")
    return rounded(head, [[words[name], *(one[key] for key in keys)] for name, one in numbers.items()])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=1, help="car parks of 25 cars")
    tables.add_write(parser)
    given = parser.parse_args()
    made = tables.made()
    rows = [row for seed in range(given.repeats) for row in repeat(given.out, seed)]
    content = {"made": made, "numbers": summary(rows), "cars": rows}
    (given.out / "coverage.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    tables.publish({"gotcha.coverage": table_of(content["numbers"])}, content, given.write)


if __name__ == "__main__":
    main()
