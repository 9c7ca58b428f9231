"""How `learn` (32 views) and `simulate` (1,000 images) gain by processes.

    python benchmarks/scaling.py --device cuda --ranks 1 2 4 --out scaling.json [--write]
    python benchmarks/scaling.py --device cpu --ranks 1 2 --faces 20000 --pixels 96 --views 8 --images 200

Processes on the CPU have one thread each. Times are those of the slowest process; kernels are loaded before. The second
table has parts of what the first one tells: what does not divide is seen there.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tables
from simulate import machine, said

from warpsar.runtime import devices, once

STEPS = 5  # of GraphAdam, ten iterations each; as many iterations of Adam on the CPU
RAYS_PER_PIXEL = 32.0


def town_of(sharing: Any, device: Any, options: argparse.Namespace, folder: Path) -> Any:
    """The town with a field of three parameters per vertex, and images of it from all around, brighter than its own."""
    from scenes import LOOKS, around, town_scene

    from warpsar.io.images import write_tiff
    from warpsar.simulation.command import Simulation
    from warpsar.surface.stage import Stage

    scene = town_scene(options.faces, (options.pixels, options.pixels), RAYS_PER_PIXEL, layout="vertex")
    scene = around(scene, options.views, 0.0)
    made = Simulation(scene, Stage.of(scene, device))
    for index in sharing.mine([1.0] * len(scene.views)):
        view = scene.views[index]
        write_tiff(folder / f"{view.name}.tif", 1.3 * made.view(view, index).beta0["HH"])  # not the start
    del made
    sharing.barrier()
    seen = [{"images": {"HH": folder / f"{view.name}.tif"}, "looks": LOOKS} for view in scene.views]
    return replace(scene, views=[view.model_copy(update=one) for view, one in zip(scene.views, seen, strict=True)])


def timed(sharing: Any, device: Any, task: Callable[[], Any]) -> tuple[float, Any]:
    """Seconds of the slowest process, and what the task returns."""
    import warp as wp

    wp.synchronize_device(device)
    sharing.barrier()
    started = time.perf_counter()
    result = task()
    wp.synchronize_device(device)
    return sharing.largest(time.perf_counter() - started), result


def learn(sharing: Any, device: Any, options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """The whole of `learn`, an iteration of it, and its parts."""
    import warp as wp

    import warpsar
    from warpsar.learning.adam import Adam, GraphAdam
    from warpsar.learning.command import LearnOptions
    from warpsar.learning.gradcheck import check_gradient
    from warpsar.learning.metrics import pooled_metrics
    from warpsar.learning.optimise import begin
    from warpsar.learning.problem import FitProblem
    from warpsar.learning.trust import outside_domains

    scene = town_of(sharing, device, options, folder)
    clock = partial(timed, sharing, device)

    def whole(iterations: int) -> float:
        chosen = LearnOptions(optimiser="adam", rate=0.01, iterations=iterations)
        return clock(lambda: warpsar.learn(scene, device=device.alias, options=chosen))[0]

    whole(1)
    found: dict[str, Any] = {}
    found["prepare_s"], problem = clock(lambda: FitProblem(scene, device, shared=True))
    state = begin(problem, 0, 0)
    way = Adam if problem.shared_nodes is None else GraphAdam
    found["begin_s"], descent = clock(lambda: way(problem, state, 0.01))
    state = descent.step(state)

    def iterate() -> None:
        nonlocal state
        for _ in range(STEPS):
            state = descent.step(state)

    iterations = STEPS * getattr(descent, "STRIDE", 1)
    found["iteration_s"] = found["unseen_s"] = clock(iterate)[0] / iterations
    if isinstance(descent, GraphAdam):
        found["unseen_s"] = clock(lambda: [descent.iterate() for _ in range(iterations)])[0] / iterations
    x = np.asarray(state.x)
    found["check_s"] = clock(lambda: check_gradient(problem, problem.x0))[0]
    found["metrics_s"] = clock(lambda: pooled_metrics(problem, state.x))[0]
    found["domains_s"] = clock(lambda: outside_domains(problem, x))[0]
    found["learn_s"] = whole(options.iterations)
    gradient: Any = wp.zeros(problem.surface.nodes.size, dtype=float, device=device)
    sharing.sum_on_device(gradient)
    found["reduce_s"] = clock(lambda: [sharing.sum_on_device(gradient) for _ in range(20)])[0] / 20
    hits = [view.render.hits for view in problem.views]
    return found | {
        "views_here": [int(n) for n in sharing.gather(len(hits))],
        "merged_hits": int(sharing.sum(sum(each.count for each in hits))),
        "rays": int(sharing.sum(sum(each.rays for each in hits))),
        "parameters": int(problem.x0.size),
        "reduced_bytes": 4 * problem.surface.nodes.size,
        "loss": state.loss,
    }


def write_town(options: argparse.Namespace, path: Path) -> None:
    """The town as a scene file."""
    from scenes import town_scene

    from warpsar.io.ply import write_ply

    scene = town_scene(options.faces, (options.pixels, options.pixels), RAYS_PER_PIXEL)
    write_ply(path.with_suffix(".ply"), scene.mesh.vertices, scene.mesh.faces, {})
    spacing = [float(step) for step in scene.grid.spacing_m]
    material = scene.materials["town"].model_dump(mode="json", exclude_unset=True)
    text = [
        f'[scene]\nmesh = "{path.stem}.ply"',
        f'[radar]\nfrequency_hz = {scene.radar.frequency_hz}\npolarizations = ["HH"]',
        f"[image]\nshape = [{options.pixels}, {options.pixels}]\nspacing_m = {spacing}",
        f"[sampling]\nrays_per_pixel = {RAYS_PER_PIXEL}",
        "[materials.default]",
        *(f"{key} = {value}" for key, value in material.items()),
        '[[views]]\nname = "west"\nazimuth_deg = 270.0\nincidence_deg = 45.0',
    ]
    path.write_text("\n".join(text) + "\n")


def simulate(sharing: Any, device: Any, options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Images of the town at as many azimuths; what a process spends on an image, and on its file."""
    from warpsar.io.images import write_exr
    from warpsar.scene.scene import Scene
    from warpsar.simulation import batch
    from warpsar.simulation.command import Simulation
    from warpsar.simulation.maker import sha256
    from warpsar.surface.stage import Stage

    path = folder / "town.toml"
    if sharing.first:
        write_town(options, path)
    sharing.barrier()

    def images(count: int, out: Path) -> float:
        sharing.barrier()
        started = time.perf_counter()
        batch.run([path], out, azimuths=f"0:360:{360.0 / count:g}", incidences="45", device=device.alias)
        return sharing.largest(time.perf_counter() - started)

    images(2 * sharing.size, folder / "warm")
    wall_s = images(options.images, folder / "out")
    started = time.perf_counter()
    scene = Scene.load(path)
    loaded = time.perf_counter()
    one = Simulation(scene, Stage.of(scene, device))
    one.view(scene.views[0], 0)
    ready = time.perf_counter()
    for index in range(10):
        image = one.view(scene.views[0], index)
    traced = time.perf_counter()
    for index in range(10):
        target = folder / f"probe{once.number()}_{index}.exr"
        write_exr(target, image.beta0)
        sha256(target)
    written = time.perf_counter()
    return {
        "wall_s": wall_s,
        "load_s": loaded - started,
        "first_s": ready - loaded,
        "image_s": (traced - ready) / 10,
        "file_s": (written - traced) / 10,
        "file_bytes": target.stat().st_size,
    }


