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
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import btr70_checks as checks
import btr70_parts as parts
import btr70_shape as shapes
import tables
from btr70_jobs import Job, done
from btr70_measures import Chip, judged, rivals, turn_deg
from btr70_model import (
    FLASH,
    LADDER,
    PARTS,
    SPACING_M,
    begun_with,
    fitted,
    held_out,
    only,
    predicted,
    regions,
    with_aim_points,
    with_other_rays,
    with_tables,
    write_scene,
)
from btr70_tables import tables_of
from measured_loop import kept, written

from warpsar.measured import jpeg
from warpsar.measured.chips import import_chips
from warpsar.scene.scene import Scene

# 17 degrees of depression, none from the sectors below
TRAIN = tuple(Path(__file__).with_name("btr70_train.txt").read_text(encoding="utf-8").split())
SECTORS_DEG = ((85.0, 115.0), (205.0, 235.0), (315.0, 345.0))
"""Sectors without a train view. Sectors that the folder may lack are found by their distance from all train views."""
FAR_DEG = 6.0
FOLDS, ARCS = 3, 3  # the train views are left out in as many parts, each of as many arcs of neighbours
LAST = 6  # iterations of the final fit, which begins where the last one ended
EXPERIMENT = 24  # views of the sectors on which bounces and orders are looked at
CHUNK = 10  # views of one job
MEASURES = ("correlation", "best_shift", "deviance")


def folder_of(data: Path) -> Path:
    """The folder of the chips: DATA itself where it has a views.csv."""
    return data if (data / "views.csv").exists() else data / "mstar_btr70"


def chips_of(data: Path) -> list[Chip]:
    """Every chip in the folder that views.csv names, radar on top."""
    folder = folder_of(data)
    with (folder / "views.csv").open(newline="", encoding="utf-8") as stream:
        rows = {row["chip"]: row for row in csv.DictReader(stream)}
    found = []
    for path in sorted((folder / "chips").glob("*.jpeg")):
        if (row := rows.get(path.stem)) is not None:
            power = jpeg.read(path)[0][::-1].astype(float) ** 2
            found.append(Chip(path.stem, float(row["azimuth_deg"]), float(row["depression_deg"]), power))
    return found


def set_of(chip: Chip, train: Sequence[Chip]) -> str:
    """Which question a test view answers: `sector` (an azimuth never trained on), `depression`, both, or `between`."""
    inside = any(low <= chip.azimuth_deg % 360.0 <= high for low, high in SECTORS_DEG)
    far = all(abs(turn_deg(chip.azimuth_deg, one.azimuth_deg)) > FAR_DEG for one in train)
    shallow = chip.depression_deg < 16.0
    if inside or far:
        return "sector_15" if shallow else "sector"
    return "depression" if shallow else "between"


def folds(train: Sequence[Chip]) -> list[tuple[str, ...]]:
    """The train chips in `FOLDS` parts. Each has arcs of neighbours, so the chips left out are not among their like."""
    ordered = sorted(train, key=lambda chip: chip.azimuth_deg)
    arcs = np.array_split([chip.name for chip in ordered], FOLDS * ARCS)
    return [tuple(str(name) for arc in arcs[k::FOLDS] for name in arc) for k in range(FOLDS)]


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


def tried(
    source: Path,
    to: Path,
    left_out: Sequence[Chip],
    names: Sequence[str],
    rung: tuple[str, dict[str, Any]] | None = None,
    mesh: Path | None = None,
) -> dict[str, Any]:
    """Fits the scene in `source` on the views `names`, with one effect more, and keeps it in `to`; the scores of the
    chips that were left out."""
    begun = only(Scene.load(source), names)
    if rung is not None and mesh is not None:
        begun = begun_with(begun, *rung, mesh)
    found, loss = fitted(begun)
    found.save(to / "scene.toml")
    return {"loss": loss, "scores": held_out(found, left_out)}


def settled(source: Path, to: Path, left_out: Sequence[Chip], names: Sequence[str]) -> dict[str, Any]:
    """`tried` with nothing new: on other rays, with as many iterations more."""
    begun = with_other_rays(only(Scene.load(source), names))
    found, loss = fitted(begun)
    return {"loss": loss, "scores": held_out(found, left_out)}


def standing(source: Path, to: Path, tables_of_objects: shapes.Tables) -> dict[str, Any]:
    """Keeps the scene in `source` in `to`, with other tables of its objects."""
    with_tables(Scene.load(source), tables_of_objects).save(to / "scene.toml")
    return {}


def mean_and_error(gain: np.ndarray) -> tuple[float, float]:
    return float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(gain.size))


