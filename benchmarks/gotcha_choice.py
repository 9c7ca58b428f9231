"""Which model of the Gotcha scene: each is fitted to one of the two train views and foretells the other.

    python benchmarks/gotcha_choice.py DATA -o OUT --variant NAME [--fit az001]

az003 is not looked at. OUT gets the scene with objects and NAME-VIEW.json: the deviance over the floor of its looks of
the view that was fitted and of the one that was not, after every step.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import gotcha_cars as cars
from gotcha import KNOWN_SPREAD, TRAIN, prepare
from gotcha_glints import with_glints

from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import best_gain, deviance, expected_deviance

LEAN = {
    "lean": ("east", "north", "heading", "length", "height"),
    "straight": ("east", "north", "length", "height"),
    "short": ("east", "north", "heading", "height"),
    "place": ("east", "north"),
}
BOUNCES: dict[str, Any] = {"strength": 0.3, "max_bounces": 2}
ROUNDS = 6


def left(scene: Scene, view: str) -> float:
    """Mean deviance of a view over the floor of its looks, one gain fitted."""
    problem = cars.problem_of(scene, [view])
    (modelled,), (seen,) = problem.modelled(problem.x0), problem.observations
    gain = best_gain("gamma", seen.values, modelled, seen.looks)
    return float(deviance(seen.values, modelled * gain, seen.looks).mean() / expected_deviance(seen.looks))


def variant(scene: Scene, name: str) -> tuple[Scene, Sequence[str]]:
    """The scene with the effects of a variant, and what of an object is fitted."""
    if "cars" in name:
        kept = [one for one in scene.objects if one.primitive == "car"]
        scene = with_objects(scene, kept, {k: m for k, m in scene.materials.items() if not k.startswith("thing")})
    bodies = [str(one.material) for one in scene.objects]
    scene = cars.with_effects(scene, point_spread=KNOWN_SPREAD)
    if "taylor" in name:
        scene = cars.with_effects(scene, point_spread={**KNOWN_SPREAD, "window": ["taylor", "sinc"]})
    if "level" not in name:
        scene = cars.with_effects(scene, eps_gradient={"per_m_east": 0.0, "per_m_north": 0.0})
    if "floor" in name:
        scene = cars.with_effects(scene, noise_floor={"level": 5e-4})
    if "single" not in name:
        scene = cars.with_effects(scene, multibounce=BOUNCES)
    if "detail" in name:
        scene = cars.with_effects(
            scene,
            unresolved_detail={"level": 0.035, "spread_m": 2.2, "materials": bodies, "learn": ["level", "spread_m"]},
        )
    keys = cars.POSE if "rigid" in name else (*cars.POSE, *cars.SHAPE)
    for word, lean in LEAN.items():
        keys = lean if word in name else keys
    return scene, (*keys, cars.DETAIL) if "share" in name else keys


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--variant", default="full", help="words of: full, single, detail, rigid, level")
    parser.add_argument("--fit", default=TRAIN[0])
    parser.add_argument("--shared", type=float, default=1.0, help="pixels that the likelihood counts as one speckle")
    given = parser.parse_args()
    name = f"{given.variant}-{given.shared:g}-{given.fit}"
    started, course = time.perf_counter(), []
    scene = Scene.load(prepare(given.data, given.out / name, flat=False))
    starts, fit = scene.objects, given.fit.split(",")
    scene, keys = variant(scene, given.variant)

    def told(step: str) -> None:
        course.append({"step": step, "s": round(time.perf_counter() - started), **{v: left(scene, v) for v in TRAIN}})
        print(name, course[-1], flush=True)

    belief = cars.Belief(shared=given.shared)
    scene = cars.fit_common(scene, fit)
    told("brightness")
    for number in range(ROUNDS):
        if "glints" in name and number == ROUNDS - 4:
            scene = with_glints(scene, fit, belief.shared)
            starts = (*starts, *scene.objects[len(starts) :])
        scene, _ = cars.fit_round(scene, starts, fit, keys, belief=belief)
        scene = cars.fit_common(scene, fit)
        told(f"round {number + 1}")
    scene.save(given.out / name / "fitted.toml")
    (given.out / f"{name}.json").write_text(json.dumps(course, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
