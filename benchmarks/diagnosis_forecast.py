"""Does `warpsar diagnose` say rightly how long it will take?

    python benchmarks/diagnosis_forecast.py run CASE... -o out/diagnosis_forecast
    python benchmarks/diagnosis_forecast.py table -o out/diagnosis_forecast [--write]

A CASE is a folder with a scene.toml. Each is diagnosed in a process of its own, on a machine that does nothing else.
What is announced before the search, for as many effects as were then found, is held against the time that it took.
docs/diagnosis-rates.md has the table.
"""

import os
import sys
import time
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).resolve().parent))

import runs
import tables
from diagnosis_time import add_run, out_option

from warpsar.diagnosis import command
from warpsar.diagnosis.search import procedure
from warpsar.diagnosis.search.procedure import DiagnosisForecast
from warpsar.runtime import devices, threads


def one_case(case: Path, out: Path, device: str) -> dict[str, Any]:
    """Diagnose a case in this process; times count from when they are announced."""
    announced: list[tuple[DiagnosisForecast, float]] = []
    forecast = procedure.forecast

    def kept(*given: Any) -> DiagnosisForecast | None:
        found = forecast(*given)
        if found is not None:
            announced.append((found, time.perf_counter()))
        return found

    procedure.forecast = kept
    content = command.run(case / "scene.toml", out / case.name, device=device)
    ((expected, since),) = announced
    took = time.perf_counter() - since
    found = len(content["steps"])
    said = expected.nothing_s + found * expected.effect_s
    return {
        "case": case.name,
        "found": found,
        "said_s": said,
        "took_s": took,
        "nothing_s": expected.nothing_s,
        "device": devices.resolve_device(device).name,
        "threads": threads.thread_count(),
        "load": os.getloadavg()[0],
        "made": tables.made(),
    }


@click.group()
def main() -> None:
    """Hold the forecast of `warpsar diagnose` against the clock."""


add_run(main, __file__, one_case)


@main.command()
@out_option(__file__)
@runs.write
def table(out: Path, write: bool) -> None:
    """The runs in OUT as a table."""
    stored = sorted((tables.stored(path) for path in out.glob("*.json")), key=lambda one: one["took_s"])
    header = ["case", "effects found", "announced for so many", "took", "took / announced"]
    rows = [
        [
            one["case"],
            one["found"],
            f"{one['said_s']:.0f} s",
            f"{one['took_s']:.0f} s",
            f"{one['took_s'] / one['said_s']:.2f}",
        ]
        for one in stored
    ]
    tables.publish({"diagnosis_forecast": tables.markdown(header, rows)}, stored[-1], write)


if __name__ == "__main__":
    main()
