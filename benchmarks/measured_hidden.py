"""What `diagnose --folds` says of a measured vehicle whose scene file is wrong, by an error that we hid.

    cd FOLDER  # a copy of examples/measured/btr70; then the first two commands of its README
    python benchmarks/measured_hidden.py run FOLDER -o OUT [--only front] [--minutes 30]
    python benchmarks/measured_hidden.py table -o OUT

Each trial is a copy of the folder with one error in it. `warpsar diagnose scene.toml --folds 3` runs in it, as a
process of its own. The table has what it says: whether the body is ahead of every rival, the deviance of views left
out, its lead in correlation over the best picture and over a box, and the numbers that were found.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import runs
import tables
import tomlkit

FINE = (0, 4)  # of `diagnose`: done, and something is left unexplained
OPPOSITE = {"+": "-", "-": "+"}
TOO_LONG, OFF_DEG = 1.1, 3.0
SIZE_M = [8.0, 2.5, 3.4]  # of a truck
KNOWN = "10 %"

Document = Any  # what tomlkit reads


def body(document: Document) -> Any:
    """The object of a mesh whose heading is free. Raises LookupError where there is none."""
    for one in document["objects"]:
        if "mesh" in one and "heading" in one.get("learn", []):
            return one
    raise LookupError("found no object with a mesh and a free heading")


def too_long(document: Document) -> None:
    """The same as a mesh that is too long: its size is known about the wrong value."""
    one = body(document)
    along, across, up = one.get("scale", [1.0, 1.0, 1.0])
    one["scale"] = [TOO_LONG * float(along), across, up]


def azimuths_off(document: Document) -> None:
    for view in document["views"]:
        view["azimuth_deg"] = (float(view["azimuth_deg"]) + OFF_DEG) % 360.0


def azimuths_reversed(document: Document) -> None:
    for view in document["views"]:
        view["azimuth_deg"] = -float(view["azimuth_deg"]) % 360.0


def turned_round(document: Document) -> None:
    one = body(document)
    front = str(one.get("front", "+Y"))
    one["front"] = OPPOSITE[front[0]] + front[1:]


def _primitive(kind: str) -> Callable[[Document], None]:
    def other(document: Document) -> None:
        one = body(document)
        for key in ("mesh", "units", "up", "front", "scale", "tolerance"):
            one.pop(key, None)
        one["primitive"], one["size_m"] = kind, SIZE_M
        one["learn"], one["tolerance"] = ["size", "heading"], {"size_m": KNOWN}

    return other


TRIALS: dict[str, tuple[str, Callable[[Document], None]]] = {
    "nothing": ("nothing", lambda document: None),
    "length": ("the CAD is 10 % too long", too_long),
    "azimuths": ("the table of azimuths is off by 3 degrees", azimuths_off),
    "reversed": ("azimuths with the other sign", azimuths_reversed),
    "front": ("the front is the back", turned_round),
    "truck": ("a truck in place of the CAD", _primitive("truck")),
    "box": ("a box of a truck's size in place of the CAD", _primitive("box")),
}


def one_run(name: str, folder: str, out: str, minutes: float) -> runs.Row:
    """A trial, in OUT/NAME. Raises RuntimeError where `diagnose` fails."""
    copy = Path(out) / name
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy)
    scene = copy / "scene.toml"
    document = tomlkit.parse(scene.read_text(encoding="utf-8"))
    TRIALS[name][1](document)
    scene.write_text(tomlkit.dumps(document), encoding="utf-8")
    words = ["diagnose", str(scene), "-o", str(copy / "diagnosed"), "--folds", "3", "--time-limit", f"{minutes:g}"]
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, "-m", "warpsar", *words], capture_output=True, text=True, check=False)
    if done.returncode not in FINE:
        raise RuntimeError(f"{name}: {done.stderr[-2000:]}")
    content = json.loads((copy / "diagnosed" / "diagnosis.json").read_text(encoding="utf-8"))
    return {
        "trial": name,
        "said": done.stdout.strip(),
        "wall_s": time.perf_counter() - begun,
        **{key: content[key] for key in ("verdict", "not_asked", "fronts", "azimuths", "profiles", "left_out")},
        **{key: content[key] for key in ("unexplained", "lead", "lead_of_box")},
    }


def found(row: runs.Row) -> str:
    """What was found of sizes and of the azimuths."""
    told = [
        f"{one['label'].split('.')[-1]} {one['value']:.3g} ± {one['half']:.2g}"
        for one in row["profiles"].values()
        if one["label"].endswith(("azimuth_deg", "along", "across", "upward"))
    ]
    return ", ".join(([row["azimuths"]["words"]] if row["azimuths"] else []) + told)


@click.group()
def main() -> None:
    """What diagnose says of a scene file with an error that we hid."""


@main.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False))
@runs.out
@click.option("--only", multiple=True, type=click.Choice(list(TRIALS)), help="May be given again. Default: all.")
@runs.minutes(60.0)
@runs.jobs(1)
def run(folder: str, out: Path, only: tuple[str, ...], minutes: float, jobs: int) -> None:
    """Hide errors in copies of FOLDER, each once."""
    runs.append(
        out,
        only or list(TRIALS),
        one_run,
        lambda row: f"{row['trial']}: {row['said']}",
        folder,
        str(out),
        minutes,
        jobs=jobs,
        key_of=lambda row: row["trial"],
    )


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """What was said in the runs that are there."""
    lines = []
    for row in rows:
        leads = [row["lead"], row["lead_of_box"]]
        ahead = [f"{one['correlation']:+.3f} ± {one['error']:.3f}" if one else "not asked" for one in leads]
        deviance = f"{row['left_out']['deviance_after']:.3f}"
        said = "no" if row["unexplained"] else "yes"
        said += f"; not asked: {', '.join(row['not_asked'])}" if row["not_asked"] else ""
        lines.append([TRIALS[row["trial"]][0], said, deviance, *ahead, found(row), f"{row['wall_s']:.0f}"])
    head = ["hidden", "ahead of all rivals", "deviance", "over the best picture", "over a box", "found", "wall, s"]
    return {"measured_hidden": tables.markdown(head, lines)}


if __name__ == "__main__":
    main()
