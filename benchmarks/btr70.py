"""The loop on a measured vehicle of known shape: a BTR-70 from all sides, learned on 30 views, tested on all others.

    python benchmarks/btr70.py DATA -o OUT [--jobs N] [--scene FILE] [--write]

DATA is a folder of public releases with mstar_btr70 in it: chips/*.jpeg, views.csv, BTR70.obj. The train chips are
`TRAIN`; every other chip in the folder that views.csv names is a test view, and decides nothing. `--scene FILE` learns
nothing: it predicts with that scene. OUT gets all of it; what lies there already is not made again. btr70.json says
how near the predictions are, btr70.md the tables. The steps and their reasons: docs/measured-btr70.md.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import btr70_checks as checks
import btr70_parts as parts
import btr70_shape as shapes
import tables
from btr70_jobs import Job, done
from btr70_ladder import FOLDS, Ladder
from btr70_measures import Chip, judged, middle, rivals, turn_deg
from btr70_model import (
    FLASH,
    LADDER,
    PARTS,
    PREDICTED,
    SPACING_M,
    fitted,
    predicted,
    regions,
    with_aim_points,
    write_scene,
)
from btr70_tables import tables_of
from measured_loop import kept, written

from warpsar.errors import InputError, WarpsarError
from warpsar.formats import jpeg
from warpsar.measured.chips import import_chips
from warpsar.runtime.threads import thread_count
from warpsar.scene.scene import Scene

# 17 degrees of depression, none from the sectors below
TRAIN = tuple(Path(__file__).with_name("btr70_train.txt").read_text(encoding="utf-8").split())
SECTORS_DEG = ((85.0, 115.0), (205.0, 235.0), (315.0, 345.0))
"""Sectors without a train view. Sectors that the folder may lack are found by their distance from all train views."""
FAR_DEG = 6.0
LAST = 6  # iterations of the final fit, which begins where the last one ended
EXPERIMENT = 24  # views of the sectors on which bounces and orders are looked at
CHUNK = 10  # views of one job
MEASURES = ("correlation", "best_shift", "deviance")


def folder_of(data: Path) -> Path:
    """The folder of the chips: DATA itself where it has a views.csv. Raises InputError where there is none."""
    for folder in (data, data / "mstar_btr70"):
        if (folder / "views.csv").is_file():
            return folder
    raise InputError(f"{data}: found no views.csv, neither there nor in mstar_btr70; must have one")


def chips_of(data: Path) -> list[Chip]:
    """Every chip in the folder that views.csv names, radar on top. Raises InputError where there is none, and for one
    that is too small."""
    folder = folder_of(data)
    with (folder / "views.csv").open(newline="", encoding="utf-8") as stream:
        lines = csv.DictReader(stream)
        if missing := {"chip", "azimuth_deg", "depression_deg"} - set(lines.fieldnames or ()):
            raise InputError(f"{folder / 'views.csv'}: found no column {', '.join(sorted(missing))}; must have it")
        rows = {row["chip"]: row for row in lines}
    found, nameless = [], 0
    for path in sorted((folder / "chips").glob("*.jp*g")):
        row = rows.get(path.stem)
        if row is None:
            nameless += 1
            continue
        power = jpeg.levels(path)[0][::-1].astype(float) ** 2
        if min(power.shape) < PREDICTED:
            size = " x ".join(map(str, power.shape))
            raise InputError(f"{path}: found {size} pixels; must be at least {PREDICTED} x {PREDICTED}")
        power = middle(power, size=min(power.shape))
        found.append(Chip(path.stem, float(row["azimuth_deg"]), float(row["depression_deg"]), power))
    if nameless:
        print(f"{folder / 'chips'}: {nameless} chips are left out: views.csv does not name them", file=sys.stderr)
    if not found:
        raise InputError(f"{folder}: found no chip in chips/ that views.csv names; must have one")
    return found


def set_of(chip: Chip, train: Sequence[Chip]) -> str:
    """Which question a test view answers: `sector` (an azimuth never trained on), `depression`, both, or `between`."""
    inside = any(low <= chip.azimuth_deg % 360.0 <= high for low, high in SECTORS_DEG)
    far = all(abs(turn_deg(chip.azimuth_deg, one.azimuth_deg)) > FAR_DEG for one in train)
    shallow = chip.depression_deg < 16.0
    if inside or far:
        return "sector_15" if shallow else "sector"
    return "depression" if shallow else "between"


def prepare(data: Path, out: Path) -> Path:
    """The scene of the train views, imported as a user would, and beside it the mesh in parts."""
    path = out / "scene" / "scene.toml"
    if not path.exists():
        folder = folder_of(data)
        parts.write(folder / "BTR70.obj", path.with_name("parts.obj"))
        fresh = write_scene(path.with_name("begun.toml"), folder / "BTR70.obj")
        import_chips(
            [folder / "chips" / f"{name}.jpeg" for name in TRAIN],
            fresh,
            folder / "views.csv",
            quantity="amplitude",
            radar_at="bottom",
            spacing_m=SPACING_M,
            scale="unknown",
        )
        fresh.rename(path)
    return path


def climbed(data: Path, out: Path, train: Sequence[Chip], processes: int) -> tuple[Ladder, dict[str, Any]]:
    """Effects tried one after the other, the size as soon as the body looks like one and once more at the end."""
    declared = prepare(data, out)
    started = out / "aimed" / "scene.toml"
    if not started.exists():
        with_aim_points(Scene.load(declared), train).save(started)
    ladder = Ladder(out, train, processes, [started] * FOLDS)
    ladder.turn("begun", "begun")
    found: dict[str, Any] = {"tables": shapes.START}
    for number, (name, table) in enumerate(LADDER):
        detail = any(step["tried"] == "unresolved_detail" and step["stays"] for step in ladder.steps)
        if name in (PARTS, FLASH) and not detail:
            continue  # there is no detail to be shared out
        ladder.turn(f"tried{number}_{name}", name, (name, table), declared.with_name("parts.obj"))
        if name == "unresolved_detail":
            found = ladder.shaped("size", "size and slope", shapes.START, near=False)
    return ladder, ladder.shaped("shape", "size and slope again", found["tables"], near=True)


def finished(declared: Path, climbed_to: Path, train: Sequence[Chip], to: Path) -> dict[str, Any]:
    """The last fit: all train views."""
    every = replace(Scene.load(climbed_to), views=Scene.load(declared).views)
    found, loss = fitted(with_aim_points(every, train), LAST)
    found.save(to / "scene.toml")
    return {"loss": loss}


def learned(
    data: Path, out: Path, train: Sequence[Chip], processes: int
) -> tuple[Path, list[dict[str, Any]], dict[str, Any]]:
    """The final scene, the steps to it, and what the images say of the vehicle's attitude and size."""
    ladder, shape = climbed(data, out, train, processes)
    to = out / "final"
    done([Job(out / "final.json", finished, (prepare(data, out), ladder.now[0], train, to))], 1)
    return to / "scene.toml", ladder.steps, {"shape": shape}


