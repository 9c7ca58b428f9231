"""How fast a view is traced and shaded, and in how much memory.

    python benchmarks/simulate.py --out simulate.json [--write]    # sizes for a laptop
    python benchmarks/simulate.py --device cuda --preset paper     # 450,000 to 1.8 million faces, 380 x 423 pixels
    python benchmarks/simulate.py --preset large                   # 10 million faces, 512 x 512 pixels
    python benchmarks/simulate.py --preset huge                    # 10 million faces, 4096 x 4096 pixels
    python benchmarks/simulate.py --faces 20000 --pixels 256 256 --rays-per-pixel 64 --layout vertex

"Trace" is everything from rays to merged hits, launches and waits of the host included; "shade" is an image of kept
hits. Each size runs in a process of its own. Times are medians.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from statistics import median
from typing import Any

import tables

from warpsar.runtime import console, devices, threads

Size = dict[str, Any]
PRESETS: dict[str, list[Size]] = {
    "laptop": [
        {"faces": 50_000, "pixels": (256, 256), "rays_per_pixel": 16.0, "layout": "uniform"},
        {"faces": 100_000, "pixels": (256, 256), "rays_per_pixel": 16.0, "layout": "uniform"},
        {"faces": 100_000, "pixels": (256, 256), "rays_per_pixel": 64.0, "layout": "uniform"},
        {"faces": 100_000, "pixels": (256, 256), "rays_per_pixel": 16.0, "layout": "vertex"},
    ],
    "paper": [
        {"faces": faces, "pixels": (380, 423), "rays_per_pixel": rays, "layout": layout}
        for faces, rays, layout in (
            (450_000, 128.0, "vertex"),
            (900_000, 128.0, "vertex"),
            (900_000, 32.0, "vertex"),
            (900_000, 512.0, "vertex"),
            (900_000, 128.0, "uniform"),
            (1_800_000, 128.0, "vertex"),
        )
    ],
    "large": [{"faces": 10_000_000, "pixels": (512, 512), "rays_per_pixel": 64.0, "layout": "uniform"}],
    "huge": [{"faces": 10_000_000, "pixels": (4096, 4096), "rays_per_pixel": 64.0, "layout": "uniform"}],
}


def fresh(scene: Any, stage: Any, max_memory_gib: float, bar: Any) -> tuple[float, float, float, Any, Any]:
    """Seconds until the hits and until the image are there, CPU seconds until the hits; hits and render."""
    import warp as wp

    from warpsar.render.render import ViewRender
    from warpsar.simulation.rays import hit_grid
    from warpsar.trace.trace import trace
    from warpsar.world.world import geometry_of

    wp.synchronize()
    started, cpu = time.perf_counter(), time.process_time()
    geometry, density = geometry_of(scene, scene.views[0]), scene.sampling.density_per_m2(scene.grid)
    hits = trace(stage.target, geometry, hit_grid(scene), density, max_memory_gib=max_memory_gib, progress=bar)
    wp.synchronize()
    traced, cpu = time.perf_counter(), time.process_time() - cpu
    render = ViewRender(stage, scene.views[0], hits, scene.grid.shape, scene.radar.polarizations, [])
    render.forward()
    return traced - started, time.perf_counter() - started, cpu, hits, render


def timed(task: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of a task on an idle device, and what it returns."""
    import warp as wp

    wp.synchronize()
    started = time.perf_counter()
    result = task()
    wp.synchronize()
    return time.perf_counter() - started, result


def measure(size: Size, device_name: str | None, repeats: int, max_memory_gib: float) -> dict[str, Any]:
    """One size in this process: upload, tracing, shading on kept hits, and a fresh image."""
    import warp as wp
    from scenes import town_scene

    from warpsar.surface.stage import Stage

    device = devices.resolve_device(device_name)
    warm = town_scene(200, (16, 16), 4.0, layout=size["layout"])
    fresh(warm, Stage.of(warm, device), max_memory_gib, None)  # compiles the kernels, or loads them
    scene = town_scene(size["faces"], size["pixels"], size["rays_per_pixel"], layout=size["layout"])
    upload_s, stage = timed(lambda: Stage.of(scene, device))
    runs = []
    with console.progress(0, "rays", "ray") as bar:
        for _ in range(repeats):
            hits = render = None  # two of them at a time would be another memory
            *seconds, hits, render = fresh(scene, stage, max_memory_gib, bar)
            runs.append(seconds)
    trace_s, image_s, trace_cpu_s = (median(column) for column in zip(*runs, strict=True))
    shade_s = median(timed(render.program.forward)[0] for _ in range(max(repeats, 5)))
    rays = hits.rays
    found = {
        "faces": len(scene.mesh.faces),
        "vertices": len(scene.mesh.vertices),
        "pixels": list(size["pixels"]),
        "rays_per_pixel": size["rays_per_pixel"],
        "layout": size["layout"],
        "rays": rays,
        "merged_hits": hits.count,
        "lit_fraction": float((next(iter(render.forward().values())) > 0).mean()),
        "upload_s": upload_s,
        "trace_s": trace_s,
        "trace_rays_per_s": rays / trace_s,
        # of all threads: what others do on the machine does not count in it
        "trace_cpu_s": trace_cpu_s,
        "shade_s": shade_s,
        "shade_rays_per_s": rays / shade_s,
        "image_s": image_s,
        "peak_host_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "max_memory_gib": max_memory_gib,
    }
    if device.is_cuda and wp.is_mempool_enabled(device):
        # what Warp's allocator held at most; the BVH is in it
        found["peak_device_gib"] = wp.get_mempool_used_mem_high(device) / 2**30
    return found


