"""How long a user waits: the help text, the first picture with nothing compiled, and the next one.

    python benchmarks/startup.py --out startup.json [--write]
    python benchmarks/startup.py --install      # also the README's first line, in a copy of the checkout

Wall time, and CPU seconds of all threads and child processes, which other programs on the machine change less.
--install downloads what pip has not cached.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tables
from simulate import machine, said

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "data" / "example" / "scene.toml"


def run(command: list[str], cache: Path, cwd: Path = ROOT) -> dict[str, float]:
    """Wall and CPU seconds of a command that keeps Warp's kernels in `cache`."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    subprocess.run(command, cwd=cwd, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"wall_s": wall, "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime}


def measure(device: str, install: bool) -> dict[str, dict[str, float]]:
    with TemporaryDirectory() as name:
        folder = Path(name)
        warpsar = [sys.executable, "-m", "warpsar"]
        picture = ["simulate", str(SCENE), "--device", device, "-o"]
        times = {
            "`warpsar --help`": run([*warpsar, "--help"], folder / "help"),
            "first picture, nothing compiled": run([*warpsar, *picture, str(folder / "a")], folder / "cache"),
            "next picture": run([*warpsar, *picture, str(folder / "b")], folder / "cache"),
        }
        if install:
            ignore = shutil.ignore_patterns(".git", ".venv", "out", "__pycache__", "*.egg-info")
            copy = Path(shutil.copytree(ROOT, folder / "checkout", ignore=ignore))
            python = str(copy / ".venv" / "bin" / "python")
            times["new virtual environment"] = run(
                [sys.executable, "-m", "venv", str(copy / ".venv")], folder / "new", copy
            )
            times["`pip install -e .`"] = run([python, "-m", "pip", "install", "-q", "-e", "."], folder / "new", copy)
            command = [python, "-m", "warpsar", "simulate", "data/example/scene.toml", "-o", "out/example"]
            times["first picture there"] = run(command, folder / "new", copy)
    return times


def table(result: dict[str, Any]) -> str:
    rows = [[name, f"{row['wall_s']:.2f}", f"{row['cpu_s']:.2f}"] for name, row in result["times"].items()]
    return f"{said(result)}.\n\n{tables.markdown(['', 'wall, s', 'CPU, s'], rows)}"


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--install", action="store_true", help="also a new virtual environment and pip install")
    options = parser.parse_args()
    result = tables.result_of(
        options, lambda: {**machine(options.device), "times": measure(options.device, options.install)}
    )
    tables.publish({f"startup.{result['device'].split(':')[0]}": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