def judged_chips(scenes: dict[str, Path], chips: Sequence[Chip], train: Sequence[Chip]) -> dict[str, Any]:
    """All measures of some test views, by chip. Without train chips there are no rivals."""
    models = {name: Scene.load(path) for name, path in scenes.items()}
    images = {name: predicted(scene, chips) for name, scene in models.items()}
    masks = regions(models["final"], chips)
    mean = np.mean([one.power for one in train], axis=0) if train else None
    found = {}
    for chip in chips:
        measures: dict[str, Any] = {
            name: judged(chip, image[chip.name], masks[chip.name]) for name, image in images.items()
        }
        for name, image in (rivals(chip, train, mean) if mean is not None else {}).items():
            measures[name] = judged(chip, image, {}, own=False)
        found[chip.name] = measures
    return found


def asked(scene: Path, chips: Sequence[Chip]) -> str:
    """A name for a scene with its mesh and for what it is asked: another vehicle's chips may have the same names."""
    found = hashlib.sha256(scene.read_bytes())
    found.update(Scene.load(scene).mesh.vertices.tobytes())
    for chip in chips:
        found.update(chip.power.astype(np.uint16).tobytes())
    return found.hexdigest()[:8]


def tested(
    out: Path, scenes: dict[str, Path], chips: Sequence[Chip], train: Sequence[Chip], processes: int
) -> list[dict[str, Any]]:
    """All measures of every test view; what this scene was asked before is not made again."""
    folder = out / f"views_{asked(scenes['final'], chips)}"
    unseen = [chip for chip in chips if chip.name not in TRAIN]
    measured: dict[str, Any] = {}
    for path in sorted(folder.glob("*.json")):
        measured |= json.loads(path.read_text(encoding="utf-8"))
    missing = [chip for chip in unseen if chip.name not in measured]
    some = [missing[first : first + CHUNK] for first in range(0, len(missing), CHUNK)]
    jobs = [Job(folder / f"{one[0].name}.json", judged_chips, (scenes, one, train)) for one in some]
    for one in done(jobs, processes):
        measured |= one
    content = []
    for chip in unseen:
        measures = measured[chip.name]
        same = [c for c in chips if c is not chip and abs(turn_deg(c.azimuth_deg, chip.azimuth_deg)) < 1.0]
        other = [c for c in same if (c.depression_deg < 16.0) != (chip.depression_deg < 16.0)]
        if other:
            measures["other_depression"] = judged(chip, other[0].power, {}, own=False)
        by_measure = {
            key: {n: m[key] for n, m in measures.items()} for key in ("correlation", "best_shift", "deviance")
        }
        content.append(
            {
                "chip": chip.name,
                "set": set_of(chip, train),
                "azimuth_deg": chip.azimuth_deg,
                "depression_deg": chip.depression_deg,
                **by_measure,
                "measures": measures,
            }
        )
    return content


