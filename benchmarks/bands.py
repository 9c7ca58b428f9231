"""A fit whose hits do not fit into memory: views traced again in bands, against views whose hits are kept. JSON.

python benchmarks/bands.py --device cuda --out bands.json                      # 10 million faces, 4096 x 4096 pixels
python benchmarks/bands.py --device cpu --faces 20000 --pixels 96 --views 2 --max-memory 0.01
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from warpsar.runtime import devices

sys.path.insert(0, str(Path(__file__).resolve().parent))


def measure(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    import warp as wp
    from scenes import town_scene

    from warpsar.io.images import write_tiff
    from warpsar.learning.optimise import begin, levenberg_marquardt
    from warpsar.learning.problem import FitProblem
    from warpsar.simulation.command import Simulation
    from warpsar.simulation.rays import Rays
    from warpsar.surface.stage import Stage
    from warpsar.world.tables import View

    device = devices.resolve_device(options.device)
    scene = town_scene(options.faces, (options.pixels, options.pixels), 64.0)
    angles = [360.0 * i / options.views for i in range(options.views)]
    views = [View(name=f"v{i}", azimuth_deg=a, incidence_deg=45.0, looks=16.0) for i, a in enumerate(angles)]
    scene = replace(scene, views=views)
    stage = Stage.of(scene, device)
    made = Simulation(scene, stage, max_memory_gib=options.trace_memory)
    seconds = []
    with ThreadPoolExecutor(8) as pool:  # files, while the next image is traced
        for index, view in enumerate(views):
            started = time.perf_counter()
            image = 1.3 * made.view(view, index).beta0["HH"]
            seconds.append(time.perf_counter() - started)
            pool.submit(write_tiff, folder / f"{view.name}.tif", image)
    views = [view.model_copy(update={"images": {"HH": folder / f"{view.name}.tif"}}) for view in views]
    scene = replace(scene, views=views)
    found: dict[str, Any] = {"device": device.name, "image_s": float(np.median(seconds))}
    gradients = []
    for name, gib in (("banded", options.max_memory), ("kept", None)):
        if name not in options.ways:
            continue
        started = time.perf_counter()
        problem = FitProblem(scene, device, rays=Rays(stage, seed=scene.sampling.seed), max_memory_gib=gib)
        wp.synchronize_device(device)
        ready = time.perf_counter()
        loss, gradient = problem.gradient(problem.x0)
        once = time.perf_counter()
        gradients.append(gradient)
        found[name] = {
            "views_in_bands": len(problem.bands),
            "bands": max(problem.bands.values(), default=1),
            "prepare_s": ready - started,
            "gradient_s": once - ready,
            "loss": loss,
        }
        if options.step:
            state = levenberg_marquardt(problem, begin(problem, 0, 0))
            found[name] |= {"step_s": time.perf_counter() - once, "loss_after": state.loss}
        if device.is_cuda:
            found[name]["peak_device_gib"] = wp.get_mempool_used_mem_high(device) / 2**30
        print(json.dumps({name: found[name]}), file=sys.stderr)
        del problem
    if len(gradients) == 2:
        found["difference"] = float(np.abs(gradients[0] - gradients[1]).max() / np.abs(gradients[1]).max())
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--faces", type=int, default=10_000_000)
    parser.add_argument("--pixels", type=int, default=4096, help="of a side")
    parser.add_argument("--views", type=int, default=16)
    parser.add_argument("--max-memory", type=float, default=16.0, metavar="GIB", help="of kept hits")
    parser.add_argument("--trace-memory", type=float, default=8.0, metavar="GIB")
    parser.add_argument("--ways", nargs="+", default=["banded", "kept"], choices=["banded", "kept"])
    parser.add_argument("--step", action="store_true", help="also one step of Levenberg-Marquardt")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with TemporaryDirectory() as folder:
        found = {"benchmark": "bands", "faces": options.faces, "pixels": options.pixels, "views": options.views}
        found |= measure(options, Path(folder))
    text = json.dumps(found, indent=1) + "\n"
    if options.out:
        options.out.write_text(text)
    print(text, end="")


if __name__ == "__main__":
    main()
