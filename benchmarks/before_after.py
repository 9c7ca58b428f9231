"""Two checkouts beside each other: how long each step takes in either, and whether their numbers are equal to the bit.

    python benchmarks/before_after.py BEFORE AFTER [--device cuda] [--rounds 5] [--faces 200000] [--out ab.json]

`BEFORE` and `AFTER` are folders with a checkout each; neither need be installed. Their processes take turns, so that
other work on the machine falls on both, and of every step the least time counts: CPU seconds of all threads on the CPU,
which other programs change less, and wall time on CUDA. Steps: rays to hits, image and
gradient of hits that are kept, exact areas, an image with blur, paths of several bounces, and the making of fit
problems, of which `diagnose` makes hundreds; the town of benchmarks/scenes.py, and the example.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

WITH = ("point_spread", "registration", "multibounce", "edge_diffraction")
FITTED_WITH = (None, "point_spread", "registration", "noise_floor", "vegetation")


def measured(device_name: str, faces: int, repeats: int, only: str) -> dict[str, Any]:
    """Least seconds of each step in this process, and a digest of what it made."""
    import numpy as np
    import warp as wp
    from scenes import example_with, town_scene

    from warpsar.effects.registry import declared
    from warpsar.learning.problem import FitProblem
    from warpsar.render.render import ViewRender
    from warpsar.runtime import devices
    from warpsar.simulation.command import simulate
    from warpsar.simulation.rays import Rays, hit_grid, view_seed
    from warpsar.surface.stage import Stage
    from warpsar.trace.exact import exact_hits
    from warpsar.trace.trace import trace
    from warpsar.world.world import geometry_of

    device = devices.resolve_device(device_name)
    clock = time.process_time if device.is_cpu else time.perf_counter
    found: dict[str, Any] = {}

    def step(name: str, task: Callable[[], Any], made: Callable[[Any], list[Any]], repeats: int = repeats) -> Any:
        result = task()
        if only not in name:
            return result
        wp.synchronize_device(device)
        digest = hashlib.sha256()
        for array in made(result):
            digest.update(np.ascontiguousarray(array))
        least = np.inf
        for _ in range(repeats):
            start = clock()
            task()
            wp.synchronize_device(device)
            least = min(least, clock() - start)
        found[name] = {"s": least, "digest": digest.hexdigest()}
        return result

    def of_hits(hits: Any) -> list[Any]:
        names = ("pixel", "face", "barycentric", "weight", "point", "cos_incidence", "cos_twist", "cos2_azimuth")
        return [getattr(hits, name).numpy() for name in names]

    def image_and_gradient(name: str, render: Any) -> None:
        pol = next(iter(render.images))
        seed = wp.array(np.linspace(0.5, 1.5, render.images[pol].size, dtype=np.float32), device=device)

        def gradient() -> None:
            render.program.forward(gradient=True)
            render.program.backward({render.images[pol]: seed})

        step(f"{name}: image", render.program.forward, lambda _: [render.images[pol].numpy()])
        step(
            f"{name}: image and gradient",
            gradient,
            lambda _: [render.nodes.grad.numpy(), *(v.grad.numpy() for v in render.effect_values.values())],
        )

    scene = town_scene(faces, (400, 360), 32.0, layout="vertex")
    stage, view = Stage.of(scene, device), scene.views[0]
    geometry, seed = geometry_of(scene, view), view_seed(scene.sampling.seed, 0)
    grid, density = hit_grid(scene), scene.sampling.density_per_m2(scene.grid)
    for deposit in ("footprint", "nearest"):
        hits = step(
            f"rays to hits, {deposit}",
            lambda deposit=deposit: trace(stage.target, geometry, grid, density, seed=seed, deposit=deposit),
            of_hits,
        )
    image_and_gradient("town", ViewRender(stage, view, hits, scene.grid.shape, scene.radar.polarizations, []))
    if only in "exact areas":
        small = town_scene(4000, (64, 60), 16.0)
        target, looked = Stage.of(small, device).target, geometry_of(small, small.views[0])
        step("exact areas", lambda: exact_hits(target, looked, hit_grid(small), 16.0), of_hits)
    for effect in WITH if not only or only in WITH else ():
        scene = example_with(effect, 64.0)
        stage, view = Stage.of(scene, device), scene.views[0]
        grid, density = hit_grid(scene), scene.sampling.density_per_m2(scene.grid)
        hits = trace(stage.target, geometry_of(scene, view), grid, density, seed=view_seed(scene.sampling.seed, 0))

        def made(hits: Any = hits, stage: Any = stage, view: Any = view, scene: Any = scene) -> Any:
            hits.derived.clear()
            return ViewRender(stage, view, hits, scene.grid.shape, scene.radar.polarizations, declared(scene, view))

        image_and_gradient(effect, step(f"{effect}: recorded", made, lambda render: list(render.forward().values()), 3))
    if only in "fit problem":
        scene, observations = example_with(None, 64.0), None
        images = {one.name: one.beta0 for one in simulate(scene, device=device.alias)}
        seen = [view.model_copy(update={"images": images[view.name], "looks": 4.0}) for view in scene.views]
        rays = Rays(Stage.of(scene, device), seed=scene.sampling.seed)
        for effect in FITTED_WITH:

            def problem(effect: str | None = effect, observations: Any = observations) -> FitProblem:
                asked = replace(example_with(effect, 64.0), views=seen)
                return FitProblem(asked, device, rays=rays, observations=observations)

            kept = step(f"fit problem{f' with {effect}' if effect else ''}", problem, FitProblem.modelled_as_declared)
            observations = {view.view.name: view.observations for view in kept.views}
    return found


def laid_out(checkout: Path, folder: Path) -> None:
    """The checkout's packages as they lie once installed."""
    package = folder / "warpsar"
    package.mkdir()
    for part in (checkout / "warpsar").iterdir():
        (package / part.name).symlink_to(part.resolve())
    for part in ("kernels", "cli"):
        (package / part).symlink_to((checkout / part).resolve())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path, nargs="?")
    parser.add_argument("after", type=Path, nargs="?")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--faces", type=int, default=200_000)
    parser.add_argument("--only", default="", help="the steps with this in their name")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here:
        print(json.dumps(measured(options.device, options.faces, options.repeats, options.only)))
        return
    if options.before is None or options.after is None:
        parser.error("two folders are needed: the checkouts before and after")
    found: list[dict[str, Any]] = [{}, {}]
    with TemporaryDirectory() as name:
        folders = [Path(name) / "before", Path(name) / "after"]
        for checkout, folder in zip((options.before, options.after), folders, strict=True):
            folder.mkdir()
            laid_out(checkout, folder)
        words = ["--here", "--device", options.device, "--faces", str(options.faces), "--repeats", str(options.repeats)]
        words += ["--only", options.only]
        for turn in range(options.rounds):
            for which in (0, 1) if turn % 2 == 0 else (1, 0):
                environment = {
                    **os.environ,
                    "PYTHONPATH": os.pathsep.join([str(folders[which]), os.environ.get("PYTHONPATH", "")]),
                }
                command = [sys.executable, __file__, *words]
                done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
                for step, row in json.loads(done.stdout.splitlines()[-1]).items():
                    kept = found[which].setdefault(step, row)
                    kept["s"] = min(kept["s"], row["s"])
    print(f"{'step':40} {'before ms':>10} {'after ms':>10} {'ratio':>6}  bits")
    for step, before in found[0].items():
        after = found[1][step]
        same = "equal" if before["digest"] == after["digest"] else "differ"
        ratio = after["s"] / before["s"]
        print(f"{step:40} {1e3 * before['s']:10.2f} {1e3 * after['s']:10.2f} {ratio:6.3f}  {same}")
    if options.out:
        options.out.write_text(json.dumps(dict(zip(("before", "after"), found, strict=True)), indent=1))


if __name__ == "__main__":
    main()
