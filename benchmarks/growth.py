"""How time and memory grow with faces, rays, pixels and views, and the sizes of the method's published timings.

    python benchmarks/growth.py --device cpu --out growth_cpu.json [--write]
    python benchmarks/growth.py --device cuda --out growth_gpu.json
    python benchmarks/growth.py --device cuda --sweep paper --out paper_gpu.json

Each size runs in a process of its own, so that one's memory is not another's peak. A slope is that of the straight
line through the logarithms: 1 is proportional, 0 is free. `paper`: 450,000 and 900,000 faces, 32, 64 and 128 samples
per pixel, pixels of 0.41, 0.82 and 1.64 m, which holds the rows of its table VII (Quadro RTX 8000: 2.86 s forward and
1.50 s backward for 900,391 faces, 128 samples, 0.41 m). On the CPU the tables
show CPU seconds, on CUDA wall time. JSON in --out after every size.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from functools import partial
from typing import Any

import numpy as np
import tables
from peer import gradient_task, smooth_scene, timed
from scenes import around, measuring
from simulate import machine, said

from warpsar.runtime import devices

Size = dict[str, Any]
PAPER_PIXELS = (423, 380)  # of 0.41 x 0.47 m
BASE = {
    "cpu": {"faces": 200_000, "pixels": [212, 190], "rays_per_pixel": 16.0, "views": 1},
    "cuda": {"faces": 900_000, "pixels": [*PAPER_PIXELS], "rays_per_pixel": 128.0, "views": 1},
}
SWEEPS = ("faces", "rays_per_pixel", "pixels", "views", "paper")
TIMES = ("trace", "fresh_image", "iteration")


def sizes_of(sweep: str, base: Size) -> list[Size]:
    """Sizes of a sweep: from a quarter (a sixteenth of the pixels) of the base to four times as much."""
    if sweep == "paper":
        return [
            {"faces": faces, "pixels": [p // shrink for p in PAPER_PIXELS], "rays_per_pixel": rays, "views": 1}
            for faces in (450_000, 900_000)
            for shrink in (1, 2, 4)
            for rays in (32.0, 64.0, 128.0)
        ]
    if sweep == "views":
        return [{**base, "views": views} for views in (1, 2, 4, 8)]
    if sweep == "pixels":
        return [{**base, "pixels": [round(p * side) for p in base["pixels"]]} for side in (0.5, 0.7, 1.0, 1.4, 2.0)]
    return [{**base, sweep: type(base[sweep])(base[sweep] * factor)} for factor in (0.25, 0.5, 1.0, 2.0, 4.0)]


def measure(size: Size, device_name: str, repeats: int) -> dict[str, Any]:
    """Tracing, fresh images of all views, and one learning iteration over them, in this process."""
    import warp as wp

    from warpsar.learning.problem import FitProblem
    from warpsar.render.render import ViewRender
    from warpsar.simulation.rays import Rays, trace_view
    from warpsar.surface.stage import Stage

    device = devices.resolve_device(device_name)
    synchronize = partial(wp.synchronize_device, device)

    def peak_gib() -> float:
        if device.is_cuda and wp.is_mempool_enabled(device):
            return wp.get_mempool_used_mem_high(device) / 2**30
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20

    scene = around(smooth_scene(size["faces"], tuple(size["pixels"]), size["rays_per_pixel"]), size["views"])
    stage = Stage.of(scene, device)

    def traced(view: Any) -> Any:
        return trace_view(scene, stage, view, seed=0, effects=[])

    def trace() -> None:
        for view in scene.views:
            traced(view)

    def fresh() -> list[Any]:
        renders = []
        for view in scene.views:
            render = ViewRender(stage, view, traced(view), scene.grid.shape, scene.radar.polarizations, [])
            render.program.forward()
            renders.append(render)
        return renders

    times = {"trace": timed(trace, synchronize, repeats), "fresh_image": timed(fresh, synchronize, repeats)}
    peak_image = peak_gib()
    fitted = measuring(scene, [render.forward()["HH"] for render in fresh()])
    problem = FitProblem(fitted, device, rays=Rays(stage, seed=0))
    problem.gradient(problem.x0)
    turns = 5 * repeats if device.is_cuda else repeats
    times["iteration"] = timed(gradient_task(problem, device), synchronize, turns)
    hits = [view.render.hits for view in problem.views]
    return {
        **size,
        "faces": len(scene.mesh.faces),
        "rays": sum(h.rays for h in hits),
        "merged_hits": sum(h.count for h in hits),
        "parameters": int(problem.x0.size),
        **times,
        "peak_image_gib": peak_image,
        "peak_iteration_gib": peak_gib(),
    }


def slopes(sweep: str, rows: list[dict[str, Any]], clock: str) -> dict[str, float]:
    """d ln(seconds) / d ln(what was varied)."""
    varied = np.array([np.prod(row[sweep]) for row in rows], float)
    found = {name: np.array([row[name][clock] for row in rows]) for name in TIMES}
    found["memory"] = np.array([row["peak_iteration_gib"] for row in rows])
    return {name: float(np.polyfit(np.log(varied), np.log(values), 1)[0]) for name, values in found.items()}


def table(rows: list[dict[str, Any]], clock: str) -> str:
    """A line per size."""
    header = ["faces", "pixels", "rays / pixel", "views", "rays", "merged hits", "trace, ms", "fresh image, ms"]
    header += ["iteration, ms", "memory, GiB"]
    body = [
        [
            f"{r['faces']:,}",
            f"{r['pixels'][0]} x {r['pixels'][1]}",
            f"{r['rays_per_pixel']:g}",
            r["views"],
            f"{r['rays']:,}",
            f"{r['merged_hits']:,}",
            *(f"{1e3 * r[name][clock]:.3g}" for name in TIMES),
            f"{r['peak_iteration_gib']:.2f}",
        ]
        for r in rows
    ]
    return tables.markdown(header, body)


def growth_table(sweeps: dict[str, Any], clock: str) -> str:
    """A line per sweep: its smallest and its largest size, and the slopes."""
    names = {"faces": "faces", "rays_per_pixel": "rays a pixel", "pixels": "pixels", "views": "views"}
    header = ["what grows", "from, to", "trace, ms", "fresh image, ms", "iteration, ms", "memory, GiB"]
    header += ["slopes: trace", "fresh image", "iteration", "memory"]
    rows = []
    for sweep, label in names.items():
        if sweep not in sweeps:
            continue
        found = sweeps[sweep]["sizes"]
        ends = [found[0], found[-1]]
        sizes = [f"{e[sweep]:,.0f}" if np.isscalar(e[sweep]) else " x ".join(map(str, e[sweep])) for e in ends]
        times = [", ".join(f"{1e3 * e[name][clock]:.3g}" for e in ends) for name in TIMES]
        memory = ", ".join(f"{e['peak_iteration_gib']:.2f}" for e in ends)
        slope = [f"{value:.2f}" for value in slopes(sweep, found, clock).values()]
        rows.append([label, ", ".join(sizes), *times, memory, *slope])
    return tables.markdown(header, rows)


def bodies(result: dict[str, Any]) -> dict[str, str]:
    """The tables of the docs: one of all sweeps, and one of the paper's sizes."""
    kind = result["device"].split(":")[0]
    clock = "cpu_s" if kind == "cpu" else "wall_s"
    found = {}
    if set(result["sweeps"]) - {"paper"}:
        found[f"growth.{kind}"] = growth_table(result["sweeps"], clock)
    if "paper" in result["sweeps"]:
        found[f"growth.{kind}.paper"] = table(result["sweeps"]["paper"]["sizes"], clock)
    times = "CPU seconds of all threads" if kind == "cpu" else "wall time"
    return {name: f"{said(result)}; {times}.\n\n{body}" for name, body in found.items()}


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Every size in a process of its own."""
    result: dict[str, Any] = {**machine(options.device), "sweeps": {}}
    for sweep in options.sweep or SWEEPS:
        rows: list[dict[str, Any]] = []
        for size in sizes_of(sweep, BASE[options.device]):
            print(f"{sweep}: {size}", file=sys.stderr)
            command = [sys.executable, __file__, "--device", options.device, "--repeats", str(options.repeats)]
            done = subprocess.run([*command, "--one", json.dumps(size)], stdout=subprocess.PIPE, text=True, check=True)
            rows.append(json.loads(done.stdout.splitlines()[-1]))
            result["sweeps"][sweep] = {"sizes": rows}
            tables.save(options.out, result)  # after every size: a later one may not end
    return result


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--sweep", choices=SWEEPS, action="append", help="may be repeated; default all")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the median counts")
    parser.add_argument("--one", help=argparse.SUPPRESS)  # a size, as JSON: measured in this process
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(json.loads(options.one), options.device, options.repeats)))
        return
    result = tables.stored(options.source) if options.source else run(options)
    tables.publish(bodies(result), result, options.write)


if __name__ == "__main__":
    main()
