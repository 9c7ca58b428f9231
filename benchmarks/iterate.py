"""One learning iteration: image, loss, gradient to every vertex and parameter, update.

python benchmarks/iterate.py --device cuda --faces 900482 --pixels 423 380 --rays-per-pixel 128 --out FILE
python benchmarks/iterate.py --device cuda --faces 20000 --pixels 96 96 --rays-per-pixel 32 --views 12 --out FILE

The town of benchmarks/scenes.py with per-vertex parameters, measured against its own speckled image. On CUDA the
iteration is one captured graph; beside its time stand the bytes that its kernels have to move, and a copy's rate on the
same device. On the CPU it is the host-side loop. JSON out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scenes import town_scene

from warpsar.io.images import write_exr
from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.optimise import begin
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.simulation.command import simulate


def measure(
    device: Any, faces: int, pixels: tuple[int, int], rays: float, views: int, repeats: int, folder: Path
) -> dict[str, Any]:
    import warp as wp

    scene = town_scene(faces, pixels, rays, layout="vertex")
    around = [
        scene.views[0].model_copy(update={"name": f"view{k}", "azimuth_deg": 270.0 + 360.0 * k / views})
        for k in range(views)
    ]
    scene = replace(scene, views=around)
    measured = []
    for view, found in zip(around, simulate(scene, device=device.alias, seed=1), strict=True):
        beta0 = found.beta0["HH"]
        speckled = beta0 * np.random.default_rng(0).gamma(16.0, 1 / 16.0, beta0.shape)
        path = folder / f"{view.name}.exr"
        write_exr(path, {"HH": speckled.astype(np.float32)})
        measured.append(view.model_copy(update={"images": {"HH": path}, "looks": 16.0}))
    scene = replace(scene, views=measured)

    def timed(task: Callable[[], Any], turns: int) -> float:
        wp.synchronize_device(device)
        started = time.perf_counter()
        for _ in range(turns):
            task()
        wp.synchronize_device(device)
        return (time.perf_counter() - started) / turns

    problems: list[FitProblem] = []
    prepare_s = timed(lambda: problems.append(FitProblem(scene, device)), 1)
    problem = problems[0]
    state = begin(problem, 0, 0)
    found: dict[str, Any] = {}
    if device.is_cuda:
        descent = GraphAdam(problem, state, 0.01)
        tasks: dict[str, Callable[[], None]] = {
            "image": partial(problem.streams.run, [view.forward for view in problem.views]),
            "gradient": problem.run_on_device,
        }
        for name, task in tasks.items():
            with wp.ScopedCapture(device) as capture:
                task()
            found[f"{name}_s"] = median(timed(partial(wp.capture_launch, capture.graph), 50) for _ in range(repeats))
        found["iteration_s"] = median(timed(descent.iterate, 50) for _ in range(repeats))
        n = 1 << 28
        source, target = wp.zeros(n, dtype=float, device=device), wp.zeros(n, dtype=float, device=device)
        copy_s = median(timed(lambda: wp.copy(target, source), 10) for _ in range(5))
        found["bytes"] = traffic(problem)
        found["copy_bytes_per_s"] = 8 * n / copy_s
        found["fraction_of_copy"] = found["bytes"] / found["iteration_s"] / found["copy_bytes_per_s"]
        # with a look at the loss and at x on the host after every STRIDE iterations
        found["iteration_with_looks_s"] = median(
            timed(partial(descent.step, state), 1) / descent.STRIDE for _ in range(repeats)
        )
        found["peak_device_gib"] = wp.get_mempool_used_mem_high(device) / 2**30
    else:
        adam = Adam(problem, state, 0.01)
        state = adam.step(state)
        found["image_s"] = median(timed(problem.views[0].forward, 1) for _ in range(repeats))
        found["iteration_s"] = median(timed(partial(adam.step, state), 1) for _ in range(repeats))
    hits = [view.render.hits for view in problem.views]
    return {
        "device": device.name,
        "faces": len(scene.mesh.faces),
        "vertices": len(scene.mesh.vertices),
        "pixels": list(pixels),
        "views": views,
        "rays": sum(h.rays for h in hits),
        "merged_hits": sum(h.count for h in hits),
        "parameters": int(problem.x0.size),
        "prepare_s": prepare_s,
        **found,
    }


def traffic(problem: FitProblem) -> int:
    """Bytes of an iteration's arrays, each read or written once by every kernel that has to (no caches between them).

    Per hit: look-up 28 (face, barycentric; coordinates), sigma0 52 (face, three cosines, coordinates; sigma0, slopes),
    deposit 12; their adjoints: 16 (pixel, weight, gradient twice), 52 (slopes, gradient; the coordinates' gradient
    twice), 16; 20 to clear gradients. Per hit and corner 8 (hit and share); per node 12 (itself, its gradient twice),
    36 for Adam.
    """
    hits = sum(view.render.hits.count for view in problem.views)
    nodes = problem.shared_nodes.size
    mesh = problem.scene.mesh
    per_view = 12 * len(mesh.faces) + 12 * nodes + 20 * problem.scene.grid.shape[0] * problem.scene.grid.shape[1]
    return hits * (28 + 52 + 12 + 16 + 52 + 16 + 20 + 3 * 8) + len(problem.views) * per_view + 36 * nodes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", help="cpu, cuda, cuda:N; default as the program's")
    parser.add_argument("--faces", type=int, default=100_000)
    parser.add_argument("--pixels", type=int, nargs=2, default=(256, 256), metavar=("ROWS", "COLS"))
    parser.add_argument("--rays-per-pixel", type=float, nargs="+", default=[16.0])
    parser.add_argument("--views", type=int, default=1, help="views around the town")
    parser.add_argument("--repeats", type=int, default=10)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    device = devices.resolve_device(options.device)
    with TemporaryDirectory() as folder:
        rows = [
            measure(device, options.faces, tuple(options.pixels), rays, options.views, options.repeats, Path(folder))
            for rays in options.rays_per_pixel
        ]
    text = json.dumps({"benchmark": "iterate", "sizes": rows}, indent=1) + "\n"
    if options.out:
        options.out.write_text(text)
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
