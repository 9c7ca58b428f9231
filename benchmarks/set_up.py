"""How long the making of fit problems takes, without any fit: `diagnose` makes hundreds and thousands of them.

    python benchmarks/set_up.py SCENE [--times 200]

CPU milliseconds of one thread: a problem whose rays are traced and its images once; four such problems, each with one
more effect; a scene with one more effect; and the exact areas of a view of a new mesh, as a moved object has one. A
digest of the images and of the hits says whether two versions give the same bits.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import time
from collections.abc import Callable
from dataclasses import replace

os.environ["WARPSAR_THREADS"] = "1"

import numpy as np

from warpsar.effects.registry import get, validate
from warpsar.learning.problem import FitProblem
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays, hit_grid
from warpsar.surface.stage import Stage
from warpsar.trace.exact import exact_hits
from warpsar.trace.hits import ARRAYS
from warpsar.trace.target import Target
from warpsar.world.world import geometry_of

EFFECTS = ("point_spread", "registration", "noise_floor", "vegetation")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene")
    parser.add_argument("--times", type=int, default=200)
    options = parser.parse_args()
    scene = Scene.load(options.scene)
    device = devices.resolve_device("cpu")
    rays = Rays(Stage.of(scene, device), seed=scene.sampling.seed)
    observations = {view.view.name: view.observations for view in FitProblem(scene, device, rays=rays).views}
    digest = hashlib.sha256()

    def problem(of: Scene) -> None:
        made = FitProblem(of, device, rays=rays, observations=observations)
        for image in made.modelled_as_declared():
            digest.update(image)

    def with_effect(name: str) -> Scene:
        p = get(name).parameters[0]
        named = {"view": scene.views[0].name, "material": scene.mesh.materials[0]}
        table = {p.name: {named[p.keyed_by]: p.start} if p.keyed_by else p.start}
        return replace(scene, effects={**scene.effects, name: validate(name, table, "effects")})

    def exact() -> None:
        target = Target.upload(scene.mesh, scene.reference_point_m, device)
        for view in scene.views:
            hits = exact_hits(target, geometry_of(scene, view), hit_grid(scene), 16.0)
            for name in ARRAYS:
                digest.update(np.ascontiguousarray(getattr(hits, name).numpy()))

    tasks: list[tuple[str, Callable[[], object], int]] = [
        ("problem", lambda: problem(scene), 1),
        ("problems with one more effect", lambda: [problem(with_effect(name)) for name in EFFECTS], len(EFFECTS)),
        ("scene with one more effect", lambda: with_effect("noise_floor"), 1),
        ("exact areas of a view", exact, len(scene.views)),
    ]
    for title, task, each in tasks:
        task()
        start = time.process_time()
        for _ in range(options.times // each):
            task()
        print(f"{title:32} {1e3 * (time.process_time() - start) / (options.times // each * each):8.2f} ms")
    print(f"bits {digest.hexdigest()[:16]}")


if __name__ == "__main__":
    main()
