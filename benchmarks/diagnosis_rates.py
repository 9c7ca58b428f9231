"""How often `warpsar diagnose` is right: images of the project's own renderer with an effect that the scene file does
not declare (`Effect.rate_case`), with nothing missing, with several effects, and with what no effect explains.

    python benchmarks/diagnosis_rates.py run -o out/rates --case none --looks 16 --repeats 100
    python benchmarks/diagnosis_rates.py run -o out/rates                # all cases, looks and kinds of speckle
    python benchmarks/diagnosis_rates.py table -o out/rates [--write]

A run appends one line of JSON to runs.jsonl in the folder; runs that are there already are not made again. Every run
has its own speckle, its own rays and its own wrong start. docs/diagnosis-rates.md has the results.
"""

import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np
import runs
import tables
from towns import KEYS, seeing, speckled

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.geometry.registry import is_geometry
from warpsar.diagnosis.models.change import without_object
from warpsar.diagnosis.result import diagnose
from warpsar.effects.registry import get, names
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.speckle.law import Law
from warpsar.world.mesh import Mesh
from warpsar.world.objects.table import Object
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

TRUTH = {
    "ground": (6.0, 0.0012, 0.010),
    "wall": (9.0, 0.0010, 0.006),
    "roof": (4.0, 0.0008, 0.008),
}
START_SD = 0.25  # of ln(eps_r - 1), ln h, ln l about the truth
CLEAN_RAYS_PER_PIXEL = 2048.0
CLEAN_SEED = 90001
LOOKS = (1, 4, 16)
# azimuth, incidence, role
VIEWS = ((10, 38, "train"), (100, 46, "train"), (195, 52, "train"), (280, 42, "train"), (55, 48, "test"))


@dataclass(frozen=True)
class RateCase:
    """`effects`: what the images hold and the scene does not declare; `names`: what a right verdict says."""

    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    outside: str = ""
    geometry: str = ""  # what the images do with the hut, or a container more

    @property
    def names(self) -> set[str]:
        return {*self.effects, *([self.geometry] if self.geometry else [])}


SINGLE: dict[str, dict[str, Any]] = {
    name: get(name).rate_case for name in names() if not (get(name).of_phase or get(name).of_left_out)
}
CASES: dict[str, RateCase] = {
    "none": RateCase(),
    **{name: RateCase({name: table}) for name, table in SINGLE.items()},
    **{
        "+".join(names): RateCase({name: SINGLE[name] for name in names})
        for names in (
            ("noise_floor", "point_spread"),
            ("multibounce", "antenna_pattern"),
            ("multibounce", "registration"),
            ("noise_floor", "multibounce", "registration"),
        )
    },
    "an object elsewhere": RateCase(geometry="object_pose"),
    "an object not there": RateCase(geometry="absent_object"),
    "an object missing": RateCase(geometry="missing_object"),
    "a mover's smear": RateCase(outside="smear"),
}
ELSEWHERE = {"position_m": (0.6, -0.4, 0.0), "heading_deg": 6.0}  # of the hut, in the images
HUT = slice(22, 32)  # its faces
SMEAR_ROWS, SMEAR_COLS = slice(28, 30), slice(22, 40)


def mesh(extra: bool = False) -> Mesh:
    """Level ground of 28 m, a house in L shape and a hut; `extra`: a container of wall material beside them."""
    boxes = [((-7, -6, 0), (3, -1, 6)), ((-7, -1, 0), (-2, 6, 4)), ((5, 3, 0), (9, 8, 3))]
    boxes += [((6, -7, 0), (8, -4, 2))] if extra else []
    vertices = [[-14, -14, 0], [14, -14, 0], [14, 14, 0], [-14, 14, 0]]
    faces, material = [[0, 1, 2], [0, 2, 3]], [0, 0]
    for low, high in boxes:
        n = len(vertices)
        vertices += [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i, j, k in product((0, 1), repeat=3)]
        sides = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6))
        for a, b, c, d in sides:
            faces += [[n + a, n + b, n + c], [n + a, n + c, n + d]]
            material += [1, 1]
        faces += [[n + 1, n + 5, n + 7], [n + 1, n + 7, n + 3]]
        material += [2, 2]
    groups = {"hut": np.arange(len(faces), dtype=np.int32)[HUT]}
    arrays = np.array(vertices, float), np.array(faces, np.int32), np.array(material, np.int32)
    return Mesh(*arrays, tuple(TRUTH), groups=groups)


