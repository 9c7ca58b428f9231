"""The model of the BTR-70: what is declared, which effects are tried, its fits and its predictions (btr70.py)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from btr70_measures import Chip, aimed, best_shift

from warpsar.diagnosis.models.refit import standing_at
from warpsar.effects.registry import validate
from warpsar.learning.optimise import levenberg_marquardt
from warpsar.learning.problem import FitProblem
from warpsar.learning.results import learned_scene
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.rays import trace_view
from warpsar.surface.stage import Stage
from warpsar.world.mesh import read_mesh
from warpsar.world.tables import View

SPACING_M = (0.202148, 0.203125)
HEADER_M = {"range_fwhm_m": 0.3013, "azimuth_fwhm_m": 0.3229}
PREDICTED = 104  # pixels of a prediction: 80, 9 of shift and a margin for the blur
FITTED_PX = 64
ITERATIONS = 10
# Of a pixel's loss in a fit. A few glints, where a strong scatterer stands in for speckle, else outvote the rest: the
# body's mean would follow them, and most of its pixels would be too bright.
BOUND = 0.5

DECLARED = """\
# What is known of the chips: widths and taper from the header, the vehicle's CAD, one gain for each image.

[scene]
reference_point_m = [0.0, 0.0, 0.0]

[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]

[image]
shape = [{size}, {size}]
spacing_m = [{spacing[0]}, {spacing[1]}]
calibrated = false

[sampling]
rays_per_pixel = 16.0

# With a free gain the grass, seen at one incidence alone, is the unit of everything: nothing of it can be learned.
[materials.ground]
eps_r = 6.0
rms_height_m = 0.004
correlation_length_m = 0.004
learn = []

[materials.body]
eps_r = 40.0
rms_height_m = 0.003
correlation_length_m = 0.006
learn = ["rms_height_m", "correlation_length_m"]

[effects.point_spread]
range_fwhm_m = 0.3013
azimuth_fwhm_m = 0.3229
window = "taylor"
fixed = true

[[objects]]
name = "ground"
primitive = "plate"
size_m = [60.0, 60.0, 0.0]
material = "ground"

[[objects]]
name = "btr70"
mesh = "{mesh}"
units = "in"
up = "+Y"
front = "-X"  # where turret and trim vane are; the engine's grille is at +X
material = "body"
roll_deg = -1.18
pitch_deg = -1.42
"""

GLOSSY = {"rms_height_m": 0.002, "correlation_length_m": 0.022}
"""A body that returns power about its normals alone: where the fit with `unresolved_detail` begins. The rough one that
stands in for detail without it is another valley."""

PARTS, FLASH = "parts", "flash"
LADDER: tuple[tuple[str, dict[str, Any]], ...] = (
    ("noise_floor", {"level": 1e-4}),
    ("unresolved_detail", {"level": 0.1, "spread_m": 0.9, "materials": ["body"]}),
    (FLASH, {"flash": 5.0, "flash_deg": 3.0}),
    ("exponential_spectrum", {"weight": 0.3}),
    ("two_scale", {"slope_variance": 0.05}),
    ("edge_diffraction", {"strength": 0.1}),
    ("multibounce", {"strength": 0.02, "max_bounces": 2, "reflection": "lobe"}),
    (PARTS, {}),
)
"""Effects in the order in which they are tried, with the tables where their fits begin. `FLASH` and `PARTS` are of
`unresolved_detail`: it flashes along the axes of the body, and every part of the body has a share of its own."""


def write_scene(path: Path, mesh: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(DECLARED.format(size=FITTED_PX, spacing=SPACING_M, mesh=mesh.resolve()), encoding="utf-8")
    return path


def begun_with(scene: Scene, name: str, table: Mapping[str, Any], mesh: Path) -> Scene:
    """The scene at which the fit with one effect more begins; `mesh` is the vehicle's in parts."""
    if name == PARTS:
        return in_parts(scene, mesh)
    if name == FLASH:
        return with_effect(scene, "unresolved_detail", {**scene.effects["unresolved_detail"], **table})
    found = with_effect(scene, name, table)
    if name != "unresolved_detail":
        return found
    body = found.materials["body"].model_copy(update=GLOSSY)
    return replace(found, materials={**found.materials, "body": body})


def in_parts(scene: Scene, mesh: Path) -> Scene:
    """The scene with a share of `unresolved_detail` for every part of the body; its level and the gloss are held."""
    body = scene.materials["body"].model_copy(update={"learn": []})
    found = read_mesh(mesh).materials
    objects = [
        one.model_copy(update={"mesh": mesh.resolve(), "material": None}) if one.name == "btr70" else one
        for one in scene.objects
    ]
    cut = with_objects(scene, objects, dict.fromkeys(found, body))
    now = scene.effects["unresolved_detail"]
    free = [key for key in ("spread_m", "flash", "flash_deg") if key in now]
    table = {"materials": list(found), "share": dict.fromkeys(found, 1.0), "learn": [*free, "share"]}
    return with_effect(cut, "unresolved_detail", {**now, **table})


