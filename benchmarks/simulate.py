"""How fast a view is traced and shaded, and in how much memory: JSON, one entry per size.

python benchmarks/simulate.py --out simulate.json                  # sizes for a laptop
python benchmarks/simulate.py --device cuda --preset paper --out …  # 450,000 and 900,000 faces, 380 x 423 pixels
python benchmarks/simulate.py --preset huge --out …                 # 10 million faces, 4096 x 4096 pixels
python benchmarks/simulate.py --faces 20000 --pixels 256 256 --rays-per-pixel 64 --layout vertex
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
from pathlib import Path
from statistics import median
from typing import Any

from warpsar.runtime import console, devices, threads

sys.path.insert(0, str(Path(__file__).resolve().parent))

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
        )
    ],
    "huge": [{"faces": 10_000_000, "pixels": (4096, 4096), "rays_per_pixel": 64.0, "layout": "uniform"}],
}


def measure(size: Size, device_name: str | None, repeats: int, max_memory_gib: float) -> dict[str, Any]:
    """One size in this process: building the BVH, tracing, shading on kept hits, and a fresh image."""
    import warp as wp
    from scenes import town_scene

    from warpsar.render.render import ViewRender
    from warpsar.simulation.rays import hit_grid
    from warpsar.surface.stage import Stage
    from warpsar.trace.trace import trace
    from warpsar.world.world import geometry_of

    device = devices.resolve_device(device_name)

    def synchronize() -> None:
        wp.synchronize_device(device)

    def image(scene: Any, stage: Any, bar: Any) -> tuple[float, float, float, Any, Any]:
        """Seconds until the hits and until the image are there, CPU seconds until the hits; hits and render."""
        synchronize()
        started, cpu = time.perf_counter(), time.process_time()
        geometry, density = geometry_of(scene, scene.views[0]), scene.sampling.density_per_m2(scene.grid)
        hits = trace(stage.target, geometry, hit_grid(scene), density, max_memory_gib=max_memory_gib, progress=bar)
        synchronize()
        traced, cpu = time.perf_counter(), time.process_time() - cpu
        render = ViewRender(stage, scene.views[0], hits, scene.grid.shape, scene.radar.polarizations, [])
        render.forward()
        return traced - started, time.perf_counter() - started, cpu, hits, render

    warm = town_scene(200, (16, 16), 4.0, layout=size["layout"])
    image(warm, Stage.of(warm, device), None)  # compiles the kernels, or loads them
    scene = town_scene(size["faces"], size["pixels"], size["rays_per_pixel"], layout=size["layout"])
    synchronize()
    started = time.perf_counter()
    stage = Stage.of(scene, device)
    synchronize()
    build_s = time.perf_counter() - started
    runs = []
    with console.progress(0, "rays", "ray") as bar:
        for _ in range(repeats):
            hits = render = None  # two of them at a time would be another memory
            *seconds, hits, render = image(scene, stage, bar)
            runs.append(seconds)
    trace_s, image_s, trace_cpu_s = (median(column) for column in zip(*runs, strict=True))
    shades = []
    for _ in range(max(repeats, 5)):
        synchronize()
        started = time.perf_counter()
        render.program.forward()
        synchronize()
        shades.append(time.perf_counter() - started)
    shade_s = median(shades)
    rays, count = hits.rays, hits.count
    lit = float((next(iter(render.forward().values())) > 0).mean())
    found = {
        "faces": len(scene.mesh.faces),
        "vertices": len(scene.mesh.vertices),
        "pixels": list(size["pixels"]),
        "rays_per_pixel": size["rays_per_pixel"],
        "layout": size["layout"],
        "rays": rays,
        "merged_hits": count,
        "lit_fraction": lit,
        "upload_s": build_s,
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
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", help="cpu, cuda, cuda:N; default as the program's")
    parser.add_argument("--preset", choices=sorted(PRESETS), action="append", help="sizes; may be repeated")
    parser.add_argument("--faces", type=int, help="one size of your own, with --pixels and --rays-per-pixel")
    parser.add_argument("--pixels", type=int, nargs=2, default=(256, 256), metavar=("ROWS", "COLS"))
    parser.add_argument("--rays-per-pixel", type=float, default=16.0)
    parser.add_argument("--layout", choices=("uniform", "vertex"), default="uniform")
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the median counts")
    parser.add_argument("--max-memory", type=float, default=2.0, metavar="GIB", help="bound on rays and records")
    parser.add_argument("--out", type=Path, help="JSON file; else stdout")
    parser.add_argument("--one", help=argparse.SUPPRESS)  # a size, as JSON: measured in this process
    options = parser.parse_args()
    if options.one:
        size = json.loads(options.one)
        print(json.dumps(measure(size, options.device, options.repeats, options.max_memory)))
        return
    sizes = [size for name in options.preset or ([] if options.faces else ["laptop"]) for size in PRESETS[name]]
    if options.faces:
        sizes.append(
            {
                "faces": options.faces,
                "pixels": options.pixels,
                "rays_per_pixel": options.rays_per_pixel,
                "layout": options.layout,
            }
        )
    result: dict[str, Any] = {"benchmark": "simulate", **machine(options.device), "sizes": []}
    for size in sizes:
        # a process of its own, so that one size's memory is not another's peak
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
        text = json.dumps(result, indent=1) + "\n"
        if options.out:  # after every size: a later one may not end
            options.out.write_text(text)
    if not options.out:
        print(text, end="")


if __name__ == "__main__":
    main()
