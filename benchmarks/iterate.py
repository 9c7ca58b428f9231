"""One learning iteration: image, loss, gradient to every vertex and parameter, update.

python benchmarks/iterate.py --device cuda --faces 900482 --pixels 423 380 --rays-per-pixel 128 [--out FILE]

The town of benchmarks/scenes.py with per-vertex parameters, measured against its own speckled image. On CUDA the
iteration is one captured graph and the optimiser's update; on the CPU the host-side loop. JSON out.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scenes import town_scene

from warpsar import runtime
from warpsar.fit import FitProblem
from warpsar.images import write_exr
from warpsar.optimise import Adam, GraphAdam, begin
from warpsar.simulation import simulate


def measure(
    device: Any, faces: int, pixels: tuple[int, int], rays: float, repeats: int, folder: Path
) -> dict[str, Any]:
    import warp as wp

    scene = town_scene(faces, pixels, rays, layout="vertex")
    beta0 = simulate(scene, device=device.alias, seed=1)[0].beta0["HH"]
    speckled = beta0 * np.random.default_rng(0).gamma(16.0, 1 / 16.0, beta0.shape)
    write_exr(folder / "west.exr", {"HH": speckled.astype(np.float32)})
    view = scene.views[0].model_copy(update={"images": {"HH": folder / "west.exr"}, "looks": 16.0})
    scene = replace(scene, views=[view])
    wp.synchronize_device(device)
    started = time.perf_counter()
    problem = FitProblem(scene, device)
    wp.synchronize_device(device)
    prepare_s = time.perf_counter() - started
    state = begin(problem, 0, 0)
    descent = (Adam if problem.shared_nodes is None else GraphAdam)(problem, state, 0.01)
    state = descent.step(state)
    stride = getattr(descent, "STRIDE", 1)
    steps, images = [], []
    for _ in range(repeats):
        wp.synchronize_device(device)
        started = time.perf_counter()
        state = descent.step(state)
        wp.synchronize_device(device)
        steps.append((time.perf_counter() - started) / stride)
    found: dict[str, Any] = {}
    if device.is_cuda:
        with wp.ScopedCapture(device) as capture:
            for one in problem.views:
                one.forward()
        for name, graph in (("image_graph_s", capture.graph), ("gradient_graph_s", descent.graph)):
            wp.synchronize_device(device)
            started = time.perf_counter()
            for _ in range(50):
                wp.capture_launch(graph)
            wp.synchronize_device(device)
            found[name] = (time.perf_counter() - started) / 50
        n = 1 << 28
        source, target = wp.zeros(n, dtype=float, device=device), wp.zeros(n, dtype=float, device=device)
        wp.copy(target, source)
        wp.synchronize_device(device)
        started = time.perf_counter()
        for _ in range(10):
            wp.copy(target, source)
        wp.synchronize_device(device)
        found["copy_bytes_per_s"] = 10 * 8 * n / (time.perf_counter() - started)
    else:
        for _ in range(repeats):
            started = time.perf_counter()
            problem.views[0].forward()
            images.append(time.perf_counter() - started)
        found["image_s"] = median(images)
    hits = problem.views[0].render.hits
    return {
        "device": device.name,
        "faces": len(scene.mesh.faces),
        "vertices": len(scene.mesh.vertices),
        "pixels": list(pixels),
        "rays": hits.rays,
        "merged_hits": hits.count,
        "parameters": int(problem.x0.size),
        "prepare_s": prepare_s,
        "iteration_s": median(steps),
        **found,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", help="cpu, cuda, cuda:N; default as the program's")
    parser.add_argument("--faces", type=int, default=100_000)
    parser.add_argument("--pixels", type=int, nargs=2, default=(256, 256), metavar=("ROWS", "COLS"))
    parser.add_argument("--rays-per-pixel", type=float, nargs="+", default=[16.0])
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    device = runtime.resolve_device(options.device)
    with TemporaryDirectory() as folder:
        rows = [
            measure(device, options.faces, tuple(options.pixels), rays, options.repeats, Path(folder))
            for rays in options.rays_per_pixel
        ]
    text = json.dumps({"benchmark": "iterate", "sizes": rows}, indent=1) + "\n"
    if options.out:
        options.out.write_text(text)
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
