"""Time and memory of the studies in examples/measured: the commands of their READMEs, one after the other.

    python benchmarks/measured_costs.py run $DATA -o costs [--only boxes] [--device cuda]
    python benchmarks/measured_costs.py table -o costs [--write]

The shell block of a README runs as it stands, in a copy of its folder, with $DATA as the README says. A stand-in for
`warpsar` runs each command, with --device, and notes wall time, CPU seconds of all threads, and the most memory. A run
appends lines of JSON to runs.jsonl in the folder; a study that stands there for a device is not run again. A command
that a study gives again, as `import` once for each view, has one row: its times are added.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import runs
import tables
from simulate import machine, said

STUDIES = tables.ROOT / "examples" / "measured"
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FOLDER = re.compile(r"`\$DATA`\s+is\s+the\s+folder\s+`(\w+)`")
FINE = (0, 4)  # of a command: done, and `diagnose` left a part unexplained
LOG, DEVICE = "MEASURED_COSTS_LOG", "MEASURED_COSTS_DEVICE"
GIB = 2**20  # in KiB


def studies() -> list[str]:
    """The folders that have commands."""
    return sorted(path.parent.name for path in STUDIES.glob("*/README.md"))


def commands(name: str) -> tuple[str, str]:
    """What a study's README says to run in the shell, and which folder $DATA is."""
    text = (STUDIES / name / "README.md").read_text(encoding="utf-8")
    blocks, folder = SHELL.findall(text), FOLDER.search(text)
    if not blocks or folder is None:
        raise LookupError(f"{name}/README.md: has no commands, or does not say what $DATA is")
    return "".join(blocks), folder[1]


def label(words: list[str]) -> str:
    """A command in short: its name, and the scene file where it has another name than scene.toml."""
    scene = next((word for word in words[1:] if word.endswith(".toml")), "scene.toml")
    return words[0] if Path(scene).name == "scene.toml" else f"{words[0]} {scene}"


def stand_in(words: list[str]) -> int:
    """Run one command of warpsar, and append what it cost to the log. Returns its exit status."""
    begun = time.perf_counter()
    device = os.environ[DEVICE]
    run = subprocess.Popen([sys.executable, "-m", "warpsar", *words, "--device", device])
    # of this child alone: a shell becomes the last of its commands, and then has had other children
    _, status, used = os.wait4(run.pid, 0)
    code = run.returncode = os.waitstatus_to_exitcode(status)
    row = {
        "command": label(words),
        "exit_status": code,
        "wall_s": time.perf_counter() - begun,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_gib": used.ru_maxrss / GIB,
    }
    with Path(os.environ[LOG]).open("a") as log:
        log.write(json.dumps(row) + "\n")
    return code


def added(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each command: its times are added, its memory is the most."""
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        one = found.setdefault(
            row["command"], {"command": row["command"], "wall_s": 0.0, "cpu_s": 0.0, "peak_gib": 0.0}
        )
        one |= {key: one[key] + row[key] for key in ("wall_s", "cpu_s")}
        one["peak_gib"] = max(one["peak_gib"], row["peak_gib"])
    return list(found.values())


def one_run(key: tuple[str, str], data: str) -> dict[str, Any]:
    """A study on a device. Raises RuntimeError where a command fails."""
    name, device = key
    text, of_data = commands(name)
    with TemporaryDirectory() as temporary:
        work, log = Path(temporary) / name, Path(temporary) / "log.jsonl"
        shutil.copytree(STUDIES / name, work)
        command = Path(temporary) / "bin" / "warpsar"
        command.parent.mkdir()
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{Path(__file__).resolve()}" stand-in "$@"\n')
        command.chmod(0o755)
        environment = os.environ | {
            "DATA": str(Path(data).resolve() / of_data),
            "PATH": f"{command.parent}{os.pathsep}{os.environ['PATH']}",
            LOG: str(log),
            DEVICE: device,
        }
        subprocess.run(["bash", "-c", text], cwd=work, env=environment, stdout=subprocess.DEVNULL, check=False)
        rows = [json.loads(line) for line in log.read_text().splitlines()] if log.is_file() else []
    failed = [row["command"] for row in rows if row["exit_status"] not in FINE]
    if failed or not rows:
        raise RuntimeError(f"{name}: failed: {', '.join(failed) or 'no command ran'}")
    return {"study": name, "asked_device": device, "commands": added(rows), **machine(device)}


def words_of(row: runs.Row) -> str:
    costs = (f"{one['command']} {one['cpu_s']:.0f} s CPU, {one['wall_s']:.0f} s wall" for one in row["commands"])
    return f"{row['study']} on {row['device']}: {'; '.join(costs)}"


@click.group()
def main() -> None:
    """Time and memory of the studies in examples/measured."""


@main.command()
@click.argument("data", type=click.Path(exists=True, file_okay=False))
@runs.out
@click.option("--only", multiple=True, type=click.Choice(studies()), help="May be given again. Default: all.")
@click.option("--device", default="cpu", show_default=True)
def run(data: str, out: Path, only: tuple[str, ...], device: str) -> None:
    """Run studies, each once for a device."""
    keys = [(name, device) for name in only or studies()]
    runs.append(out, keys, one_run, words_of, data, key_of=lambda row: (row["study"], row["asked_device"]))


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """The costs of the runs that are there."""
    head = ["study", "command", "machine", "wall, s", "CPU, s", "memory, GiB"]
    lines = [
        [
            row["study"],
            f"`{one['command']}`",
            said(row),
            *(f"{one[k]:.0f}" for k in ("wall_s", "cpu_s")),
            f"{one['peak_gib']:.2f}",
        ]
        for row in sorted(rows, key=lambda row: (row["study"], row["asked_device"]))
        for one in row["commands"]
    ]
    return {"measured_costs": tables.markdown(head, lines)}


if __name__ == "__main__":
    if sys.argv[1:2] == ["stand-in"]:
        sys.exit(stand_in(sys.argv[2:]))
    main()