def work(options: argparse.Namespace) -> None:
    device = devices.resolve_device(options.device)
    sharing = once.join(device)
    folder = Path(options.folder)
    found: dict[str, Any] = {"ranks": sharing.size, "device": device.name}
    for name, task in (("learn", learn), ("simulate", simulate)):
        (folder / name).mkdir(exist_ok=True)
        found[name] = task(sharing, device, options, folder / name)
    if sharing.first:
        (folder / "found.json").write_text(json.dumps(found))


def table(result: dict[str, Any]) -> str:
    header = ["processes", "iteration, ms", "speed-up", "all-reduce, ms", "MB", "preparation, s", "speed-up"]
    header += [f"{result['iterations']} iterations of `learn`, s", "speed-up"]
    header += [f"{result['images']:,} images, s", "speed-up", "image, ms", "its file, ms"]
    first, rows = result["entries"][0], []
    for each in result["entries"]:
        one, many = each["learn"], each["simulate"]
        gain = [f"{first['learn'][key] / one[key]:.2f}" for key in ("iteration_s", "prepare_s", "learn_s")]
        row = [each["ranks"], f"{1e3 * one['iteration_s']:.2f}", gain[0], f"{1e3 * one['reduce_s']:.3f}"]
        row += [f"{one['reduced_bytes'] / 1e6:.2f}", f"{one['prepare_s']:.2f}", gain[1], f"{one['learn_s']:.2f}"]
        row += [gain[2], f"{many['wall_s']:.2f}", f"{first['simulate']['wall_s'] / many['wall_s']:.2f}"]
        rows.append([*row, f"{1e3 * many['image_s']:.2f}", f"{1e3 * many['file_s']:.2f}"])
    return tables.markdown(header, rows)


