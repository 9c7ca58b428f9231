"""How long `warpsar diagnose` takes, by phase, and how much work it does: seconds of wall and CPU, images, Jacobians.

    python benchmarks/diagnosis_time.py run CASE... -o out/diagnosis_time [--device cuda]
    python benchmarks/diagnosis_time.py table -o out/diagnosis_time [--write]

A CASE is a folder with a scene.toml. Each runs in a process of its own and leaves a JSON file. CPU seconds are those of
all threads: they depend less on what else a machine does than wall seconds. What `diagnose` announces before it begins,
for as many effects as were then found, stands beside the time that it took. docs/diagnosis-rates.md has the table.
"""

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click
import runs
import tables

from warpsar.diagnosis import command
from warpsar.diagnosis.search import loop, procedure
from warpsar.diagnosis.search.procedure import DiagnosisForecast
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices, threads

# Phase -> where its calls are made: a module or a class, and the name that is called there.
PHASES: dict[str, list[tuple[Any, str]]] = {
    "rays and pixels": [(procedure, "choose_density"), (procedure, "frozen")],
    "declared fit": [(procedure, "fit_model"), (procedure, "speckle_of"), (procedure, "refit_as")],
    "scores": [(loop, "score_effects"), (loop, "on_bounded_ground")],
    "candidates": [
        (loop, "refits"),
        (loop, "add_the_best"),
        (loop, "screened_sensor"),
        (loop, "screened_bodies"),
        (loop, "sensor_candidates"),
        (loop, "geometry_candidates"),
        (loop, "add_the_likeliest"),
        (loop, "prune"),
        (loop, "learned_law"),
    ],
    "confirmation": [
        (loop, "posed_anew"),
        (loop, "settle"),
        (loop, "resettled"),
        (loop, "trimmed"),
        (loop, "with_smaller"),
        (loop, "confirm"),
    ],
    "rivals": [(loop, "rivals_of")],
    "report": [(command, "judged"), (command, "content_of"), (command, "write_report")],
}
WORK = {
    "problems": (FitProblem, "__init__"),
    "jacobians": (FitProblem, "_modelled_and_jacobian"),
    "images": (FitProblem, "_run"),
}


def now() -> tuple[float, float]:
    return time.perf_counter(), time.process_time()


def wrapped(holder: Any, name: str, seen: Callable[[Callable[[], Any]], Any]) -> None:
    """Let `seen` make every call of `holder.name`."""
    call = getattr(holder, name)

    @wraps(call)
    def instead(*given: Any, **named: Any) -> Any:
        return seen(lambda: call(*given, **named))

    setattr(holder, name, instead)


def one_case(case: Path, out: Path, device: str) -> dict[str, Any]:
    """Diagnose a case in this process."""
    wall, cpu, work = Counter[str](), Counter[str](), Counter[str]()
    inside: list[str] = []

    def timed(phase: str) -> Callable[[Callable[[], Any]], Any]:
        def seen(call: Callable[[], Any]) -> Any:
            if inside:  # counted by the phase that it is a part of
                return call()
            inside.append(phase)
            started = now()
            try:
                return call()
            finally:
                inside.pop()
                wall[phase] += now()[0] - started[0]
                cpu[phase] += now()[1] - started[1]

        return seen

    def counted(what: str) -> Callable[[Callable[[], Any]], Any]:
        def seen(call: Callable[[], Any]) -> Any:
            work[what] += 1
            return call()

        return seen

    for phase, places in PHASES.items():
        for holder, name in places:
            wrapped(holder, name, timed(phase))
    for what, (holder, name) in WORK.items():
        wrapped(holder, name, counted(what))
    announced: list[tuple[DiagnosisForecast | None, float]] = []

    def forecast(call: Callable[[], Any]) -> Any:
        announced.append((call(), time.perf_counter()))
        return announced[-1][0]

    wrapped(procedure, "forecast", forecast)
    started = now()
    content = command.run(case / "scene.toml", out / case.name, device=device)
    whole = [b - a for a, b in zip(started, now(), strict=True)]
    ((expected, since),) = announced
    return {
        "case": case.name,
        "verdict": content["verdict"],
        "parameters": {step["effect"]: step["parameters"] for step in content["steps"]},
        "unexplained": content["unexplained"],
        "device": devices.resolve_device(device).name,
        "threads": threads.thread_count(),
        "load": os.getloadavg()[0],
        "wall_s": whole[0],
        "cpu_s": whole[1],
        "said_s": expected and expected.nothing_s + len(content["steps"]) * expected.effect_s,
        "took_s": time.perf_counter() - since,
        "phases": {phase: {"wall_s": wall[phase], "cpu_s": cpu[phase]} for phase in PHASES},
        "work": dict(work),
        "made": tables.made(),
    }


@click.group()
def main() -> None:
    """Time `warpsar diagnose`."""


out_option = click.option("-o", "--out", default="out/diagnosis_time", show_default=True, type=runs.FOLDER)


@main.command()
@click.argument("cases", nargs=-1, required=True, type=runs.FOLDER)
@out_option
@click.option("--device", default="cpu", show_default=True)
def run(cases: tuple[Path, ...], out: Path, device: str) -> None:
    """Diagnose each of CASES in a process of its own."""
    out.mkdir(parents=True, exist_ok=True)
    if len(cases) > 1:
        for case in cases:
            words = [sys.executable, __file__, "run", str(case), "-o", str(out), "--device", device]
            # the command leaves BLAS one thread, before anything loads NumPy
            subprocess.run(words, check=True, env={"OPENBLAS_NUM_THREADS": "1"} | os.environ)
        return
    result = one_case(cases[0], out, device)
    tables.save(out / f"{cases[0].name}.{device.partition(':')[0]}.json", result)
    print(json.dumps(result))


@main.command()
@out_option
@runs.write
def table(out: Path, write: bool) -> None:
    """The runs in OUT as a table."""
    stored = sorted((tables.stored(path) for path in out.glob("*.json")), key=lambda one: (one["device"], one["cpu_s"]))
    header = ["case", "device", "found", "wall", "CPU", *PHASES, "Jacobians", "images", "announced", "took"]
    rows = [
        [
            one["case"],
            one["device"],
            ", ".join(one["verdict"]) or "nothing",
            *(f"{one[key]:.0f} s" for key in ("wall_s", "cpu_s")),
            *(f"{one['phases'][phase]['cpu_s']:.1f} s" for phase in PHASES),
            one["work"]["jacobians"],
            one["work"]["images"],
            "" if one["said_s"] is None else f"{one['said_s']:.0f} s",
            f"{one['took_s']:.0f} s",
        ]
        for one in stored
    ]
    tables.publish({"diagnosis_time": tables.markdown(header, rows)}, stored[-1], write)


if __name__ == "__main__":
    main()
