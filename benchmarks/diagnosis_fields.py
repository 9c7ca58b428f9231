"""What `warpsar diagnose` finds beside learned fields: the painted building of the experiments, whose eps_r, h and l
are maps of 64 x 64 texels, with effects that the scene file does not declare.

    python benchmarks/diagnosis_fields.py run -o out/diagnosis_fields [--case NAME] [--looks N] [--repeats N]
    python benchmarks/diagnosis_fields.py table -o out/diagnosis_fields [--write]

A run appends one line of JSON to runs.jsonl in the folder; runs that are there already are not made again. Every run
has its own speckle and its own rays, and begins at uniform maps. docs/diagnosis-method.md has the results.
"""

import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import runs
import tables
from references import DATA, KEYS, changed, clean_images, measured, trained_on

from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.result import diagnose
from warpsar.effects.registry import get
from warpsar.scene.scene import Scene
from warpsar.world.pixels import Pixels

TRAIN, TEST = ("az000", "az120", "az180", "az300"), ("az060",)
START = (4.0, 0.0006, 0.0035)  # everywhere; the truth goes from 3 to 40, 0.3 to 0.9 mm and 2.5 to 5.5 mm
CASES = (
    "none",
    "noise_floor",
    "point_spread",
    "registration",
    "multibounce",
    "range_loss",
    "view_gain",
    "eps_gradient",
)
LOOKS = (1, 4, 16)


def scene_of(case: str, looks: int, seed: int, folder: Path) -> Scene:
    """The scene that is handed to the diagnosis: images with the effect and speckle, maps that are uniform."""
    scene = Scene.load(DATA / "fields" / "scene.toml")
    scene = replace(scene, sampling=scene.sampling.model_copy(update={"seed": seed}))
    scene = replace(scene, views=[view for view in scene.views if view.name in (*TRAIN, *TEST)])
    truth = scene if case == "none" else replace(scene, effects={case: _table(case)})
    given = trained_on(measured(scene, clean_images(truth), folder, float(looks), seed), TRAIN, TEST)
    shape = scene.field("site", "eps_r").shape
    maps = {key: Pixels(np.full(shape, value)) for key, value in zip(KEYS, START, strict=True)}
    return changed(given, "site", learn=KEYS, **maps)


def _table(case: str) -> dict[str, Any]:
    """The effect of `diagnosis_rates.py`; what it says of single views is dealt to the views of this scene."""
    table = dict(get(case).rate_case)
    for key, value in table.items():
        if isinstance(value, dict):
            table[key] = dict(zip((*TRAIN, *TEST), value.values(), strict=False))
    return table


def one_run(key: tuple[str, int, int], draws: int, device: str | None) -> dict[str, Any]:
    case, looks, seed = key
    with tempfile.TemporaryDirectory() as folder:
        scene = scene_of(case, looks, seed, Path(folder))
        started, used = time.perf_counter(), time.process_time()
        done = diagnose(scene, device=device, options=DiagnoseOptions(seed=seed, draws=draws))
        seconds, cpu = time.perf_counter() - started, time.process_time() - used
    found = done.diagnosis
    first = {c.effect: c for c in found.turns[0].candidates}
    return {
        "case": case,
        "looks": looks,
        "seed": seed,
        "draws": draws,
        "verdict": done.verdict,
        "unexplained": done.unexplained,
        "effects": found.final.scene.effects,
        "not_testable": [name for name, c in first.items() if c.testability == "not_testable"],
        "eta": {name: c.eta for name, c in first.items()},
        "scores": {name: c.minus_log_p for name, c in first.items()},
        "threshold": found.turns[0].threshold,
        "test_before": done.before["test"],
        "test_after": done.after["test"],
        "seconds": round(seconds, 1),
        "cpu_seconds": round(cpu, 1),
        "memory_gib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }


@click.group()
def main() -> None:
    """Diagnosis beside learned fields."""


@main.command()
@runs.out
@click.option("--case", "cases", multiple=True, type=click.Choice(CASES), help="Repeatable; default: all.")
@click.option("--looks", multiple=True, type=click.Choice([str(n) for n in LOOKS]), help="Repeatable; default: all.")
@click.option("--repeats", type=click.IntRange(min=1), default=1, show_default=True, help="Seeds from 0 on.")
@runs.draws
@runs.device
def run(
    out: Path, cases: tuple[str, ...], looks: tuple[str, ...], repeats: int, draws: int, device: str | None
) -> None:
    """Make the runs that are not in the folder yet."""
    numbers = [int(n) for n in looks] or LOOKS
    runs.append(
        out, ((case, n, seed) for seed in range(repeats) for case in cases or CASES for n in numbers), one_run,
        lambda row: f"{row['case']}, {row['looks']} looks, seed {row['seed']}: "
        f"{', '.join(row['verdict']) or 'nothing'}, {row['seconds']} s",
        draws, device, key_of=lambda row: (row["case"], row["looks"], row["seed"]),
    )  # fmt: skip


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """Markdown: a line per case and number of looks."""
    lines = []
    for case in CASES:
        for looks in LOOKS:
            mine = [row for row in rows if (row["case"], row["looks"]) == (case, looks)]
            if not mine:
                continue
            named = [" + ".join(row["verdict"]) or "nothing" for row in mine]
            said = ", ".join(f"{name} {named.count(name)}" for name in dict.fromkeys(named))
            testable = "" if case == "none" else f"{100.0 * np.median([row['eta'][case] for row in mine]):.2g} %"
            before, after = (np.median([row[key]["deviance"] for row in mine]) for key in ("test_before", "test_after"))
            lines.append(
                [
                    case,
                    looks,
                    len(mine),
                    said,
                    sum(row["unexplained"] for row in mine) or "",
                    testable,
                    sum(case in row["not_testable"] for row in mine) or "",
                    f"{before:.2f} to {after:.2f}",
                    f"{np.median([row['seconds'] for row in mine]):.0f} s",
                    f"{np.median([row['cpu_seconds'] for row in mine]):.0f} s",
                    f"{max(row['memory_gib'] for row in mine):.1f} GiB",
                ]
            )
    header = ["in the images", "looks", "runs", "named", "unexplained", "no field imitates", "not testable"]
    head = [*header, "test deviance", "time", "CPU time", "memory"]
    return {"diagnosis_fields": tables.markdown(head, lines)}


if __name__ == "__main__":
    main()
