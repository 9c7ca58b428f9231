"""Whole runs of `warpsar diagnose`, from scene file to verdict, where an object is missing, absent or elsewhere."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_rates

from warpsar.diagnosis.command import run
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.models.projection import pixel_of
from warpsar.effects.registry import get
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.surface.surface import KINDS
from warpsar.world.mesh import Mesh
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

STEEL = Material(eps_r=20.0, rms_height_m=0.0012, correlation_length_m=0.005)  # which the scene file does not have
POINT, POINT_BETA0 = (8.0, -6.5, 0.6), 6.0  # a reflector of one pixel
LOOKS = 16
HUT = (7.0, 5.5, 0.0)  # middle of its foot


@dataclass(frozen=True)
class Whole:
    """What the images hold and the scene file lacks. `point`: whether a reflector stands at `POINT`."""

    names: frozenset[str]
    missing: tuple[Mapping[str, Any], ...] = ()
    point: bool = False
    hut: str = ""
    effects: Mapping[str, Any] = field(default_factory=dict)


def _body(primitive: str, size: tuple[float, float, float], at: tuple[float, float], **more: Any) -> dict[str, Any]:
    return {"primitive": primitive, "size_m": size, "position_m": (*at, 0.0), "material": "steel", **more}


MISSING = frozenset({"missing_object"})
WHOLE = {
    "a box": Whole(MISSING, (_body("box", (4.0, 2.5, 2.5), (8.0, -6.5), heading_deg=35.0),)),
    "two boxes": Whole(
        MISSING,
        (
            _body("box", (4.0, 2.5, 2.5), (8.0, -6.5), heading_deg=35.0),
            _body("box", (3.5, 3.0, 3.0), (-9.5, 9.5), heading_deg=10.0, material="wall"),
        ),
    ),
    "a cylinder": Whole(MISSING, (_body("cylinder", (3.0, 3.0, 2.5), (8.0, -6.5)),)),
    "a car": Whole(MISSING, (_body("car", (4.6, 1.8, 1.5), (8.0, -6.5), heading_deg=35.0),)),
    "a point reflector": Whole(MISSING, point=True),
    "an absent hut": Whole(frozenset({"absent_object"}), hut="absent_object"),
    "a hut elsewhere and a floor": Whole(
        frozenset({"object_pose", "noise_floor"}),
        hut="object_pose",
        effects={"noise_floor": get("noise_floor").rate_case},
    ),
}


def true_scene(case: Whole) -> Scene:
    scene = diagnosis_rates.truth(geometry=case.hut)
    if case.missing:
        objects = [Object(name=f"it{k}", **table) for k, table in enumerate(case.missing)]
        scene = with_objects(scene, objects, {"steel": STEEL})
    return replace(scene, effects={name: dict(table) for name, table in case.effects.items()})


def whole_run(name: str, seed: int, folder: Path) -> dict[str, Any]:
    """A scene file in a folder of its own, diagnosed as the command does it."""
    case = WHOLE[name]
    kept = folder / name.replace(" ", "_") / f"{seed:04d}"
    with tempfile.TemporaryDirectory() as made:
        path = scene_file(case, seed, Path(made))
        try:
            content = run(path, kept, device="cpu", options=DiagnoseOptions(seed=seed))
        except Exception as error:  # a run that fails is counted, and does not end the others
            return {"verdict": [], "unexplained": True, "error": repr(error), "objects": {}, "numbers": []}
    shutil.rmtree(kept / "cache", ignore_errors=True)
    found = {name: {**one, "surface": content["materials"].get(name, {})} for name, one in content["objects"].items()}
    return {
        "verdict": content["verdict"],
        "unexplained": content["unexplained"],
        "taken_back": content["taken_back"],
        "objects": found,
        "before": content["before"]["test"]["deviance"],
        "after": content["after"]["test"]["deviance"],
        "numbers": errors(case, list(found.values())),
    }


def scene_file(case: Whole, seed: int, folder: Path) -> Path:
    """The scene file, its OBJ and its images: with speckle of `seed`, and a start beside the true surfaces."""
    truth, declared = true_scene(case), diagnosis_rates.truth()
    images = [one.beta0["HH"].astype(float) for one in simulate(truth, device="cpu")]
    if case.point:
        for view, image in zip(truth.views, images, strict=True):
            row, col = (int(at[0]) for at in pixel_of(declared, view, np.array([POINT])))
            image[row, col] += POINT_BETA0
    scene = diagnosis_rates.measured(images, LOOKS, False, seed, folder)
    write_obj(folder / "scene.obj", scene.mesh)
    replace(scene, mesh_path=folder / "scene.obj").save(folder / "scene.toml")
    return folder / "scene.toml"


def write_obj(path: Path, mesh: Mesh) -> None:
    """An OBJ with the mesh's materials, and with its groups as objects."""
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in mesh.vertices]
    of = {int(face): name for name, faces in mesh.groups.items() for face in faces}
    said = ("", "")
    for number, (corners, material) in enumerate(zip(mesh.faces, mesh.face_material, strict=True)):
        now = of.get(number, "site"), mesh.materials[material]
        lines += [f"o {now[0]}"] * (now[0] != said[0]) + [f"usemtl {now[1]}"] * (now != said)
        lines.append("f {} {} {}".format(*(corners + 1)))
        said = now
    path.write_text("\n".join(lines) + "\n")


