"""Time and memory of the studies in examples/measured: the commands of their READMEs, one after the other.

    python benchmarks/measured_costs.py run $DATA -o costs [--only boxes] [--device cuda]
    python benchmarks/measured_costs.py table -o costs [--write]

The shell block of a README runs as it stands, in a copy of its folder, with $DATA as the README says. A stand-in for
`warpsar` runs each command, with --device, and notes wall time, CPU seconds of all threads, and the most memory; on a
GPU also the most of its memory that is in use, beside what was before. A run appends lines of JSON to runs.jsonl in the
folder; a study that stands there for a device is not run again. The table has the newest rows of each device.
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
from threading import Event, Thread
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).resolve().parent))

import runs
import tables
from simulate import machine, said

STUDIES = tables.ROOT / "examples" / "measured"
SHELL = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FOLDER = re.compile(r"`\$DATA`\s+is\s+the\s+folder\s+`(\w+)`")
FINE = (0, 4)  # of a command: done, and `diagnose` left a part unexplained
LOG, DEVICE = "MEASURED_COSTS_LOG", "MEASURED_COSTS_DEVICE"
SECONDS = 0.2  # between two looks at a GPU's memory
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


def device_mib() -> float:
    """Memory in use on the first GPU [MiB]; 0 where nobody can tell."""
    try:
        told = subprocess.run(
            ["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader,nounits", "--id=0"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return 0.0
    return float(told.stdout.split()[0])


def stand_in(words: list[str]) -> int:
    """Run one command of warpsar, and append what it cost to the log. Returns its exit status."""
    device = os.environ[DEVICE]
    on_gpu = device.startswith("cuda")
    before, most, done = device_mib() if on_gpu else 0.0, [0.0], Event()

    def look() -> None:
        while not done.wait(SECONDS):
            most[0] = max(most[0], device_mib() - before)

    watch = Thread(target=look)
    if on_gpu:
        watch.start()
    begun = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "warpsar", *words, "--device", device])
    _, status, used = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - begun
    process.returncode = code = os.waitstatus_to_exitcode(status)
    done.set()
    if on_gpu:
        watch.join()
    row = {
        "command": label(words),
        "exit_status": code,
        "wall_s": wall_s,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_gib": used.ru_maxrss / GIB,
        "device_gib": most[0] / 1024.0,
    }
    with Path(os.environ[LOG]).open("a") as log:
        log.write(json.dumps(row) + "\n")
    return code


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
    return {"study": name, "asked_device": device, "commands": rows, **machine(device)}


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


@main.command()
@runs.out
@runs.write
def table(out: Path, write: bool) -> None:
    """The costs of the runs that are there."""
    rows = runs.stored(out)
    devices = sorted({row["asked_device"] for row in rows}, key=lambda one: (one != "cpu", one))
    found = {(row["study"], row["asked_device"], one["command"]): one for row in rows for one in row["commands"]}
    head = ["study", "command"]
    for device in devices:
        of = "CPU" if device == "cpu" else "GPU"
        head += [f"{of}: wall, s", "CPU, s", "memory, GiB", *(["on the GPU, GiB"] if device != "cpu" else [])]
    body = []
    for study, command in dict.fromkeys((row["study"], one["command"]) for row in rows for one in row["commands"]):
        line: list[str] = [study, f"`{command}`"]
        for device in devices:
            one = found.get((study, device, command))
            forms = {"wall_s": ".0f", "cpu_s": ".0f", "peak_gib": ".2f"}
            forms |= {"device_gib": ".2f"} if device != "cpu" else {}
            line += ["" if one is None else f"{one[key]:{form}}" for key, form in forms.items()]
        body.append(line)
    machines = dict.fromkeys(said(row) for row in sorted(rows, key=lambda row: devices.index(row["asked_device"])))
    text = f"{'; '.join(machines)}.\n\n{tables.markdown(head, body)}"
    tables.publish({"measured_costs": text}, runs.oldest(rows), write)


if __name__ == "__main__":
    if sys.argv[1:2] == ["stand-in"]:
        sys.exit(stand_in(sys.argv[2:]))
    main()
