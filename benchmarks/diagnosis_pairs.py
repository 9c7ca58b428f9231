"""How often `warpsar diagnose` names two or three effects that are missing at once.

    python benchmarks/diagnosis_pairs.py run -o out/pairs --jobs 16
    python benchmarks/diagnosis_pairs.py table -o out/pairs [--write]

Every combination is drawn by its number: the scene (two of them), two or three effects of the library, their strengths
about `Effect.rate_case`, looks and speckle. One that speckle would hide is drawn again: each of its effects must be
within reach of an oracle that knows the others, and no other effect may explain as much (limits.py). A run appends one
line of JSON to runs.jsonl in the folder; runs that are there already are not made again.
docs/diagnosis-rates.md has the results.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np

from warpsar.runtime import console, devices

sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_rates
import limits
import runs
import tables
from diagnosis_rates import speckle
from pairs_scenes import SCENES

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.result import diagnose
from warpsar.effects.registry import get, names
from warpsar.io.images import write_tiff
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.tables import Material, Sampling

LOOKS = (4, 16)
KINDS = ("white", "correlated")
COMBINATIONS = 64
STRENGTH_SD = 0.3  # of the logarithm of a strength about that of `rate_case`
# What each effect must gain, over what its parameters and the family's threshold ask: with a factor 3 a detection at
# the truth lies about three standard deviations clear of them.
CLEAR = 3.0
# 2 ln L by which every rival must be behind: the difference's standard deviation, 2 sqrt(16), is then half of it.
APART = 16.0
THRESHOLD = 15.0  # 2 ln L at -ln p = 7.5 with one parameter
MOST_DRAWS = 200


@dataclass(frozen=True)
class Combination:
    """What one run is about. `gains`: the expected 2 ln L of each effect, the others known."""

    number: int
    scene: str
    effects: Mapping[str, Mapping[str, Any]]
    looks: int
    speckle: str
    gains: Mapping[str, float]
    draw: int

    @property
    def title(self) -> str:
        return f"{self.number:02d} {self.scene} {'+'.join(self.effects)}"


def strength(name: str, random: np.random.Generator, scene: Scene) -> dict[str, Any]:
    """A table of the effect with strengths drawn about its `rate_case`."""
    train = [view.name for view in scene.views if view.role == "train"]
    if name == "view_gain":
        return {"gain_db": {view: round(float(random.normal(0.0, 1.2)), 2) for view in train}}
    if name == "interference":
        view, first = str(random.choice(train)), int(random.integers(16, 44))
        factor = float(np.exp(STRENGTH_SD * random.standard_normal()))
        return {"level": {view: 0.02 * factor}, "rows": {view: [[first, first + int(random.integers(1, 4))]]}}
    found: dict[str, Any] = {}
    for key, value in get(name).rate_case.items():
        factor = float(np.exp(STRENGTH_SD * random.standard_normal()))
        if not isinstance(value, float):
            found[key] = value
        elif name == "saturation":  # neutral is 1
            found[key] = 1.0 - min((1.0 - value) * factor, 0.5)
        elif name == "exponential_spectrum":
            found[key] = min(value * factor, 0.95)
        else:
            found[key] = value * factor * (float(random.choice((-1, 1))) if value < 0 else 1.0)
    return found


def drawn(number: int, attempt: int) -> Combination:
    """Combination `number` as it is drawn for the time `attempt`; whether it can be found is not said yet."""
    random = np.random.default_rng([number, attempt])
    scene = list(SCENES)[number % len(SCENES)]
    many = 2 + number // len(SCENES) % 2
    seen = [name for name in names() if not (get(name).of_phase or get(name).of_left_out)]
    chosen = sorted(random.choice(len(seen), many, replace=False))
    effects = {seen[k]: strength(seen[k], random, SCENES[scene]()) for k in chosen}
    return Combination(number, scene, effects, int(random.choice(LOOKS)), str(random.choice(KINDS)), {}, attempt)


def within_reach(one: Combination, device: Any) -> dict[str, float] | None:
    """Expected 2 ln L of each effect over the model with the others; None where one is out of reach, or where another
    effect explains as much."""
    area = float(autocovariance(one.speckle).sum())
    found = {}
    with TemporaryDirectory() as folder:
        try:
            free = limits.NoiseFree(SCENES[one.scene](), one.effects, device, Path(folder))
        except Exception as failure:  # a table that this scene refuses
            console.say(f"{one.title}: {failure}")
            return None
        price = np.log(one.looks * free.truth.mu.size / area)
        for name in one.effects:
            base = free.fitted({n: t for n, t in one.effects.items() if n != name}, 1)
            gain = one.looks * limits.expected_gain(free.truth, base) / area
            if gain < CLEAR * max((free.truth.size - base.size) * price, THRESHOLD):
                return None
            for rival in free.rivals(base, name).values():
                behind = one.looks * limits.expected_gain(free.truth, rival) / area
                if behind < APART + (free.truth.size - rival.size) * price:
                    return None
            found[name] = round(gain, 1)
    return found


def autocovariance(kind: str) -> np.ndarray:
    return limits.white() if kind == "white" else limits.correlated(diagnosis_rates.CORRELATION_PX)


def combination(number: int, device: Any, out: Path) -> Combination:
    """The first draw of this number that can be found, kept in `out`."""
    path = out / f"combination_{number:03d}.json"
    if path.is_file():
        return Combination(**json.loads(path.read_text()))
    for attempt in range(MOST_DRAWS):
        one = drawn(number, attempt)
        gains = within_reach(one, device)
        if gains is not None:
            one = replace(one, gains=gains)
            path.write_text(json.dumps(vars(one)) + "\n")
            return one
    raise RuntimeError(f"combination {number}: none of {MOST_DRAWS} draws is within reach")


def measured(one: Combination, device: str, folder: Path) -> Scene:
    """The scene that is handed to the diagnosis: images with the effects and speckle, a start beside the truth."""
    random = np.random.default_rng([7, one.number])
    scene = SCENES[one.scene]()
    sharp = replace(
        scene, sampling=Sampling(rays_per_pixel=diagnosis_rates.CLEAN_RAYS_PER_PIXEL, seed=diagnosis_rates.CLEAN_SEED)
    )
    views = []
    made = simulate(replace(sharp, effects={n: dict(t) for n, t in one.effects.items()}), device=device)
    for view, images in zip(scene.views, made, strict=True):
        paths = {}
        for polarization, beta0 in images.beta0.items():
            paths[polarization] = folder / f"{view.name}_{polarization}.tif"
            noise = speckle(random, beta0.shape, one.looks, one.speckle == "correlated")
            write_tiff(paths[polarization], (beta0 * noise).astype(np.float32))
        views.append(view.model_copy(update={"images": paths, "looks": float(one.looks)}))
    materials = {}
    for name, true in scene.materials.items():
        a, b, c = np.exp(diagnosis_rates.START_SD * random.standard_normal(3))
        eps_r, h, length = (float(getattr(true, key)) for key in diagnosis_rates.KEYS)
        materials[name] = Material(eps_r=1 + (eps_r - 1) * a, rms_height_m=h * b, correlation_length_m=length * c)
    return replace(scene, views=views, materials=materials, sampling=Sampling(seed=one.number))


def one_run(number: int, options: DiagnoseOptions, device: str, out: Path) -> dict[str, Any]:
    """Diagnose one combination; what it says, and why the candidates of its turns were refused."""
    one = combination(number, devices.resolve_device(device), out)
    started, used = time.perf_counter(), time.process_time()
    with TemporaryDirectory() as folder:
        scene = measured(one, device, Path(folder))
        report = diagnose(scene, device=device, options=replace(options, seed=number))
    found = report.diagnosis
    return {
        **vars(one),
        "verdict": report.verdict,
        "unexplained": report.unexplained,
        "alternatives": getattr(found, "alternatives", []),
        "fitted": found.final.scene.effects,
        "turns": [
            {
                "added": turn.added,
                "dropped": turn.dropped,
                "threshold": round(turn.threshold, 2),
                "refused": {c.effect: c.refused for c in turn.candidates if c.refused},
                "not_testable": [c.effect for c in turn.candidates if c.testability == "not_testable"],
            }
            for turn in found.turns
        ],
        "test_before": report.before["test"],
        "test_after": report.after["test"],
        "seconds": round(time.perf_counter() - started, 1),
        "cpu_seconds": round(time.process_time() - used, 1),
    }


@click.group()
def main() -> None:
    """Two and three effects at once."""


@main.command()
@runs.out
@runs.first
@click.option("--combinations", default=COMBINATIONS, show_default=True, help="How many.")
@runs.jobs(1)
@runs.max_time
@runs.draws
@runs.device
def run(out: Path, first: int, combinations: int, jobs: int, max_time: float, draws: int, device: str | None) -> None:
    """Make the runs that are not in the folder yet."""
    where = devices.resolve_device(device).alias
    runs.append(
        out, range(first, first + combinations), one_run,
        lambda row: f"{'+'.join(row['effects'])}: {row['verdict']}, {row['seconds']} s",
        DiagnoseOptions(draws=draws), where, out, jobs=jobs, max_time=max_time,
    )  # fmt: skip


def judged(row: Mapping[str, Any]) -> str:
    """One word for a run: right, alternative (right but for an effect that the verdict names as an alternative), or
    what is wrong."""
    truth, verdict = set(row["effects"]), set(row["verdict"])
    if truth == verdict:
        return "unexplained too" if row["unexplained"] else "right"
    if truth <= verdict | _offered(row["alternatives"]) and len(verdict) == len(truth):
        return "alternative"
    if verdict < truth:
        return "missed"
    return "more" if verdict > truth else "wrong"


def _offered(alternatives: Any) -> set[str]:
    """Every effect that is named anywhere in a verdict's alternatives, whatever their form."""
    if isinstance(alternatives, str):
        return {alternatives} & set(names())
    if isinstance(alternatives, Mapping):
        return set().union(*(_offered(part) for pair in alternatives.items() for part in pair))
    if isinstance(alternatives, Sequence):
        return set().union(*(_offered(part) for part in alternatives))
    return set()