def truth(extra: bool = False, geometry: str = "") -> Scene:
    """What the images hold; without `geometry`, what the scene file says."""
    scene = declared_scene(extra)
    if geometry == "object_pose":
        return with_objects(scene, [Object(group="hut", **ELSEWHERE)])
    return without_object(scene, scene, "hut") if geometry == "absent_object" else scene


def declared_scene(extra: bool) -> Scene:
    return Scene(
        mesh=mesh(extra),
        radar=Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        grid=Grid(shape=(64, 64), spacing_m=(0.5, 0.5)),
        materials={name: Material(**dict(zip(KEYS, values, strict=True))) for name, values in TRUTH.items()},
        views=[View(name=f"v{i}", azimuth_deg=a, incidence_deg=b, role=role) for i, (a, b, role) in enumerate(VIEWS)],
        sampling=Sampling(rays_per_pixel=CLEAN_RAYS_PER_PIXEL, seed=CLEAN_SEED),
    )


def clean_images(case: RateCase, device: str | None, folder: Path, name: str) -> list[np.ndarray]:
    """beta0 of every view without speckle, kept in `folder`."""
    path = folder / f"clean_{'_'.join(name.replace(chr(39), '').split())}.npz"
    if not path.is_file():
        scene = truth(case.geometry == "missing_object", case.geometry)
        scene = replace(scene, effects={n: dict(t) for n, t in case.effects.items()})
        images = [one.beta0["HH"] for one in simulate(scene, device=device)]
        if case.outside == "smear":  # one object's power along a row, in one view, as bright as a roof's edge
            level = 2.0 * float(np.median(images[1][images[1] > 0]))
            images[1][SMEAR_ROWS, SMEAR_COLS] += level
        np.savez(path, *images)
    with np.load(path) as stored:
        return [stored[key] for key in stored.files]


def measured(images: Sequence[np.ndarray], looks: int, correlated: bool, seed: int) -> Scene:
    """The scene that is handed to the diagnosis: images with speckle of `seed`, and a start beside the truth."""
    random = np.random.default_rng([seed, looks, int(correlated)])
    scene = truth()
    found = dict(zip((view.name for view in scene.views), images, strict=True))

    def seen(view: View) -> np.ndarray:
        return found[view.name] * speckled(random, Law(looks), found[view.name].shape, correlated)

    views = [view.model_copy(update={"looks": float(looks)}) for view in seeing(scene.views, seen)]
    materials = {}
    for name, (eps_r, h, length) in TRUTH.items():
        a, b, c = np.exp(START_SD * random.standard_normal(3))
        materials[name] = Material(eps_r=1 + (eps_r - 1) * a, rms_height_m=h * b, correlation_length_m=length * c)
    return replace(scene, views=views, materials=materials, sampling=Sampling(seed=seed))


def one_run(key: tuple[str, int, str, int], options: DiagnoseOptions, device: str, out: Path) -> dict[str, Any]:
    name, looks, kind, seed = key
    correlated = kind == "correlated"
    started, used = time.perf_counter(), time.process_time()
    images = clean_images(CASES[name], device, out, name)
    scene = measured(images, looks, correlated, seed)
    report = diagnose(scene, device=device, options=replace(options, seed=seed))
    found = report.diagnosis
    spot = found.turns[-1].spot
    return {
        "case": name,
        "looks": looks,
        "speckle": kind,
        "seed": seed,
        "verdict": report.verdict,
        "unexplained": report.unexplained,
        "alternatives": [[one.effect, one.other] for one, _ in report.alternatives],
        "withdrawn": report.diagnosis.withdrawn,
        "spot": [found.observations[spot.observation].view.name, spot.row, spot.col, spot.window],
        "effects": found.final.scene.effects,
        "objects": found.objects,
        "turns": len(found.turns),
        "bodies": sorted({c.effect for turn in found.turns for c in turn.candidates if is_geometry(c.effect)}),
        "scores": {c.effect: round(c.minus_log_p, 2) for c in found.turns[0].candidates if c.testability == "testable"},
        "not_testable": [c.effect for c in found.turns[0].candidates if c.testability == "not_testable"],
        "test_before": report.before["test"],
        "test_after": report.after["test"],
        "rays_per_pixel": found.density.rays_per_pixel,
        "family_error": options.family_error,
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(time.process_time() - used, 1),
    }


