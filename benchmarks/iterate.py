"""One learning iteration: image, loss, gradient to every vertex and parameter, update.

    python benchmarks/iterate.py --device cuda --faces 900482 --pixels 423 380 --rays-per-pixel 32 128 512 --out FILE
    python benchmarks/iterate.py --device cuda --faces 20000 --pixels 96 96 --rays-per-pixel 32 --views 12 --out FILE

The town of benchmarks/scenes.py with per-vertex parameters, measured against its own speckled image. On CUDA the
iteration is one captured graph; beside its time stand the bytes that its kernels have to move, and a copy's rate on the
same device. On the CPU it is the host-side loop.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import tables
from scenes import around, measuring, town_scene
from simulate import machine, said

from warpsar.learning.adam import Adam, GraphAdam
from warpsar.learning.optimise import begin
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.simulation.command import simulate


def measured_town(device: Any, faces: int, pixels: tuple[int, int], rays: float, views: int) -> Any:
    """The town with parameters at its vertices and `views` images of 16 looks of itself."""
    scene = around(town_scene(faces, pixels, rays, layout="vertex"), views)
    return measuring(scene, [found.beta0["HH"] for found in simulate(scene, device=device.alias, seed=1)])


def timed(device: Any, task: Callable[[], Any], turns: int = 1) -> float:
    """Seconds of a turn."""
    import warp as wp

    wp.synchronize_device(device)
    started = time.perf_counter()
    for _ in range(turns):
        task()
    wp.synchronize_device(device)
    return (time.perf_counter() - started) / turns


def on_cuda(problem: FitProblem, state: Any, device: Any, repeats: int) -> dict[str, Any]:
    """An iteration as one captured graph, its parts, and the rate of a copy."""
    import warp as wp

    def often(task: Callable[[], Any], turns: int, times: int = repeats) -> float:
        return median(timed(device, task, turns) for _ in range(times))

    found: dict[str, Any] = {}
    descent = GraphAdam(problem, state, 0.01)
    for name, task in {
        "image": partial(problem.streams.run, [view.forward for view in problem.views]),
        "gradient": problem.run_on_device,
    }.items():
        with wp.ScopedCapture(device) as capture:
            task()
        found[f"{name}_s"] = often(partial(wp.capture_launch, capture.graph), 50)
    found["iteration_s"] = often(descent.iterate, 50)
    n = 1 << 28
    source, target = wp.zeros(n, dtype=float, device=device), wp.zeros(n, dtype=float, device=device)
    found["bytes"] = traffic(problem)
    found["copy_bytes_per_s"] = 8 * n / often(lambda: wp.copy(target, source), 10, 5)
    found["fraction_of_copy"] = found["bytes"] / found["iteration_s"] / found["copy_bytes_per_s"]
    # with a look at the loss and at x on the host after every STRIDE iterations
    found["iteration_with_looks_s"] = often(partial(descent.step, state), 1) / descent.STRIDE
    found["peak_device_gib"] = wp.get_mempool_used_mem_high(device) / 2**30
    return found


def on_cpu(problem: FitProblem, state: Any, device: Any, repeats: int) -> dict[str, Any]:
    """An iteration of the host-side loop, and the image in it."""
    adam = Adam(problem, state, 0.01)
    state = adam.step(state)
    tasks = {"image_s": problem.views[0].forward, "iteration_s": partial(adam.step, state)}
    return {name: median(timed(device, task) for _ in range(repeats)) for name, task in tasks.items()}


def measure(device: Any, faces: int, pixels: tuple[int, int], rays: float, views: int, repeats: int) -> dict[str, Any]:
    scene = measured_town(device, faces, pixels, rays, views)
    problems: list[FitProblem] = []
    prepare_s = timed(device, lambda: problems.append(FitProblem(scene, device)))
    problem = problems[0]
    found = (on_cuda if device.is_cuda else on_cpu)(problem, begin(problem, 0, 0), device, repeats)
    hits = [view.render.hits for view in problem.views]
    return {
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


# Key of the JSON, heading, factor, format.
COLUMNS = (
    ("views", "views", 1, "d"),
    ("rays", "rays", 1, ",d"),
    ("merged_hits", "merged hits", 1, ",d"),
    ("parameters", "parameters", 1, ",d"),
    ("image_s", "image, ms", 1e3, ".3f"),
    ("gradient_s", "image + loss + gradient, ms", 1e3, ".3f"),
    ("iteration_s", "iteration with Adam, ms", 1e3, ".3f"),
    ("bytes", "MB", 1e-6, ".0f"),
    ("fraction_of_copy", "of the copy's rate", 1, ".2f"),
)


def table(result: dict[str, Any]) -> str:
    columns = [column for column in COLUMNS if column[0] in result["sizes"][0]]
    rows = [[format(factor * size[key], form) for key, _, factor, form in columns] for size in result["sizes"]]
    return f"{said(result)}.\n\n{tables.markdown([column[1] for column in columns], rows)}"


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", help="cpu, cuda, cuda:N; default as the program's")
    parser.add_argument("--faces", type=int, default=100_000)
    parser.add_argument("--pixels", type=int, nargs=2, default=(256, 256), metavar=("ROWS", "COLS"))
    parser.add_argument("--rays-per-pixel", type=float, nargs="+", default=[16.0])
    parser.add_argument("--views", type=int, default=1, help="views around the town")
    parser.add_argument("--repeats", type=int, default=10)
    options = parser.parse_args()

    def sizes() -> list[dict[str, Any]]:
        device, pixels = devices.resolve_device(options.device), tuple(options.pixels)
        given = options.views, options.repeats
        return [measure(device, options.faces, pixels, rays, *given) for rays in options.rays_per_pixel]

    result = tables.result_of(options, lambda: {**machine(options.device), "sizes": sizes()})
    name = f"iterate.{result['device'].split(':')[0]}.views{result['sizes'][0]['views']}"
    tables.publish({name: table(result)}, result, options.write)


if __name__ == "__main__":
    main()
