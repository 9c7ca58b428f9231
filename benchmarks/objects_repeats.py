"""Studies of benchmarks/objects.py that take many repeats: one JSON for each, so that a run goes on where it stopped.

Every repeat has its own speckle. A study says what one repeat finds, and makes the table's rows of all of them.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_rates
import runs
import tables
from objects_scenes import BODY, CAR, CPU, SIDES, measured, plain
from objects_whole import WHOLE, whole_rows, whole_run

from warpsar.diagnosis.geometry.missing_object import proposed
from warpsar.differentiable.geometry import exact_images
from warpsar.learning.pose_search import find_poses, group_pose
from warpsar.runtime import console
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

MATERIAL_KEYS = ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction")
BESIDE = ("none", "noise_floor", "point_spread", "registration", "multibounce")
LOOKS = (1, 4, 16)

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Study:
    """`repeat` takes a case, a seed and a folder for what repeats share, and returns JSON's types."""

    repeat: Callable[[str, int, Path], dict[str, Any]]
    rows: Callable[[Sequence[Row]], list[list[str]]]
    cases: tuple[str, ...] = ("",)
    repeats: int = 100
    shared: Callable[[Sequence[str], Path], None] = lambda _, __: None  # makes what repeats share, before they run


# ---- intervals ----


def car(_: str, seed: int, __: Path) -> dict[str, Any]:
    """A car of three views, on coarse pixels: each repeat is a whole fit."""
    one = Object(**{**CAR, "learn": ("position", "heading", "scale")})
    scene = measured(with_objects(plain(SIDES[:3], 24, 0.5), [one], {"body": BODY}), 1000 + seed)
    told = find_poses(scene, CPU, search=False).objects["car"]
    found = [*told["position_m"], told["heading_deg"], told["scale"][0]]
    said = [*told["position_sd_m"], told["heading_sd_deg"], told["scale_sd"]]
    return interval(("east", "north", "up", "heading", "scale"), found, said, (1.3, -0.8, 0.0, 35.0, 1.0))


def hut(_: str, seed: int, __: Path) -> dict[str, Any]:
    """A hut that stands elsewhere than its group of the mesh: found as `diagnose` does, from where the mesh has it."""
    truth, declared = diagnosis_rates.truth(geometry="object_pose"), diagnosis_rates.truth()
    place = diagnosis_rates.ELSEWHERE
    scene = replace(declared, views=measured(truth, 2000 + seed).views)
    return group_interval(scene, "hut", place["position_m"], place["heading_deg"])


def tower(_: str, seed: int, __: Path) -> dict[str, Any]:
    """The case moved_object of WARPSAR_CASES, with images of its true pose and surfaces by the project's own engine."""
    folder = Path(os.environ["WARPSAR_CASES"]) / "moved_object"
    told = json.loads((folder / "truth.json").read_text())
    _, east, north, turn = told["effects"]["moved"]
    pose = {"position_m": (east, north, 0.0), "heading_deg": turn}
    return group_interval(fresh_images(folder, pose, told, seed), "tower", **pose)


def fresh_images(folder: Path, pose: Mapping[str, Any], told: Mapping[str, Any], seed: int) -> Scene:
    """The case's scene file, with speckle of `seed` on the images of the truth."""
    declared, images = _clean_tower(folder, json.dumps(pose), json.dumps(told["materials"]))
    random = np.random.default_rng(3000 + seed)
    views = []
    for view in declared.views:
        assert view.looks is not None
        speckle = random.gamma(view.looks, 1.0 / view.looks, declared.grid.shape)
        seen = (images[view.name]["HH"] * speckle).astype(np.float32)
        views.append(view.model_copy(update={"images": {"HH": seen}}))
    return replace(declared, views=views)


@cache
def _clean_tower(folder: Path, pose: str, materials: str) -> tuple[Scene, Any]:
    declared = Scene.load(folder / "scene.toml")
    true = {
        name: Material(**dict(zip(MATERIAL_KEYS, values, strict=True)))
        for name, values in json.loads(materials).items()
    }
    return declared, exact_images(with_objects(declared, [Object(group="tower", **json.loads(pose))], true), CPU)


