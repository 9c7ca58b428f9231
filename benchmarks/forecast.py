"""How near the time comes that a command announces, to the time that it then takes.

    python benchmarks/forecast.py --device cpu --out forecast.json [--write]

Each command runs in a process of its own, on scenes of the street corner and of a rough block on rough ground. "Took"
is from the announcement to the end of the process, so forecast and work run back to back. Where a machine does other
work meanwhile, the CPU seconds are less than the wall time times the threads.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tables
from scenes import EXAMPLE
from simulate import machine, said

from warpsar.scene.scene import Scene
from warpsar.world.collection import Collection
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Radar, View

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
ALL_TERMS = ("single", "multibounce", "edges", "rough")


def corner(pixels: int, views: int, **effects: dict[str, Any]) -> Scene:
    """The street corner in finer pixels, with 64 rays in each."""
    scene = Scene.load(EXAMPLE)
    (rows, columns), spacing = scene.grid.shape, scene.grid.spacing_m
    fine = (spacing[0] * rows / pixels, spacing[1] * columns / pixels)
    return replace(
        scene,
        grid=Grid(shape=(pixels, pixels), spacing_m=fine),
        views=scene.views[:views],
        sampling=scene.sampling.model_copy(update={"rays_per_pixel": 64.0}),
        effects=effects,
    )


def block(size_m: float, terms: tuple[str, ...], **collection: Any) -> Scene:
    """A rough block of 2 x 1.8 x 1.5 m on rough ground."""
    h = size_m / 2
    low, high = np.array([-1.0, -0.9, 0.0]), np.array([1.0, 0.9, 1.5])
    corners = np.array([[x, y, z] for z in (low[2], high[2]) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))], float)
    corners[:, :2] = low[:2] + corners[:, :2] * (high - low)[:2]
    vertices = np.concatenate([[[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], corners])
    quads = [[0, 1, 2, 3], [8, 9, 10, 11], [4, 5, 9, 8], [5, 6, 10, 9], [6, 7, 11, 10], [7, 4, 8, 11]]
    faces = np.array([[[a, b, c], [a, c, d]] for a, b, c, d in quads]).reshape(-1, 3)
    example = Scene.load(EXAMPLE)
    material = np.array([0, 0] + [1] * 10, np.int32)
    pixels = round(size_m / 0.5)
    return Scene(
        mesh=Mesh(vertices, faces.astype(np.int32), material, ("lawn", "brick")),
        radar=Radar(frequency_hz=9.6e9, polarizations=("VV",), slant_range_m=10e3, terms=terms),
        grid=Grid(shape=(pixels, pixels), spacing_m=(0.5, 0.5)),
        materials={name: example.materials[name] for name in ("lawn", "brick")},
        views=[View(name="north", azimuth_deg=25.0, incidence_deg=42.0)],
        collection=Collection(**({"mode": "spotlight", "resolution_m": (0.8, 0.8)} | collection)),
    )


def cases() -> list[tuple[str, Scene, list[str]]]:
    """Name, scene, and the words of the command after the scene."""
    bounces: dict[str, Any] = {"multibounce": {"strength": 1.0}}
    fine = {"resolution_m": (0.4, 0.4)}
    angles = ["--azimuths", "0:20:2", "--incidences", "42"]
    return [
        ("simulate, 500 x 500 pixels, 3 views", corner(500, 3), ["simulate"]),
        ("simulate, 1000 x 1000 pixels, with layers", corner(1000, 1), ["simulate", "--layers"]),
        ("simulate, 500 x 500 pixels, multibounce", corner(500, 1, **bounces), ["simulate"]),
        ("slc, 10 m, all terms", block(10.0, ALL_TERMS), ["simulate", "--product", "slc"]),
        ("slc, 16 m, all terms", block(16.0, ALL_TERMS), ["simulate", "--product", "slc"]),
        ("slc, 60 m, rough", block(60.0, ("rough",), **fine), ["simulate", "--product", "slc"]),
        ("slc, 16 m, all terms, direct", block(16.0, ALL_TERMS, focus="direct"), ["simulate", "--product", "slc"]),
        ("phase history, 16 m, all terms", block(16.0, ALL_TERMS), ["simulate", "--product", "phase-history"]),
        ("rcs, 4 m, 10 directions", block(4.0, ALL_TERMS), ["rcs", *angles]),
        ("rcs, 8 m, 10 directions", block(8.0, ALL_TERMS), ["rcs", *angles]),
    ]


def measure(name: str, scene: Scene, words: list[str], device: str) -> dict[str, Any]:
    """One command: what it announces, and when which line came."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        scene.save(path)
        command = [sys.executable, "-m", "warpsar", words[0], str(path), "-o", f"{folder}/out", *words[1:]]
        process = subprocess.Popen([*command, "--device", device], stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        begun = told = time.perf_counter()
        announced = None
        for line in process.stderr:
            if found := re.search(r"about (\d+) (s|min|h) and ([\d.e+-]+) GiB", line):
                told = time.perf_counter()
                announced = float(found[1]) * UNITS[found[2]], float(found[3])
        used = os.wait4(process.pid, 0)[2]
        ended = time.perf_counter()
    return {
        "name": name,
        "announced_s": announced and announced[0],
        "announced_gib": announced and announced[1],
        "took_s": ended - told,
        "before_s": told - begun,
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_gib": used.ru_maxrss / 2**20,
    }


def table(result: dict[str, Any]) -> str:
    header = ["command", "announced, s", "took, s", "ratio", "start and sample, s", "CPU s", "announced, GiB"]
    header += ["peak of the process, GiB"]
    rows = []
    for each in result["cases"]:
        if each["announced_s"] is None:
            rows.append([each["name"], "nothing", f"{each['took_s']:.1f}", "", "", f"{each['cpu_s']:.1f}", "", ""])
            continue
        rows.append(
            [
                each["name"],
                f"{each['announced_s']:.0f}",
                f"{each['took_s']:.1f}",
                f"{each['announced_s'] / each['took_s']:.2f}",
                f"{each['before_s']:.1f}",
                f"{each['cpu_s']:.1f}",
                f"{each['announced_gib']:.2g}",
                f"{each['peak_gib']:.2g}",
            ]
        )
    load = f"load average {result['load_average']:.1f} at the start"
    return f"{said(result)}; {load}.\n\n{tables.markdown(header, rows)}"


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", default="cpu", help="cpu, cuda, cuda:N")
    options = parser.parse_args()
    if options.source:
        result = tables.stored(options.source)
    else:
        result = {**machine(options.device), "cases": []}
        for name, scene, words in cases():
            print(name, file=sys.stderr)
            result["cases"].append(measure(name, scene, words, options.device))
            tables.save(options.out, result)
    tables.publish({f"forecast.{result['device'].split(':')[0]}": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