PARTS = {
    "learn": {
        "unseen_s": "iteration without looks",
        "check_s": "gradient check",
        "begin_s": "graph",
        "metrics_s": "metrics of all views",
        "domains_s": "domains",
    },
    "simulate": {"load_s": "scene read", "first_s": "upload, first image"},
}


def parts_table(result: dict[str, Any]) -> str:
    header = ["processes", *(f"{name}, ms" for part in PARTS.values() for name in part.values())]
    rows = [
        [each["ranks"], *(f"{1e3 * each[command][key]:.2f}" for command, part in PARTS.items() for key in part)]
        for each in result["entries"]
    ]
    return tables.markdown(header, rows)


def bodies(result: dict[str, Any]) -> dict[str, str]:
    one = result["entries"][0]["learn"]
    losses = np.array([each["learn"]["loss"] for each in result["entries"]])
    about = (
        f"{said(result)}; {result['faces']:,} faces, {one['parameters']:,} parameters, {result['views']} views of "
        f"{result['pixels']} x {result['pixels']} pixels, {one['rays']:,} rays, {one['merged_hits']:,} merged hits. "
        f"Losses after {STEPS + 1} steps differ by {np.ptp(losses) / losses[0]:.1e} at most."
    )
    name = f"scaling.{result['device'].split(':')[0]}.{result['pixels']}px.{result['images']}images"
    return {name: f"{about}\n\n{table(result)}\n\n{parts_table(result)}"}


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Every number of processes, one after the other."""
    result: dict[str, Any] = {**machine(options.device), "entries": []}
    sizes = ("faces", "pixels", "views", "iterations", "images")
    result |= {name: getattr(options, name) for name in sizes}
    for count in options.ranks:
        with TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--no-python"]
            command += ["--nproc-per-node", str(count), sys.executable, __file__, "--folder", folder]
            for name in ("device", *sizes):
                command += [f"--{name}", str(getattr(options, name))]
            threads = {"WARPSAR_THREADS": "1"} if options.device == "cpu" else {}
            print(f"{count} processes", file=sys.stderr)
            subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "1", **threads})
            result["entries"].append(json.loads((Path(folder) / "found.json").read_text()))
        tables.save(options.out, result)  # after every number: a later one may not end
    return result


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", default="cuda", help="cpu or cuda")
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--faces", type=int, default=900_000)
    parser.add_argument("--pixels", type=int, default=400, help="of a side")
    parser.add_argument("--views", type=int, default=32)
    parser.add_argument("--iterations", type=int, default=100, help="of the whole of learn")
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--folder", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.folder:
        work(options)
        return
    result = tables.stored(options.source) if options.source else run(options)
    tables.publish(bodies(result), result, options.write)


if __name__ == "__main__":
    main()