@dataclass
class Ladder:
    """Trials on the train chips, a third of them left out at a time; `now` holds the best scene of each third.

    A trial stays if the gain of the chips left out, less its standard error, is above the noise: what a fit with
    nothing new may gain, its mean and one standard error. `noise` is that of the model of the moment.
    """

    out: Path
    train: Sequence[Chip]
    processes: int
    now: list[Path]
    scores: np.ndarray | None = None
    noise: float | None = None
    steps: list[dict[str, Any]] = field(default_factory=list)

    @property
    def left(self) -> list[list[Chip]]:
        """The chips that each scene of `now` leaves out."""
        return [[chip for chip in self.train if chip.name in fold] for fold in folds(self.train)]

    def scored(self, name: str, make: Callable[..., dict[str, Any]], *more: Any) -> tuple[np.ndarray, list[Path]]:
        """The scores of the chips left out, fold after fold, of what `make` fits to the others."""
        to = [self.out / f"{name}_{k}" for k in range(FOLDS)]
        jobs = []
        for k, left in enumerate(self.left):
            rest = [chip.name for chip in self.train if chip not in left]
            jobs.append(Job(to[k].with_suffix(".json"), make, (self.now[k], to[k], left, rest, *more)))
        return np.concatenate([one["scores"] for one in done(jobs, self.processes)]), to

    def turn(self, name: str, label: str, *rung: Any) -> None:
        """Tries one thing."""
        scores, to = self.scored(name, tried, *rung)
        if self.scores is None:
            self.now, self.scores = [folder / "scene.toml" for folder in to], scores
            return
        if self.noise is None:
            again, _ = self.scored(f"{self.now[0].parent.name.removesuffix('_0')}_again", settled)
            mean, error = mean_and_error(self.scores - again)
            self.noise = max(mean, 0.0) + error
        if self.judged(label, self.scores - scores):
            self.now, self.scores, self.noise = [folder / "scene.toml" for folder in to], scores, None

    def judged(self, label: str, gain: np.ndarray) -> bool:
        """Whether a trial stays; notes it."""
        mean, error = mean_and_error(gain)
        noise = self.noise or 0.0
        stays = bool(mean - error > noise)
        self.steps.append({"tried": label, "gain": mean, "error": error, "noise": noise, "stays": stays})
        verdict = "stays" if stays else "goes"
        print(f"{label}: left-out gain {mean:+.4f} +- {error:.4f}, noise {noise:.4f}: {verdict}", file=sys.stderr)
        return stays

    def shaped(self, name: str, label: str, begun: shapes.Tables, *, near: bool) -> dict[str, Any]:
        """Moves size and slope, and keeps them where they stay."""
        profiles = shapes.Profiles(self.now, self.left, self.out / name, self.processes)
        found = shapes.shape(profiles, begun, near=near)
        if not self.judged(label, np.array(found["gains"])):
            return found | {"tables": begun}
        to = [self.out / f"{name}_{k}" for k in range(FOLDS)]
        both = zip(self.now, to, strict=True)
        done([Job(one.with_suffix(".json"), standing, (at, one, found["tables"])) for at, one in both], 1)
        self.now, self.noise = [folder / "scene.toml" for folder in to], None
        self.scores = np.concatenate([held_out(Scene.load(p), c) for p, c in zip(self.now, self.left, strict=True)])
        return found


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


def tested(
    out: Path, scenes: dict[str, Path], chips: Sequence[Chip], train: Sequence[Chip], processes: int
) -> list[dict[str, Any]]:
    """All measures of every test view; what this scene was asked before is not made again."""
    folder = out / f"views_{hashlib.sha256(scenes['final'].read_bytes()).hexdigest()[:8]}"
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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("data", type=Path, help="folder of public releases")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes side by side; all cores")
    parser.add_argument("--scene", type=Path, help="predict with this scene; learn nothing")
    tables.add_write(parser)
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    made = kept(given.out / "made.json", tables.made)
    chips = chips_of(given.data)
    train = [chip for chip in chips if chip.name in TRAIN]
    place, steps, shape = given.scene, [], {}
    if place is None:
        place, steps, shape = learned(given.data, given.out, train, given.jobs)
    scenes = {"final": place}
    if len(train) == len(TRAIN):
        scenes["declared"] = prepare(given.data, given.out)
    views = tested(given.out, scenes, chips, train, given.jobs)
    known = shape | what_is_known(given.out, place, chips, train, given.jobs) if steps else {}
    final = Scene.load(place)
    bodies = [one for one in final.objects if one.mesh is not None]
    content = {
        "made": made,
        "views": views,
        "verdict": [step["tried"] for step in steps if step.get("stays")],
        "scene": str(place),
        "pose": {key: getattr(bodies[0], key) for key in ("position_m", "heading_deg", "roll_deg", "pitch_deg")},
        "size_m": checks.size_m(final),
        "effects": {key: value for key, value in final.effects.items() if key != "aim_point"},
        "materials": {name: one.model_dump(exclude_unset=True, mode="json") for name, one in final.materials.items()},
        "steps": steps,
        "checks": known,
    }
    found = tables_of(content)
    written(given.out, "btr70", json.loads(json.dumps(content, default=float)), found)
    tables.publish(found, content, given.write)


if __name__ == "__main__":
    main()
