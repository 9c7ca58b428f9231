"""A fit whose hits do not fit into memory: views traced again in bands, against views whose hits are kept.

python benchmarks/bands.py --device cuda --step --out bands.json           # 10 million faces, 4096 x 4096 pixels
python benchmarks/bands.py --device cpu --faces 20000 --pixels 96 --views 2 --max-memory 0.01
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import tables
from scenes import around, measuring, town_scene
from simulate import machine, said

from warpsar.runtime import devices


def measured(scene: Any, stage: Any, trace_memory_gib: float) -> tuple[Any, float]:
    """The scene with images, brighter than it makes them, and the median seconds of an image."""
    from warpsar.simulation.command import Simulation

    made = Simulation(scene, stage, max_memory_gib=trace_memory_gib)
    seconds, images = [], []
    for index, view in enumerate(scene.views):
        started = time.perf_counter()
        images.append(1.3 * made.view(view, index).beta0["HH"])
        seconds.append(time.perf_counter() - started)
    return measuring(scene, images, speckled=False), float(np.median(seconds))


def fitted(scene: Any, stage: Any, device: Any, gib: float | None, step: bool) -> tuple[dict[str, Any], np.ndarray]:
    """Times of a fit whose hits take `gib` at most, and its gradient."""
    import warp as wp

    from warpsar.learning.optimise import begin, levenberg_marquardt
    from warpsar.learning.problem import FitProblem
    from warpsar.simulation.rays import Rays

    started = time.perf_counter()
    problem = FitProblem(scene, device, rays=Rays(stage, seed=scene.sampling.seed), max_memory_gib=gib)
    wp.synchronize_device(device)
    ready = time.perf_counter()
    loss, gradient = problem.gradient(problem.x0)
    once = time.perf_counter()
    found: dict[str, Any] = {
        "views_in_bands": len(problem.bands),
        "bands": max(problem.bands.values(), default=1),
        "prepare_s": ready - started,
        "gradient_s": once - ready,
        "loss": loss,
    }
    if step:
        state = levenberg_marquardt(problem, begin(problem, 0, 0))
        found |= {"step_s": time.perf_counter() - once, "loss_after": state.loss}
    if device.is_cuda:
        found["peak_device_gib"] = wp.get_mempool_used_mem_high(device) / 2**30
    return found, gradient


def measure(options: argparse.Namespace) -> dict[str, Any]:
    from warpsar.surface.stage import Stage

    scene = around(town_scene(options.faces, (options.pixels, options.pixels), 64.0), options.views, 0.0)
    device = devices.resolve_device(options.device)
    stage = Stage.of(scene, device)
    scene, image_s = measured(scene, stage, options.trace_memory)
    found: dict[str, Any] = {"image_s": image_s, "ways": {}}
    gradients = []
    for name, gib in (("banded", options.max_memory), ("kept", None)):
        if name in options.ways:
            found["ways"][name], gradient = fitted(scene, stage, device, gib, options.step)
            gradients.append(gradient)
    if len(gradients) == 2:
        found["difference"] = float(np.abs(gradients[0] - gradients[1]).max() / np.abs(gradients[1]).max())
    return found


COLUMNS = {
    "views_in_bands": ("views in bands", "d"),
    "bands": ("bands", "d"),
    "prepare_s": ("preparation, s", ".3g"),
    "gradient_s": ("loss and gradient, s", ".3g"),
    "step_s": ("step of Levenberg-Marquardt, s", ".3g"),
    "loss": ("loss", ".2g"),
    "loss_after": ("loss after the step", ".2g"),
    "peak_device_gib": ("peak of the device, GiB", ".3g"),
}


def table(result: dict[str, Any]) -> str:
    keys = [key for key in COLUMNS if any(key in way for way in result["ways"].values())]
    rows = [
        [name, f"{result['image_s']:.2g}", *(format(way[key], COLUMNS[key][1]) if key in way else "" for key in keys)]
        for name, way in result["ways"].items()
    ]
    of = f"{result['faces']:,} faces, {result['views']} views of {result['pixels']} x {result['pixels']} pixels"
    header = ["hits", "image, s", *(COLUMNS[key][0] for key in keys)]
    return f"{said(result)}; {of}, {result['max_memory_gib']:g} GiB of kept hits.\n\n{tables.markdown(header, rows)}"


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--faces", type=int, default=10_000_000)
    parser.add_argument("--pixels", type=int, default=4096, help="of a side")
    parser.add_argument("--views", type=int, default=16)
    parser.add_argument("--max-memory", type=float, default=16.0, metavar="GIB", help="of kept hits")
    parser.add_argument("--trace-memory", type=float, default=8.0, metavar="GIB")
    parser.add_argument("--ways", nargs="+", default=["banded", "kept"], choices=["banded", "kept"])
    parser.add_argument("--step", action="store_true", help="also one step of Levenberg-Marquardt")
    options = parser.parse_args()
    about = {name: getattr(options, name) for name in ("faces", "pixels", "views")}
    about["max_memory_gib"] = options.max_memory
    result = tables.result_of(options, lambda: machine(options.device) | about | measure(options))
    tables.publish({f"bands.{result['device'].split(':')[0]}": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