def wanted(
    cases: Sequence[str], looks: Sequence[int], kinds: Sequence[str], repeats: int | None
) -> Iterator[tuple[str, int, str, int]]:
    """Runs in an order in which every prefix is balanced."""
    most = {name: repeats or (100 if name == "none" else 20) for name in cases}
    for seed in range(max(most.values())):
        for name, number, kind in product(cases, looks, kinds):
            if seed < most[name]:
                yield name, number, kind, seed


@click.group()
def main() -> None:
    """Detection and false-alarm rates of `warpsar diagnose`."""


@main.command()
@runs.out
@click.option("--case", "cases", multiple=True, type=click.Choice(list(CASES)), help="Repeatable; default: all.")
@click.option("--looks", multiple=True, type=click.Choice([str(n) for n in LOOKS]), help="Repeatable; default: all.")
@click.option("--speckle", "kinds", multiple=True, type=click.Choice(["white", "correlated"]), help="Default: both.")
@click.option("--repeats", type=click.IntRange(min=1), help="Default: 100 of none, 20 of each other case.")
@runs.jobs(1)
@runs.max_time
@click.option("--family-error", type=float, default=DiagnoseOptions.family_error, show_default=True)
@runs.draws
@runs.device
def run(
    out: Path,
    cases: tuple[str, ...],
    looks: tuple[str, ...],
    kinds: tuple[str, ...],
    repeats: int | None,
    jobs: int,
    max_time: float,
    family_error: float,
    draws: int,
    device: str | None,
) -> None:
    """Make the runs that are not in the folder yet."""
    out.mkdir(parents=True, exist_ok=True)
    options = DiagnoseOptions(family_error=family_error, draws=draws)
    where = devices.resolve_device(device)
    end = time.perf_counter() + max_time
    cases = cases or tuple(CASES)
    for name in cases:
        clean_images(CASES[name], where.alias, out, name)
    numbers = [int(n) for n in looks] or list(LOOKS)
    runs.append(
        out, wanted(cases, numbers, kinds or ("white", "correlated"), repeats), one_run,
        lambda row: f"{row['case']}, {row['looks']} looks, {row['speckle']}, seed {row['seed']}: {row['verdict']}"
        f"{' unexplained' if row['unexplained'] else ''}, {row['seconds']} s",
        options, where.alias, out, jobs=jobs, max_time=end - time.perf_counter(),
        key_of=lambda row: (row["case"], row["looks"], row["speckle"], row["seed"]),
    )  # fmt: skip


def judged(row: Mapping[str, Any]) -> str:
    """One word for a run: right, missed (less than the truth), not testable (missed, and said to be so), more (the
    truth and something else), alternative (another name, and the truth given as its alternative), wrong."""
    case, verdict = CASES[row["case"]], set(row["verdict"])
    if case.outside:
        if verdict:
            return "wrong"
        return "right" if row["unexplained"] else "missed"
    swapped = (verdict - {a} | {b} for a, b in row.get("alternatives", []))
    if verdict != case.names and not row["unexplained"] and any(other == case.names for other in swapped):
        return "alternative"
    if verdict == case.names:
        return "unexplained too" if row["unexplained"] else "right"
    if verdict < case.names and not row["unexplained"] and case.names - verdict <= set(row["not_testable"]):
        return "not testable"
    if verdict < case.names:
        return "unexplained" if row["unexplained"] and not verdict else "missed"
    return "more" if verdict > case.names else "wrong"


WORDS = ("alternative", "unexplained too", "more", "not testable", "missed", "unexplained", "wrong")


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """A line per case, both kinds of speckle together."""
    lines = []
    for name in CASES:
        mine = [row for row in rows if row["case"] == name]
        if not mine:
            continue
        others = Counter(other for row in mine for other in set(row["verdict"]) - CASES[name].names)
        by_looks = [[judged(row) == "right" for row in mine if row["looks"] == looks] for looks in LOOKS]
        counts = Counter(judged(row) for row in mine)
        said = ", ".join(f"{other} {n}" for other, n in sorted(others.items()))
        right = [f"{sum(found)} of {len(found)}" for found in by_looks]
        lines.append([name, len(mine), *right, *(counts[word] or "" for word in WORDS), said])
    header = ["in the images", "runs", "right at 1", "4", "16 looks", *WORDS, "named instead or besides"]
    return {"diagnosis_rates": tables.markdown(header, lines)}


if __name__ == "__main__":
    sys.exit(main())
