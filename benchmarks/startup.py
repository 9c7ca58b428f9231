"""How long a user waits: the help text, the first picture with nothing compiled, and the next one.

python benchmarks/startup.py --out startup.json
python benchmarks/startup.py --install --out startup.json    # also the README's first line, in a copy of the checkout

Wall time, and CPU seconds of all threads and child processes, which other programs on the machine change less.
--install downloads what pip has not cached.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).resolve().parent))

from simulate import machine

ROOT = Path(__file__).resolve().parent.parent
SCENE = ROOT / "data" / "example" / "scene.toml"


def run(command: list[str], cache: Path, cwd: Path = ROOT) -> dict[str, float]:
    """Wall and CPU seconds of a command that keeps Warp's kernels in `cache`."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "WARP_CACHE_PATH": str(cache)}
    subprocess.run(command, cwd=cwd, env=environment, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    return {"wall_s": wall, "cpu_s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--install", action="store_true", help="also a new virtual environment and pip install")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        warpsar = [sys.executable, "-m", "warpsar"]
        picture = ["simulate", str(SCENE), "--device", options.device, "-o"]
        times = {
            "warpsar --help": run([*warpsar, "--help"], folder / "help"),
            "first picture": run([*warpsar, *picture, str(folder / "a")], folder / "cache"),
            "next picture": run([*warpsar, *picture, str(folder / "b")], folder / "cache"),
        }
        if options.install:
            ignore = shutil.ignore_patterns(".git", ".venv", "out", "__pycache__", "*.egg-info")
            copy = Path(shutil.copytree(ROOT, folder / "checkout", ignore=ignore))
            python = str(copy / ".venv" / "bin" / "python")
            times["venv"] = run([sys.executable, "-m", "venv", str(copy / ".venv")], folder / "new", copy)
            times["pip install"] = run([python, "-m", "pip", "install", "-q", "-e", "."], folder / "new", copy)
            command = [python, "-m", "warpsar", "simulate", "data/example/scene.toml", "-o", "out/example"]
            times["first picture there"] = run(command, folder / "new", copy)
    if options.out:
        options.out.write_text(json.dumps({"benchmark": "startup", **machine("cpu"), "times": times}, indent=1) + "\n")
    print("| | wall, s | CPU, s |\n|---|---|---|")
    for name, row in times.items():
        print(f"| {name} | {row['wall_s']:.2f} | {row['cpu_s']:.2f} |")


if __name__ == "__main__":
    main()