def errors(case: Whole, found: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Of every body in the images, the nearest one that was found: how far it is off [m], its sizes over the true ones,
    and how many of its 95 % intervals hold."""
    if case.hut == "absent_object":
        return []
    if case.hut:
        place = diagnosis_rates.ELSEWHERE
        true = [{"position_m": place["position_m"], "heading_deg": place["heading_deg"]}]
    else:
        true = [{"position_m": POINT}] if case.point else [dict(one) for one in case.missing]
    numbers = []
    for one in true:
        near = min(found, key=lambda each: _apart(each, one), default=None)
        if near is None or _apart(near, one) > 2.0:
            numbers.append({"found": False})
            continue
        told: dict[str, Any] = {"found": True, "off_m": _apart(near, one)}
        pairs = list(zip(near["position_m"], near.get("position_sd_m", ()), one["position_m"], strict=False))[:2]
        if "size_m" in one:
            told["size"] = np.divide(_sorted(near["size_m"]), _sorted(one["size_m"])).tolist()
            sizes = zip(near["size_m"], near.get("size_sd_m", ()), one["size_m"], strict=False)
            pairs += list(sizes)
            told["primitive"] = near.get("primitive")
        if one.get("material") == "steel":
            told["surface_held"] = surface_held(near["surface"])
        told["held"] = [bool(abs(value - truth) < 1.96 * sd) for value, sd, truth in pairs]
        numbers.append(told)
    return numbers


def surface_held(surface: Mapping[str, Mapping[str, float]]) -> list[bool]:
    """Whether the 95 % intervals of an own material hold those of steel, in their learned coordinates."""
    true = STEEL.model_dump()
    found = []
    for kind in KINDS:
        if one := surface.get(kind.key):
            off = float(kind.to_coordinate(one["after"]) - kind.to_coordinate(true[kind.key]))
            found.append(abs(off) < 1.96 * one["after_sd_log"])
    return found


def _sorted(size: Sequence[float]) -> list[float]:
    return [*sorted(size[:2]), size[2]]


def _apart(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Distance in plan [m]."""
    return float(np.hypot(*np.subtract(one["position_m"][:2], other["position_m"][:2])))


def whole_rows(found: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """A row for each case."""
    rows = []
    for name, case in WHOLE.items():
        mine = [one for one in found if one["case"] == name]
        if not mine:
            continue
        right = [one for one in mine if right_one(case, one)]
        ended = [one for one in mine if "error" not in one]
        others = Counter(each for one in ended for each in {*one["verdict"], *(["unexplained"] * one["unexplained"])})
        others["failed"] = len(mine) - len(ended)
        bodies = [body for one in right for body in one["numbers"]]
        off = [body["off_m"] for body in bodies if body["found"]]
        size = [abs(ratio - 1.0) for body in bodies for ratio in body.get("size", ())]
        held = [hold for body in bodies for hold in body.get("held", ())]
        made = [hold for body in bodies for hold in body.get("surface_held", ())]
        rows.append(
            [
                name,
                f"{len(right)} of {len(mine)}",
                f"{max(off):.2f}" if off else "",
                f"{100.0 * max(size):.0f} %" if size else "",
                f"{sum(held)} of {len(held)}" if held else "",
                f"{sum(made)} of {len(made)}" if made else "",
                f"{np.mean([one['before'] for one in ended]):.2f}",
                f"{np.mean([one['after'] for one in ended]):.3f}",
                f"{np.median([one['cpu_seconds'] for one in mine]):.0f}",
                ", ".join(f"{each} {n}" for each, n in sorted(others.items()) if n and each not in case.names),
            ]
        )
    return rows


def right_one(case: Whole, one: Mapping[str, Any]) -> bool:
    """Whether the verdict is exactly the truth, and every body was found once, within 1 m."""
    bodies = one["numbers"]
    return (
        set(one["verdict"]) == case.names
        and not one["unexplained"]
        and all(body["found"] and body["off_m"] < 1.0 for body in bodies)
        and len(one["objects"]) == max(len(bodies), 1)
    )
