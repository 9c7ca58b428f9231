"""How often the 95 % intervals of surfaces hold the truth, where the model has the right structure.

    python benchmarks/interval_rates.py run -o out/intervals --scenes 300
    python benchmarks/interval_rates.py table -o out/intervals [--write]

Scenes are those of search_rates.py where nothing is wrong, or things are that the search has a name for. No search is
run: the scene file has what is in the images, materials start beside the truth, and everything is fitted at once. So
the intervals alone are judged, and a scene takes seconds. A run appends one line of JSON to runs.jsonl in the folder;
runs that are there already are not made again. docs/diagnosis-rates.md has the results.
"""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import runs
import tables
from runs import bounds
from search_rates import group_of, kinds_of, started, visible
from towns import with_images

from warpsar.learning.identify import identify
from warpsar.learning.optimise import FitState, levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.profiles import with_profiles
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.world.tables import Sampling

RAYS_PER_PIXEL = 512.0
STEPS = 60
NOT_HERE = {"texture", "view_gain", "azimuth_ambiguity"}
"""The likelihood is then another one; the mean of all gains is the surface's; and copies in the dark end in pixels that
other rays miss, for which the search has a rule of its own."""


def measured(number: int, device: str) -> tuple[Scene, Scene, list[str], bool] | None:
    """The scene with images of a seed as search_rates.py makes them, started beside the truth, and the truth."""
    random = np.random.default_rng([20261124, number])
    kinds = kinds_of(number, random)
    if group_of(number) == "outside" or NOT_HERE.intersection(kinds):
        return None
    found, clean, _, correlated = visible(number, kinds, random, device)
    views = [
        view.model_copy(update={"looks": found.law[view.name].looks})
        for view in with_images(random, replace(found, declared=found.true), clean, correlated)
    ]
    sampling = Sampling(seed=number, rays_per_pixel=RAYS_PER_PIXEL)
    scene = replace(found.true, views=views, sampling=sampling)
    return replace(scene, materials=started(scene, random)), found.true, kinds, correlated


def one_run(number: int, device: str) -> dict[str, Any]:
    made = measured(number, device)
    if made is None:
        return {"number": number, "kinds": None}
    scene, true, kinds, correlated = made
    problem = FitProblem(scene, devices.resolve_device(device))
    state = FitState(problem.x0, np.inf, problem.x0, np.inf)
    for _ in range(STEPS):
        state = levenberg_marquardt(problem, state)
        if state.arrived:
            break
    x = np.asarray(state.best_x)
    found = identify(problem, x)
    begun = time.process_time()
    told = with_profiles(problem, x, found)
    seconds = time.process_time() - begun
    known, truth = scene.parameters, true.parameters
    rows = []
    for k, label in enumerate(problem.labels):
        full = known.old_names.get(label, label)
        value = float(known[full].transform.to_coordinate(truth[full].value))
        ends = told.interval_95(k, float(x[k])) - value
        sides = [None if not np.isfinite(end) else float(end) for end in ends]
        at_bound = [bool(np.isclose(end, bound[k] - value)) for end, bound in zip(ends, problem.bounds, strict=True)]
        rows.append([full, *sides, *at_bound, float(x[k]) - value, float(found.sd[k])])
    return {
        "number": number,
        "kinds": kinds,
        "looks": scene.views[0].looks,
        "views": len(scene.views),
        "correlated": correlated,
        "intervals": rows,
        "cpu_seconds": round(seconds, 2),
    }


@click.group()
def main() -> None:
    """Rates of intervals of surfaces that hold the truth."""


@main.command()
@runs.out
@runs.first
@runs.scenes(300)
@runs.jobs(2)
@runs.max_time
@runs.device
def run(out: Path, first: int, scenes: int, jobs: int, max_time: float, device: str | None) -> None:
    """Make the runs that are not in the folder yet."""
    where = devices.resolve_device(device)
    runs.append(
        out, (n for n in range(first, first + scenes) if group_of(n) != "outside"), one_run,
        lambda row: f"{row['number']}: {', '.join(row['kinds'] or ()) or 'nothing'}",
        where.alias, jobs=jobs, max_time=max_time,
    )  # fmt: skip


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """The rates of the runs that are there."""
    rows = [row for row in rows if row["kinds"] is not None]
    by_key: dict[str, list[list[Any]]] = {}
    for row in rows:
        for name, *of in row["intervals"]:
            key = name.rpartition(".")[2] if name.startswith("materials.") else "effects"
            by_key.setdefault(key, []).append(of)
            if key != "effects":
                by_key.setdefault("all of surfaces", []).append(of)
    lines = []
    for key, mine in by_key.items():
        told = [one for one in mine if one[:2] != [None, None]]
        holds = sum((low is None or low <= 0.0) and (high is None or high >= 0.0) for low, high, *_ in told)
        lines.append(
            [
                f"`{key}`" if " " not in key else key,
                len(mine),
                f"{holds} of {len(told)}",
                bounds(holds, len(told)),
                sum(a != b for _, _, a, b, *_ in told),
                f"{len(mine) - len(told)} ({100 * (len(mine) - len(told)) / len(mine):.0f} %)",
            ]
        )
    head = ["", "intervals", "hold the truth", "95 %", "of these, one end is a bound", "not told"]
    seconds = [row["cpu_seconds"] for row in rows]
    click.echo(
        f"{len(rows)} scenes; CPU seconds of the intervals: median {np.median(seconds):.2f}, most {max(seconds):.1f}"
    )
    return {"interval_rates": tables.markdown(head, lines)}


if __name__ == "__main__":
    main()