def with_effect(scene: Scene, name: str, table: Mapping[str, Any]) -> Scene:
    return replace(scene, effects={**scene.effects, name: validate(name, dict(table), f"effects.{name}")})


def thinned(scene: Scene, views: int = 15) -> Scene:
    """Every second train view: a profile needs fewer."""
    return only(scene, [scene.views[int(k)].name for k in np.linspace(0, len(scene.views) - 1, views)])


def only(scene: Scene, names: Collection[str]) -> Scene:
    """The scene with these of its views."""
    chosen = [view for view in scene.views if view.name in names]
    table = scene.effects["aim_point"]
    aim = {key: {n: v for n, v in one.items() if n in names} for key, one in table.items() if isinstance(one, dict)}
    return with_effect(replace(scene, views=chosen), "aim_point", aim)


def with_tables(scene: Scene, changed: Mapping[str, Mapping[str, Any]]) -> Scene:
    """The scene with other values in the tables of its objects, by name."""
    return with_objects(scene, [one.model_copy(update=changed.get(one.label, {})) for one in scene.objects])


def with_other_rays(scene: Scene) -> Scene:
    """The same model on rays of another seed."""
    return replace(scene, sampling=scene.sampling.model_copy(update={"seed": scene.sampling.seed + 1}))


def with_aim_points(scene: Scene, train: Sequence[Chip]) -> Scene:
    """With `aim_point`, free, where the declared model fits each train view best: it lies pixels away."""
    images = predicted(scene, train)
    shift = {chip.name: best_shift(chip.power, images[chip.name])[1] for chip in train}
    table = {
        key: {name: at[axis] * SPACING_M[axis] for name, at in shift.items()}
        for axis, key in enumerate(("range_m", "azimuth_m"))
    }
    return with_effect(scene, "aim_point", table)


def fitted(scene: Scene, iterations: int = ITERATIONS) -> tuple[Scene, float]:
    """The scene with everything that it frees at its best on the train views, and the bounded loss there."""
    problem = FitProblem(scene, devices.resolve_device("cpu"), bound=BOUND)
    state = standing_at(problem, problem.x0)
    for _ in range(iterations):
        state = levenberg_marquardt(problem, state, flat=0.5, kept_within=0.05)
        if state.arrived:
            break
    return learned_scene(problem, state.best_x), float(state.best_loss)


def seen_from(scene: Scene, chips: Sequence[Chip]) -> Scene:
    """The scene at the chips' angles, on a grid with room for shifts, without aim points of its own."""
    views = [
        View(name=chip.name, azimuth_deg=chip.azimuth_deg, depression_deg=chip.depression_deg, images={})
        for chip in chips
    ]
    effects = {name: table for name, table in scene.effects.items() if name != "aim_point"}
    grid = scene.grid.model_copy(update={"shape": (PREDICTED, PREDICTED)})
    return replace(scene, views=views, effects=effects, grid=grid)


def padded(image: np.ndarray, rows: int) -> np.ndarray:
    """With its border continued to `rows` pixels a side: level ground goes on."""
    before = (rows - image.shape[0]) // 2
    return np.pad(image, before, mode="edge")


def predicted(scene: Scene, chips: Sequence[Chip]) -> dict[str, np.ndarray]:
    """beta0 of the scene at each chip's angles, on the chip's pixels."""
    images = simulate(seen_from(scene, chips), device="cpu")
    return {
        chip.name: padded(image.beta0["HH"].astype(float), chip.power.shape[0])
        for chip, image in zip(chips, images, strict=True)
    }


def regions(scene: Scene, chips: Sequence[Chip]) -> dict[str, dict[str, np.ndarray]]:
    """Masks of the body, its shadow and the ground in each prediction: what rays meet in a pixel. None in a scene
    that has no material `ground`."""
    if "ground" not in scene.mesh.materials:
        return {chip.name: {} for chip in chips}
    seen = replace(seen_from(scene, chips), effects={})
    stage = Stage.of(seen, devices.resolve_device("cpu"))
    ground = seen.mesh.materials.index("ground")
    found = {}
    for chip, view in zip(chips, seen.views, strict=True):
        hits = trace_view(seen, stage, view, seed=1, effects=[])
        pixel, of_body = hits.pixel.numpy(), seen.mesh.face_material[hits.face.numpy()] != ground
        lit = [np.bincount(pixel[mask], minlength=PREDICTED**2) > 0 for mask in (of_body, ~of_body)]
        on_body, on_ground = (one.reshape(PREDICTED, PREDICTED) for one in lit)
        masks = {"body": on_body, "shadow": ~on_body & ~on_ground, "ground": on_ground & ~on_body}
        before = (chip.power.shape[0] - PREDICTED) // 2
        found[chip.name] = {
            name: np.pad(mask, before, constant_values=name == "ground") for name, mask in masks.items()
        }
    return found


def held_out(scene: Scene, chips: Sequence[Chip]) -> list[float]:
    """Mean gamma deviance of each held-out chip at the model's best aim point: lower is better."""
    images = predicted(scene, chips)
    return [aimed(chip.power, images[chip.name]) for chip in chips]