WORDS = ("right", "alternative", "unexplained too", "missed", "more", "wrong")


def shares(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a line per scene and number of effects."""
    lines = []
    for scene in (*SCENES, "both"):
        for many in (2, 3):
            mine = [r for r in rows if scene in (r["scene"], "both") and len(r["effects"]) == many]
            if mine:
                counts = [sum(judged(row) == word for row in mine) for word in WORDS]
                seconds = np.median([row["seconds"] for row in mine])
                share = f"{100.0 * counts[0] / len(mine):.0f} %"
                lines.append([scene, many, len(mine), share, *(n or "" for n in counts), f"{seconds:.0f} s"])
    return tables.markdown(["scene", "effects", "runs", "named exactly", *WORDS, "median time"], lines)


def failures(rows: Sequence[Mapping[str, Any]]) -> Iterator[list[Any]]:
    """A line of every run that did not name exactly what is there."""
    for row in sorted(rows, key=lambda row: row["number"]):
        if judged(row) != "right":
            lost = [f"{n}: {row['gains'][n]:.0f}" for n in row["effects"] if n not in row["verdict"]]
            said = {n: why for turn in row["turns"] for n, why in turn["refused"].items() if n in row["effects"]}
            why = "; ".join(f"{n}: {text}" for n, text in said.items() if n not in row["verdict"])
            yield [
                row["number"],
                row["scene"],
                f"{row['looks']} {row['speckle']}",
                " + ".join(row["effects"]),
                " + ".join(row["verdict"]) or "nothing",
                ", ".join(lost),
                judged(row),
                f"{row['test_before']['deviance']:.2f} to {row['test_after']['deviance']:.2f}",
                why,
            ]


@main.command()
@runs.out
@runs.write
def table(out: Path, write: bool) -> None:
    """Print the shares and the failures; write pairs.json."""
    rows = runs.stored(out)
    made = runs.oldest(rows)
    header = ["no.", "scene", "looks", "missing", "named", "expected gain", "", "test deviance", "why"]
    bodies = {"diagnosis_pairs": shares(rows), "diagnosis_pairs_failures": tables.markdown(header, failures(rows))}
    tables.save(out / "pairs.json", {**made, "runs": rows})
    tables.publish(bodies, made, write)


if __name__ == "__main__":
    main()