def machine(device_name: str | None) -> dict[str, Any]:
    import warp as wp

    from warpsar import __version__

    device = devices.resolve_device(device_name)
    return {
        "version": __version__,
        "warp": wp.__version__,
        "device": device.alias,
        "device_name": device.name if device.is_cuda else _processor(),
        "threads": threads.thread_count(),
        "python": platform.python_version(),
        "load_average": os.getloadavg()[0],
        "made": tables.made(),
    }


def said(result: Mapping[str, Any]) -> str:
    """The machine of a result, for the line above its table."""
    threads = "" if result["device"].startswith("cuda") else f", {result['threads']} threads"
    return f"{result['device_name']}{threads}, Warp {result['warp']}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def table(result: Mapping[str, Any]) -> str:
    cuda = result["device"].startswith("cuda")
    memory = "peak_device_gib" if cuda else "peak_host_gib"
    header = ["faces", "pixels", "rays / pixel", "parameters", "rays", "merged hits", "upload, s", "trace, s"]
    header += ["trace, CPU s", "Mrays per s", "shade, ms", "image, s", f"peak {'device' if cuda else 'host'}, GiB"]
    rows = [
        [
            f"{size['faces']:,}",
            f"{size['pixels'][0]} x {size['pixels'][1]}",
            f"{size['rays_per_pixel']:g}",
            size["layout"],
            f"{size['rays']:,}",
            f"{size['merged_hits']:,}",
            *(f"{size[key]:.3g}" for key in ("upload_s", "trace_s", "trace_cpu_s")),
            f"{size['trace_rays_per_s'] / 1e6:.3g}",
            f"{1e3 * size['shade_s']:.3g}",
            f"{size['image_s']:.3g}",
            f"{size[memory]:.3g}",
        ]
        for size in result["sizes"]
        if not size.get("failed")
    ]
    return f"{said(result)}.\n\n{tables.markdown(header, rows)}"


def sizes_of(options: argparse.Namespace) -> list[Size]:
    if options.faces is None:
        return [size for name in options.preset for size in PRESETS[name]]
    names = ("faces", "pixels", "rays_per_pixel", "layout")
    return [{name: getattr(options, name) for name in names}]


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Every size in a process of its own, so that one's memory is not another's peak."""
    result: dict[str, Any] = {**machine(options.device), "presets": options.preset}
    result["sizes"] = []
    for size in sizes_of(options):
        command = [sys.executable, __file__, "--one", json.dumps(size), "--repeats", str(options.repeats)]
        command += ["--max-memory", str(options.max_memory)]
        if options.device:
            command += ["--device", options.device]
        print(f"{size}", file=sys.stderr)
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
        entry = {**size, "failed": done.returncode}
        if done.returncode == 0:
            entry = json.loads(done.stdout.splitlines()[-1])
        result["sizes"].append(entry)
        tables.save(options.out, result)  # after every size: a later one may not end
    return result


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", help="cpu, cuda, cuda:N; default as the program's")
    parser.add_argument("--preset", choices=sorted(PRESETS), action="append", help="sizes; may be repeated")
    parser.add_argument("--faces", type=int, help="one size of your own, with --pixels and --rays-per-pixel")
    parser.add_argument("--pixels", type=int, nargs=2, default=(256, 256), metavar=("ROWS", "COLS"))
    parser.add_argument("--rays-per-pixel", type=float, default=16.0)
    parser.add_argument("--layout", choices=("uniform", "vertex"), default="uniform")
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the median counts")
    parser.add_argument("--max-memory", type=float, default=2.0, metavar="GIB", help="bound on rays and records")
    parser.add_argument("--one", help=argparse.SUPPRESS)  # a size, as JSON: measured in this process
    options = parser.parse_args()
    if options.one:
        size = json.loads(options.one)
        print(json.dumps(measure(size, options.device, options.repeats, options.max_memory)))
        return
    options.preset = options.preset or ["laptop"]
    if options.faces and options.write:
        parser.error("--write is for presets: a size of your own has no table in a page")
    result = tables.stored(options.source) if options.source else run(options)
    name = ".".join(["simulate", result["device"].split(":")[0], *result["presets"]])
    tables.publish({name: table(result)}, result, options.write)


if __name__ == "__main__":
    main()
