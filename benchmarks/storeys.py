"""From which resolution is a storey, or a whole building, seen to be missing?

    python benchmarks/storeys.py run -o out/storeys
    python benchmarks/storeys.py table -o out/storeys [--write]

A town of nine blocks of flats, each 24 m x 14 m and three storeys of 3 m, with double bounces, at X band, in four views
(two from either side, as of ascending and descending passes, one held back). Pixels are as large as the resolution; at
0.5 m the block in the middle stands alone, on ground of 60 m.
Images are made by `simulate` with speckle of one look, or of a mean of twenty dates. The file lacks something of the
block in the middle, or has too much; then `diagnose` is asked. `2 ln L` is what images without speckle differ by from
the file's: what there is to be found at all.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import runs
import tables
from search_rates import block, clean_images
from towns import DrawnTown, as_it_is, laws, seen, with_images

from warpsar.diagnosis.command import in_short
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.geometry.registry import changes
from warpsar.diagnosis.result import diagnose
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

RESOLUTIONS_M = (10.0, 3.0, 0.5)
LOOKS = (1.0, 20.0)
STOREY_M, STOREYS, SIZE_M, PITCH_M = 3.0, 3, (24.0, 14.0), 45.0
MIDDLE = "block4"
MADE: Mapping[str, tuple[int, int]] = {
    "nothing": (STOREYS, STOREYS),
    "one storey more": (STOREYS + 1, STOREYS),
    "two storeys more": (STOREYS + 2, STOREYS),
    "four storeys more": (STOREYS + 4, STOREYS),
    "one storey less": (STOREYS - 1, STOREYS),
    "block missing in the file": (STOREYS, 0),
    "block that is not there": (0, STOREYS),
}
"""Storeys of the block in the middle: in the images, and in the file."""
RIGHT = {
    "one storey more": f"object_size {MIDDLE}",
    "two storeys more": f"object_size {MIDDLE}",
    "four storeys more": f"object_size {MIDDLE}",
    "one storey less": f"object_size {MIDDLE}",
    "block missing in the file": "missing_object",
    "block that is not there": f"absent_object {MIDDLE}",
}


def town(storeys: int, half: float) -> Mesh:
    """Level ground from -half to half [m], and the blocks there; the one in the middle has so many storeys, or is left
    out."""
    vertices = [np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])]
    faces, names, groups = [np.array([[0, 1, 2], [0, 2, 3]])], ["ground"] * 2, {}
    for k in range(9) if half > PITCH_M else (4,):
        high = storeys if f"block{k}" == MIDDLE else STOREYS
        if not high:
            continue
        at = np.array([k % 3 - 1, k // 3 - 1]) * PITCH_M
        points, own = block(np.array([*SIZE_M, high * STOREY_M]), at, 0.1)
        first, offset = len(names), sum(map(len, vertices))
        names += ["wall"] * 8 + ["roof"] * 2
        groups[f"block{k}"] = np.arange(first, first + len(own), dtype=np.int32)
        vertices.append(points)
        faces.append(own + offset)
    order = ("ground", "wall", "roof")
    index = np.array([order.index(name) for name in names], np.int32)
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32), index, order, groups=groups)


def scene_of(storeys: int, resolution_m: float, looks: float) -> Scene:
    half = 80.0 if resolution_m > 1.0 else 30.0
    side = round(2.0 * half / resolution_m)
    views = [
        View(name=f"v{k}", azimuth_deg=azimuth, incidence_deg=angle, role=role, looks=looks)
        for k, (azimuth, angle, role) in enumerate(
            [(80.0, 34.0, "train"), (280.0, 37.0, "train"), (82.0, 45.0, "train"), (278.0, 44.0, "test")]
        )
    ]
    materials = {
        "ground": Material(eps_r=5.0, rms_height_m=1.4e-3, correlation_length_m=9e-3),
        "wall": Material(eps_r=5.0, rms_height_m=1.0e-3, correlation_length_m=6e-3),
        "roof": Material(eps_r=4.0, rms_height_m=1.2e-3, correlation_length_m=6e-3),
    }
    return Scene(
        mesh=town(storeys, half),
        radar=Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        grid=Grid(shape=(side, side), spacing_m=(resolution_m, resolution_m)),
        materials=materials,
        views=views,
        effects={"multibounce": {"strength": 1.0}},
        sampling=Sampling(rays_per_pixel=64 if resolution_m > 1.0 else 16, seed=1),
    )


def one_run(key: str, device: str, minutes: float) -> dict[str, Any]:
    """`key`: what is wrong, the resolution and the looks, with `|` between them."""
    kind, resolution, looks = key.split("|")
    true, declared = (scene_of(storeys, float(resolution), float(looks)) for storeys in MADE[kind])
    random = np.random.default_rng(sum(map(ord, key)))
    found = DrawnTown(true, declared, laws(declared), as_it_is)
    clean = clean_images(found, device)
    there = seen(found, clean, 1.0, device)
    scene = replace(declared, views=with_images(random, found, clean, False))
    begun = time.perf_counter()
    done = diagnose(scene, device=device, options=DiagnoseOptions(time_limit_s=60.0 * minutes))
    height = done.diagnosis.objects.get(MIDDLE, {})
    return {
        "number": key,
        "there": round(there, 1),
        "verdict": [
            *done.verdict,
            *(one for one in changes(scene, done.diagnosis.final.scene) if one not in done.not_established),
        ],
        "unexplained": done.unexplained,
        "line": in_short(done),
        "objects": json.loads(json.dumps(height, default=str)),
        "not_asked": done.diagnosis.not_asked,
        "seconds": round(time.perf_counter() - begun, 1),
    }


def answer(row: Mapping[str, Any]) -> str:
    kind = row["number"].split("|")[0]
    right = RIGHT.get(kind)
    names = [name for name in row["verdict"] if right is None or not name.startswith(right)]
    if right is not None and len(names) < len(row["verdict"]):
        return "named" + (f", and {', '.join(names)}" if names else "")
    if names:
        return ", ".join(names)
    return "unexplained" if row["unexplained"] else "nothing missing"


@click.group()
def main() -> None:
    """Storeys and buildings at 10, 3 and 0.5 m."""


@main.command()
@runs.out
@runs.jobs(2)
@runs.minutes(8.0)
@runs.max_time
@click.option("--resolution", "chosen", multiple=True, type=float, help="[m]; may be given again. Default: all.")
@click.option("--looks", "of_looks", multiple=True, type=float, help="May be given again. Default: all.")
@click.option("--wrong", multiple=True, type=click.Choice(list(MADE)), help="May be given again. Default: all.")
@runs.device
def run(
    out: Path,
    jobs: int,
    minutes: float,
    max_time: float,
    chosen: tuple[float, ...],
    of_looks: tuple[float, ...],
    wrong: tuple[str, ...],
    device: str | None,
) -> None:
    """Make the runs that are not in the folder yet."""
    where = devices.resolve_device(device)
    keys = [
        f"{kind}|{at:g}|{looks:g}"
        for looks in of_looks or LOOKS
        for kind in wrong or MADE
        for at in chosen or RESOLUTIONS_M
    ]
    runs.append(
        out, keys, one_run,
        lambda row: f"{row['number']}: {answer(row)}: {row['line']}",
        where.alias, minutes, jobs=jobs, max_time=max_time,
    )  # fmt: skip


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """What was answered, and what there is to be found; rows without a run are left out."""
    by_key = {row["number"]: row for row in rows}
    body = []
    for kind in MADE:
        for looks in LOOKS:
            line = [kind, f"{looks:g}"]
            for at in RESOLUTIONS_M:
                row = by_key.get(f"{kind}|{at:g}|{looks:g}")
                line.append("not run" if row is None else f"{answer(row)} ({row['there']:.0f})")
            if any(f"{kind}|{at:g}|{looks:g}" in by_key for at in RESOLUTIONS_M):
                body.append(line)
    head = ["wrong", "looks", *(f"{at:g} m" for at in RESOLUTIONS_M)]
    return {"storeys": tables.markdown(head, body)}


if __name__ == "__main__":
    main()
