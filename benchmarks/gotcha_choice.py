"""Which model of the Gotcha scene: each is fitted to one of the two train views and foretells the other.

    python benchmarks/gotcha_choice.py DATA -o OUT --variant NAME [--fit az001] [--shared 1]

az003 is not looked at. OUT gets the scene with objects and NAME-SHARED-VIEW.json: the deviance over the floor of its
looks of the view that was fitted and of the one that was not, after every step; and that of the 3 x 3 mean of the
fitted view. A variant is named by words:

    single    no bounces between cars and ground            detail    cars and things have detail
    taylor    Taylor's window in range, in azimuth none     share     each has a share of it of its own
    glints    a glint for a car where it pays               level     without a trend of the ground's brightness
    cars      no things                                     floor     noise in every pixel
    rigid, lean, straight, short, place                     fewer numbers of a body (`LEAN`)
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

import gotcha_cars as cars
import numpy as np
from gotcha import BOUNCES, KNOWN_SPREAD, TRAIN, prepare, seen_from, smoothed, with_detail
from gotcha_glints import with_glints

from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.speckle.likelihood import best_gain, deviance, expected_deviance

LEAN = {
    "rigid": cars.POSE,
    "lean": ("east", "north", "heading", "length", "height"),
    "straight": ("east", "north", "length", "height"),
    "short": ("east", "north", "heading", "height"),
    "place": ("east", "north"),
}
SINC = {"range_fwhm_m": 0.594, "azimuth_fwhm_m": 1.48, "window": "sinc"}  # nearest to theory with one window for both
ROUNDS, BEFORE = 5, 2  # how many, and how many of them before glints


def left(scene: Scene, view: str) -> float:
    """Mean deviance of a view over the floor of its looks, one gain fitted."""
    problem = cars.problem_of(scene, [view])
    (modelled,), (seen,) = problem.modelled(problem.x0), problem.observations
    gain = best_gain("gamma", seen.values, modelled, seen.looks)
    return float(deviance(seen.values, modelled * gain, seen.looks).mean() / expected_deviance(seen.looks))


def rival(scene: Scene, fitted: str, view: str) -> float:
    """As `left`, of the 3 x 3 mean of the fitted view as it lies on z = 0."""
    images = {one.name: cars.whole(scene, one) for one in scene.views if one.name in TRAIN}
    image = smoothed(seen_from(scene, {fitted: np.asarray(images[fitted].measured)}, view))
    seen = images[view]
    mask = seen.interior & np.isfinite(image) & (image > 0)
    measured, modelled = np.asarray(seen.measured, float)[mask], image[mask]
    gain = best_gain("gamma", measured, modelled, seen.looks)
    return float(deviance(measured, modelled * gain, seen.looks).mean() / expected_deviance(seen.looks))


def variant(scene: Scene, name: str) -> tuple[Scene, Sequence[str]]:
    """The scene with the effects of a variant, and what of an object is fitted."""
    if "cars" in name:
        scene = with_objects(scene, [one for one in scene.objects if one.primitive == "car"])
    scene = cars.with_effects(scene, point_spread=KNOWN_SPREAD if "taylor" in name else SINC)
    if "level" not in name:
        scene = cars.with_effects(scene, eps_gradient={"per_m_east": 0.0, "per_m_north": 0.0})
    if "floor" in name:
        scene = cars.with_effects(scene, noise_floor={"level": 5e-4})
    if "single" not in name:
        scene = cars.with_effects(scene, multibounce=BOUNCES)
    if "detail" in name:
        scene = with_detail(scene)
    keys: Sequence[str] = (*cars.POSE, *cars.SHAPE)
    for word, lean in LEAN.items():
        keys = lean if word in name else keys
    return scene, (*keys, cars.DETAIL) if "share" in name else keys


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--variant", default="full", help="words, as above, with - between them")
    parser.add_argument("--fit", default=TRAIN[0], choices=TRAIN)
    parser.add_argument("--shared", type=float, default=1.0, help="pixels that the likelihood counts as one speckle")
    given = parser.parse_args()
    name = f"{given.variant}-{given.shared:g}-{given.fit}"
    started = time.perf_counter()
    course: list[dict[str, object]] = []
    scene = Scene.load(prepare(given.data, given.out / name, flat=False))
    scene, keys = variant(scene, given.variant)
    starts, fit = scene.objects, [given.fit]

    def told(step: str) -> None:
        course.append({"step": step, "s": round(time.perf_counter() - started), **{v: left(scene, v) for v in TRAIN}})
        print(name, course[-1], flush=True)

    other = next(v for v in TRAIN if v not in fit)
    course.append({"step": "3 x 3 mean", other: rival(scene, fit[0], other)})
    print(name, course[-1], flush=True)
    belief = cars.Belief(shared=given.shared)
    scene = cars.fit_common(scene, fit)
    told("brightness")
    for number in range(ROUNDS):
        if "glints" in name and number == BEFORE:
            scene = with_glints(scene, fit, belief.shared)
            starts = (*starts, *scene.objects[len(starts) :])
        scene, _ = cars.fit_round(scene, starts, fit, keys, belief=belief)
        scene = cars.fit_common(scene, fit)
        told(f"round {number + 1}")
    scene.save(given.out / name / "fitted.toml")
    (given.out / f"{name}.json").write_text(json.dumps(course, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