def group_interval(scene: Scene, group: str, position_m: tuple[float, ...], heading_deg: float) -> dict[str, Any]:
    told = group_pose(scene, CPU, group).objects[group]
    found, said = [*told["position_m"], told["heading_deg"]], [*told["position_sd_m"], told["heading_sd_deg"]]
    return interval(("east", "north", "up", "heading"), found, said, (*position_m, heading_deg))


def interval(names: Sequence[str], found: Sequence[float], said: Sequence[float], truth: Any) -> dict[str, Any]:
    return {"names": list(names), "error": np.subtract(found, truth).tolist(), "sd": list(map(float, said))}


def coverage(found: Sequence[Row]) -> list[list[str]]:
    """A row for each number: how often its 95 % interval holds the truth, and the errors over the deviations said."""
    e, s = (np.array([one[key] for one in found]) for key in ("error", "sd"))
    held = np.abs(e) < 1.96 * s
    return [
        [name, f"{np.median(s[:, k]):.2g}", f"{np.std(e[:, k]):.2g}", f"{int(held[:, k].sum())} of {len(e)}"]
        for k, name in enumerate(found[0]["names"])
    ]


# ---- proposals where no object is missing ----


def proposal(case: str, seed: int, folder: Path) -> dict[str, Any]:
    """`proposed` on a scene that lacks no object: nothing else of a diagnosis guards it. Speckle is correlated in every
    other repeat."""
    name, looks = case.rsplit(" ", 1)
    images = _images(name, folder)
    with tempfile.TemporaryDirectory() as made:
        scene = diagnosis_rates.measured(images, int(looks), bool(seed % 2), seed, Path(made))
        found = proposed(scene, CPU)
    return {"proposed": [one.values | {"gain": one.gain} for one in found]}


def clean_images(cases: Sequence[str], folder: Path) -> None:
    for name in dict.fromkeys(case.rsplit(" ", 1)[0] for case in cases):
        _images(name, folder)


def _images(name: str, folder: Path) -> list[np.ndarray]:
    return diagnosis_rates.clean_images(diagnosis_rates.CASES[name], "cpu", folder, name)


def proposal_rows(found: Sequence[Row]) -> list[list[str]]:
    """A row for each case: how many repeats proposed an object at 1, 4 and 16 looks."""
    rows = []
    for name in BESIDE:
        mine = [[bool(one["proposed"]) for one in found if one["case"] == f"{name} {n}"] for n in LOOKS]
        if any(mine):
            rows.append([name, *(f"{sum(named)} of {len(named)}" for named in mine)])
    return rows


STUDIES = {
    "intervals": Study(car, coverage),
    "elsewhere": Study(hut, coverage),
    "moved": Study(tower, coverage),
    "proposals": Study(
        proposal, proposal_rows, tuple(f"{name} {n}" for name in BESIDE for n in LOOKS), shared=clean_images
    ),
    "whole": Study(whole_run, whole_rows, tuple(WHOLE), 20),
}


def repeated(name: str, out: Path, repeats: int | None, jobs: int, cases: Sequence[str] = ()) -> list[Row]:
    """Every repeat of a study: those that `out` does not hold yet are made, `jobs` at a time, a core for each."""
    study = STUDIES[name]
    chosen = [case for case in study.cases if not cases or case in cases]
    wanted = [(name, case, seed) for seed in range(repeats or study.repeats) for case in chosen]
    missing = [key for key in wanted if not path_of(out, key).is_file()]
    bar = console.progress(len(missing), name, "repeat")
    (out / name).mkdir(parents=True, exist_ok=True)
    study.shared(chosen, out / name)
    for found in runs.side_by_side(missing, jobs, float("inf"), (out,), one_repeat):
        if isinstance(found, Exception):
            raise found
        path = path_of(out, (name, found["case"], found["seed"]))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found | tables.made(), default=float) + "\n")
        bar.update()
    bar.close()
    return [json.loads(path_of(out, key).read_text()) for key in wanted]


def one_repeat(key: tuple[str, str, int], out: Path) -> dict[str, Any]:
    name, case, seed = key
    began, used = time.perf_counter(), time.process_time()
    found = STUDIES[name].repeat(case, seed, out / name)
    spent = {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - used}
    return {"case": case, "seed": seed, **found, **{key: round(value, 1) for key, value in spent.items()}}


def path_of(out: Path, key: tuple[str, str, int]) -> Path:
    name, case, seed = key
    return out / name / case.replace(" ", "_") / f"{seed:04d}.json"