def what_is_known(
    out: Path, final: Path, chips: Sequence[Chip], train: Sequence[Chip], processes: int
) -> dict[str, Any]:
    """The checks of btr70_checks.py on the final scene, each made once."""
    sector = [chip for chip in chips if set_of(chip, train) == "sector"]
    some = [sector[int(k)] for k in np.linspace(0, len(sector) - 1, min(EXPERIMENT, len(sector)))]
    bounces, orders, levels, widths, rounding = done(
        [
            Job(out / "bounces.json", checks.bounces, (final, some)),
            Job(out / "orders.json", checks.orders, (final, train, some)),
            Job(out / "levels.json", checks.levels, (final, train)),
            Job(out / "widths.json", checks.widths, (final, train)),
            Job(out / "rounding.json", checks.rounding, (final, train, some)),
        ],
        processes,
    )
    return {
        "coverage": shapes.coverage(final, train, out / "coverage", processes),
        "bounces": bounces,
        "orders": orders,
        "levels": levels,
        "widths": widths,
        "rounding": rounding,
    }


def pose_of(scene: Scene) -> dict[str, Any]:
    """Where the first object with a mesh stands, and its size; nothing for a scene without one."""
    body = next((one for one in scene.objects if one.mesh is not None), None)
    if body is None:
        return {"pose": {}, "size_m": []}
    pose = {key: getattr(body, key) for key in ("position_m", "heading_deg", "roll_deg", "pitch_deg")}
    return {"pose": pose, "size_m": checks.size_m(scene)}


def run(given: argparse.Namespace) -> None:
    made = kept(given.out / "made.json", tables.made)
    chips = chips_of(given.data)
    train = [chip for chip in chips if chip.name in TRAIN]
    place, steps, shape = given.scene, [], {}
    if place is None:
        if len(train) < len(TRAIN):
            seen = f"found {len(train)} of the {len(TRAIN)} train chips (btr70_train.txt)"
            raise InputError(f"{given.data}: {seen}; must have all of them, or --scene, which learns nothing")
        place, steps, shape = learned(given.data, given.out, train, given.jobs)
    final = Scene.load(place)
    scenes = {"final": place}
    if len(train) == len(TRAIN):
        scenes["declared"] = prepare(given.data, given.out)
    views = tested(given.out, scenes, chips, train, given.jobs)
    known = shape | what_is_known(given.out, place, chips, train, given.jobs) if steps else {}
    content = {
        "made": made,
        "views": views,
        "verdict": [step["tried"] for step in steps if step.get("stays")],
        "scene": str(place),
        **pose_of(final),
        "effects": {key: value for key, value in final.effects.items() if key != "aim_point"},
        "materials": {name: one.model_dump(exclude_unset=True, mode="json") for name, one in final.materials.items()},
        "steps": steps,
        "checks": known,
    }
    found = tables_of(content)
    written(given.out, "btr70", json.loads(json.dumps(content, default=float)), found)
    tables.publish(found, content, given.write)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("data", type=Path, help="folder of public releases")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=thread_count(), help="processes side by side; all cores")
    parser.add_argument("--scene", type=Path, help="predict with this scene; learn nothing")
    tables.add_write(parser)
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    try:
        run(given)
    except WarpsarError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
