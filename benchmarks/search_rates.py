"""How often the whole search of `warpsar diagnose` ends with the right name, or says honestly that it has none.

    python benchmarks/search_rates.py run -o out/search --scenes 300
    python benchmarks/search_rates.py table -o out/search [--write]

Scenes are those of towns.py: ground with two to four buildings, three to six views, 1 to 16 looks, white or
correlated speckle, materials that start beside the truth. In a third of them nothing is wrong. In a third, one to three
things are that the search has a name for. In a third, something is wrong that no hypothesis describes; it is made here,
by code that the library does not share. What is wrong must be seen: without it, images without speckle differ by 2 ln L
of 100 or more. A run appends one line of JSON to runs.jsonl in the folder; runs that are there already are not made
again. docs/diagnosis-rates.md has the results.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import runs
import tables
from runs import bounds
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates
from towns import (
    KEYS,
    SEEN,
    SHARING,
    START_SD,
    DrawnTown,
    as_it_is,
    base,
    laws,
    moved,
    patch_of_ground,
    seen,
    sign,
    smear,
    turned,
    with_images,
    without,
)

from warpsar.diagnosis.command import in_short
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.geometry.registry import changes, is_geometry
from warpsar.diagnosis.geometry.view_angles import ALL
from warpsar.diagnosis.result import Diagnosed, diagnose
from warpsar.diagnosis.surface_moves import moved_parameters
from warpsar.effects.registry import get
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Material, Sampling

MOST_MINUTES = 8.0  # of one search: what it has found by then stands

Change = Callable[[str, np.ndarray], np.ndarray]
Made = tuple[Scene, Scene, Mapping[str, Any], Change]
"""The scene of the images, the one of the file, the laws of speckle, and what is done to an image."""


# ---- what the search has a name for ----


def effect(name: str, table: Mapping[str, Any]) -> Callable[[DrawnTown, np.random.Generator], DrawnTown]:
    return lambda drawn, random: replace(
        drawn, true=replace(drawn.true, effects={**drawn.true.effects, name: dict(table)})
    )


def floor(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    return effect("noise_floor", {"level": float(random.uniform(0.002, 0.006))})(drawn, random)


def shift(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    return effect("registration", {k: sign(random, 0.2, 0.6) for k in ("range_m", "azimuth_m")})(drawn, random)


def gains(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    found = {view.name: sign(random, 0.8, 1.6) for view in drawn.true.views}
    return effect("view_gain", {"gain_db": found})(drawn, random)


def response(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    """An image blurred as power, as the library does to expected images."""
    found = {key: float(random.uniform(0.8, 1.4)) for key in ("range_fwhm_m", "azimuth_fwhm_m")}
    return effect("point_spread", {**found, "window": "gaussian"})(drawn, random)


def ambiguity(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    table = {"level": float(random.uniform(0.05, 0.1)), "offset_m": float(random.uniform(7.0, 12.0))}
    return effect("azimuth_ambiguity", table)(drawn, random)


def view_azimuth(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    return replace(drawn, true=turned(drawn.true, drawn.true.views[0].name, azimuth_deg=sign(random, 0.8, 2.0)))


def incidences(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    return replace(drawn, true=turned(drawn.true, "", incidence_deg=sign(random, 0.8, 2.0)))


def spacing(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    step, factor, axis = drawn.true.grid.spacing_m, 1.0 + sign(random, 0.02, 0.04), int(random.integers(2))
    other = (step[0] * factor, step[1]) if axis == 0 else (step[0], step[1] * factor)
    return replace(drawn, true=replace(drawn.true, grid=drawn.true.grid.model_copy(update={"spacing_m": other})))


def height(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    factor = 1.0 + sign(random, 0.15, 0.35)
    return replace(drawn, true=moved(drawn.true, lambda v: v * [1.0, 1.0, factor]))


def place(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    way = random.uniform(0.0, 2.0 * math.pi)
    step = random.uniform(0.5, 1.2) * np.array([math.cos(way), math.sin(way), 0.0])
    return replace(drawn, true=moved(drawn.true, lambda v: v + step))


def more(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    """A box that the scene file does not have, from a car's size to a shed's, on free ground."""
    size = random.uniform([2.0, 3.5, 1.5], [3.0, 8.0, 3.0])
    return replace(drawn, true=with_box(drawn.true, size, free_place(drawn.true, random), random.uniform(0.0, math.pi)))


def less(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    return replace(drawn, true=without(drawn.true))


def wrong_looks(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    factor = float(random.choice([random.uniform(0.4, 0.7), random.uniform(1.5, 2.5)]))
    return replace(drawn, law=laws(drawn.declared, factor=factor))


def texture(drawn: DrawnTown, random: np.random.Generator) -> DrawnTown:
    looks = drawn.declared.views[0].looks
    assert looks is not None
    return replace(drawn, law=laws(drawn.declared, texture=float(random.uniform(1.5, min(8.0, 3.0 * (looks + 1.0))))))


KNOWN: dict[str, tuple[Callable[[DrawnTown, np.random.Generator], DrawnTown], frozenset[str], str]] = {
    "noise_floor": (floor, frozenset({"noise_floor"}), "radar"),
    "multibounce": (effect("multibounce", get("multibounce").rate_case), frozenset({"multibounce"}), "world"),
    "registration": (shift, frozenset({"registration", "aim_point"}), "place"),
    "view_gain": (gains, frozenset({"view_gain"}), "radar"),
    "point_spread": (response, frozenset({"point_spread"}), "radar"),
    "azimuth_ambiguity": (ambiguity, frozenset({"azimuth_ambiguity"}), "radar"),
    "azimuth of a view": (view_azimuth, frozenset({"view_angles v0"}), "angles"),
    "incidences": (incidences, frozenset({"view_angles all"}), "angles"),
    "spacing": (spacing, frozenset({"pixel_spacing range", "pixel_spacing azimuth"}), "place"),
    "height": (height, frozenset({"object_size house0"}), "house0"),
    "place": (place, frozenset({"object_pose house0"}), "house0"),
    "a box more": (more, frozenset({"missing_object"}), "world"),
    "a house less": (less, frozenset({"absent_object house0"}), "house0"),
    "looks": (wrong_looks, frozenset({"looks"}), "law"),
    "texture": (texture, frozenset({"texture"}), "law"),
}
"""How it is made, the names that are right for it, and what it is of: two of one thing are not drawn together."""


# ---- what no hypothesis describes ----


def joined(mesh: Mesh, vertices: np.ndarray, faces: np.ndarray, material: str) -> Mesh:
    """The mesh and further faces, of no group."""
    index = np.full(len(faces), mesh.materials.index(material), np.int32)
    return replace(
        mesh,
        vertices=np.concatenate([mesh.vertices, vertices]),
        faces=np.concatenate([mesh.faces, faces + len(mesh.vertices)]).astype(np.int32),
        face_material=np.concatenate([mesh.face_material, index]),
    )


def block(size: np.ndarray, at: np.ndarray, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a box on the ground."""
    a, b, c = np.asarray(size) * [0.5, 0.5, 1.0]
    points = np.array([[x * a, y * b, z] for z in (0.0, c) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    cosine, sine = math.cos(turn), math.sin(turn)
    points[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]]) + at
    sides = [face for k in range(4) for face in ([k, (k + 1) % 4, 4 + (k + 1) % 4], [k, 4 + (k + 1) % 4, 4 + k])]
    return points, np.array([*sides, [4, 5, 6], [4, 6, 7]])


def with_box(scene: Scene, size: np.ndarray, at: np.ndarray, turn: float) -> Scene:
    return replace(scene, mesh=joined(scene.mesh, *block(size, at, turn), "wall"))


def free_place(scene: Scene, random: np.random.Generator) -> np.ndarray:
    """A place on the ground, 5 m or more from every corner of a house and within the images."""
    mesh = scene.mesh
    corners = mesh.vertices[np.unique(mesh.faces[mesh.face_material != mesh.materials.index("ground")])]
    while True:
        at = random.uniform(-16.0, 16.0, 2)
        if min(np.hypot(*(corners[:, :2] - at).T)) > 5.0:
            return at


def first_house(scene: Scene) -> tuple[np.ndarray, float, float]:
    """Foot of its first corner, the way along its first wall, and its height without a gable."""
    points = scene.mesh.vertices[np.unique(scene.mesh.faces[scene.mesh.groups["house0"]])]
    heights = np.unique(points[:, 2])
    along = points[1, :2] - points[0, :2]
    return points[0], math.atan2(along[1], along[0]), float(heights[heights > 0.0][0])


def roof(random: np.random.Generator, scene: Scene) -> Made:
    """The house has a gable; the file has a flat roof."""
    _, _, flat = first_house(scene)
    declared = moved(scene, lambda v: np.column_stack([v[:, :2], np.minimum(v[:, 2], flat)]))
    return scene, declared, laws(scene), as_it_is


def annex(random: np.random.Generator, scene: Scene) -> Made:
    """A lower block against a wall of the house."""
    corner, turn, top = first_house(scene)
    size = np.array([random.uniform(3.0, 5.0), random.uniform(2.5, 4.0), random.uniform(0.5, 0.8) * top])
    way = np.array([math.cos(turn), math.sin(turn)])
    at = corner[:2] + way * size[0] / 2 + np.array([way[1], -way[0]]) * size[1] / 2
    return with_box(scene, size, at, turn), scene, laws(scene), as_it_is


def fence(random: np.random.Generator, scene: Scene) -> Made:
    """A wall of two metres along a line of three pieces, each in its own direction."""
    true, at = scene, free_place(scene, random)
    turn = random.uniform(0.0, 2.0 * math.pi)
    for bend in (0.0, 0.7, -0.6):
        way = np.array([math.cos(turn + bend), math.sin(turn + bend)])
        true = with_box(true, np.array([5.0, 0.2, 2.0]), at + 2.5 * way, turn + bend)
        at = at + 5.0 * way
    return true, scene, laws(scene), as_it_is


def slope(random: np.random.Generator, scene: Scene) -> Made:
    """The ground rises to one side, with all that stands on it; the file has it level."""
    rise, way = sign(random, 0.03, 0.06), random.uniform(0.0, 2.0 * math.pi)
    tilt = rise * (scene.mesh.vertices[:, :2] @ [math.cos(way), math.sin(way)])
    mesh = replace(scene.mesh, vertices=scene.mesh.vertices + np.column_stack([0 * tilt, 0 * tilt, tilt]))
    return replace(scene, mesh=mesh), scene, laws(scene), as_it_is


def ripple(random: np.random.Generator, scene: Scene) -> Made:
    rows, period, depth = scene.grid.shape[0], random.uniform(8.0, 30.0), random.uniform(0.5, 1.5)
    gain = 10.0 ** (depth * np.sin(2.0 * math.pi * np.arange(rows) / period) / 10.0)
    return scene, scene, laws(scene), lambda name, image: image * gain[:, None]


def patch(random: np.random.Generator, scene: Scene) -> Made:
    """A round patch of ground, brighter or darker."""
    level = float(random.choice([random.uniform(1.0, 3.0), random.uniform(-0.8, -0.5)]))
    at, width = random.uniform(-12.0, 12.0, 2), random.uniform(2.0, 4.0)
    return scene, scene, laws(scene), patch_of_ground(scene, at, width, level)


def line(random: np.random.Generator, scene: Scene) -> Made:
    row = int(random.integers(30, scene.grid.shape[0] - 30))
    return scene, scene, laws(scene), smear(scene.views[0].name, row, random.uniform(1.0, 3.0))


def dead_lines(random: np.random.Generator, scene: Scene) -> Made:
    """Every so many lines of azimuth are received at a third of their power."""
    step, first = int(random.integers(7, 15)), int(random.integers(7))
    gain = np.ones(scene.grid.shape[1])
    gain[first::step] = random.uniform(0.2, 0.5)
    return scene, scene, laws(scene), lambda name, image: image * gain


def seam(random: np.random.Generator, scene: Scene) -> Made:
    """Two halves of an image that were calibrated apart."""
    column, level = int(scene.grid.shape[1] * random.uniform(0.3, 0.7)), 10.0 ** (sign(random, 0.8, 2.0) / 10.0)
    gain = np.where(np.arange(scene.grid.shape[1]) < column, 1.0, level)
    return scene, scene, laws(scene), lambda name, image: image * gain


def warped(random: np.random.Generator, scene: Scene) -> Made:
    """Columns move along range by a wave: an orbit that was not smooth."""
    columns, size = scene.grid.shape[1], random.uniform(1.0, 2.0)
    wave = size * np.sin(2.0 * math.pi * np.arange(columns) / random.uniform(30.0, 60.0))

    def change(name: str, image: np.ndarray) -> np.ndarray:
        rows, cols = np.indices(image.shape)
        return np.maximum(map_coordinates(image, [rows - wave[None, :], cols], order=1, mode="nearest"), 0.0)

    return scene, scene, laws(scene), change


def defocus(random: np.random.Generator, scene: Scene) -> Made:
    """An azimuth response that widens with range."""
    widest = random.uniform(2.0, 4.0)

    def change(name: str, image: np.ndarray) -> np.ndarray:
        found = np.stack([gaussian_filter1d(image, s, axis=1) for s in np.linspace(0.01, widest, 6)])
        at = np.linspace(0.0, 5.0, image.shape[0])
        below = np.minimum(at.astype(int), 4)
        rows = np.arange(image.shape[0])
        share = (at - below)[:, None]
        return np.asarray((1.0 - share) * found[below, rows] + share * found[below + 1, rows])

    return scene, scene, laws(scene), change


def clumps(random: np.random.Generator, scene: Scene) -> Made:
    """Power that is brighter and darker in clumps of the image, other ones in every view."""
    width, depth, seed = random.uniform(2.0, 4.0), random.uniform(0.3, 0.6), int(random.integers(2**31))

    def change(name: str, image: np.ndarray) -> np.ndarray:
        drawn = np.random.default_rng([seed, sum(map(ord, name))])
        field = gaussian_filter(drawn.standard_normal(image.shape), width)
        return np.asarray(image * np.exp(depth * field / field.std() - depth**2 / 2.0))

    return scene, scene, laws(scene), change


def movers(random: np.random.Generator, scene: Scene) -> Made:
    """A few bright points at places of their own in every view: what moves between the passes."""
    count, level, seed = int(random.integers(3, 8)), random.uniform(15.0, 40.0), int(random.integers(2**31))

    def change(name: str, image: np.ndarray) -> np.ndarray:
        drawn = np.random.default_rng([seed, sum(map(ord, name))])
        points = np.zeros(image.shape)
        rows, cols = (drawn.integers(15, n - 15, count) for n in image.shape)
        points[rows, cols] = 2.0 * math.pi * level * np.median(image[image > 0])
        return np.asarray(image + gaussian_filter(points, 1.0))

    return scene, scene, laws(scene), change


OUTSIDE: dict[str, Callable[[np.random.Generator, Scene], Made]] = {
    "roof": roof,
    "annex": annex,
    "fence": fence,
    "slope": slope,
    "ripple of the gain": ripple,
    "patch of ground": patch,
    "a smear": line,
    "dead lines": dead_lines,
    "a seam": seam,
    "warped columns": warped,
    "defocus by range": defocus,
    "clumps": clumps,
    "points that move": movers,
}
ALSO_RIGHT = {"annex": {"missing_object"}, "fence": {"missing_object"}, "points that move": set[str]()}
"""Names that describe it, too."""


def group_of(number: int) -> str:
    return ("nothing", "known", "outside")[number % 3]


def kinds_of(number: int, random: np.random.Generator) -> list[str]:
    """What is wrong in a scene. Known things come alone in half of their scenes."""
    turn = number // 3
    if group_of(number) == "outside":
        return [list(OUTSIDE)[turn % len(OUTSIDE)]]
    if group_of(number) == "nothing":
        return []
    first = list(KNOWN)[turn % len(KNOWN)]
    count = int(random.choice([1, 1, 2, 3]))
    found = [first]
    for other in random.permutation(list(KNOWN)):
        if len(found) < count and KNOWN[other][2] not in {KNOWN[one][2] for one in found}:
            found.append(str(other))
    return found


def drawn_scene(number: int, kinds: list[str], random: np.random.Generator) -> DrawnTown:
    scene = base(random, gabled=1 if kinds == ["roof"] else int(random.integers(0, 2)))
    if group_of(number) == "outside":
        return DrawnTown(*OUTSIDE[kinds[0]](random, scene))
    found = DrawnTown(scene, scene, laws(scene), as_it_is)
    for kind in kinds:
        found = KNOWN[kind][0](found, random)
    return found


def clean_images(found: DrawnTown, device: str) -> dict[str, np.ndarray]:
    made = zip(found.true.views, simulate(found.true, device=device), strict=True)
    return {view.name: found.change(view.name, one.beta0["HH"].astype(float)) for view, one in made}


def visible(
    number: int, kinds: list[str], random: np.random.Generator, device: str
) -> tuple[DrawnTown, dict[str, np.ndarray], float, bool]:
    """A scene in which what is wrong can be seen: with its images without speckle, 2 ln L of what there is to be found,
    and whether its speckle is correlated."""
    correlated = bool(random.random() < 0.3)
    while True:
        found = drawn_scene(number, kinds, random)
        if correlated:  # the sum of so many fields
            whole = {v: replace(law, looks=float(max(round(law.looks), 1))) for v, law in found.law.items()}
            found = replace(found, law=whole)
        clean = clean_images(found, device)
        there = seen(found, clean, SHARING if correlated else 1.0, device)
        if there > SEEN * max(len(kinds), 1) or not kinds:
            return found, clean, there, correlated


def one_run(number: int, device: str, minutes: float) -> dict[str, Any]:
    first = time.perf_counter()
    random = np.random.default_rng([20261124, number])
    kinds = kinds_of(number, random)
    found, clean, there, correlated = visible(number, kinds, random, device)
    views = with_images(random, found, clean, correlated)
    materials = started(found.declared, random)
    scene = replace(found.declared, views=views, materials=materials, sampling=Sampling(seed=number))
    begun = time.perf_counter()
    done = diagnose(scene, device=device, options=DiagnoseOptions(time_limit_s=60.0 * minutes))
    ended = time.perf_counter()
    return {
        "number": number,
        "kinds": kinds,
        "looks": scene.views[0].looks,
        "views": len(views),
        "correlated": correlated,
        "there": round(there, 1),
        "verdict": [
            *(name for name in done.verdict if not is_geometry(name)),
            *(name for name in changes(scene, done.diagnosis.final.scene) if name not in done.not_established),
        ],
        "not_established": done.not_established,
        "alternatives": [[one.effect, one.other] for one, _ in done.alternatives],
        "rivals": [*done.speckle.rivals],
        "unexplained": done.unexplained,
        "reasons": done.reasons,
        "findings": {role: one.findings for role, one in done.verdicts.items()},
        "withdrawn": [*done.diagnosis.withdrawn],
        "turns": [turn.added for turn in done.diagnosis.turns],
        "line": in_short(done),
        "not_asked": done.diagnosis.not_asked,
        "intervals": intervals(done, found.true),
        "objects": json.loads(json.dumps(done.diagnosis.objects, default=str)),
        "seconds": round(ended - begun, 1),
        "of_it_made": round(begun - first, 1),
    }


def started(scene: Scene, random: np.random.Generator) -> dict[str, Material]:
    """The scene's materials beside the truth."""
    materials = {}
    for key, one in scene.materials.items():
        values = [one.eps_r - 1.0, one.rms_height_m, one.correlation_length_m]
        start = np.array(values) * np.exp(START_SD * random.standard_normal(3)) + [1.0, 0.0, 0.0]
        materials[key] = one.model_copy(update=dict(zip(KEYS, map(float, start), strict=True)))
    return materials


def intervals(done: Diagnosed, true: Scene) -> list[tuple[str, float | None, float | None]]:
    """Of each number of the final model that the scene of the images has too: its name, and both ends of its stated
    95 % interval less the truth, None where an end is open.

    In the coordinates of the fit: ln of a level, degrees of an angle. Only differences between gains act. So they are
    about those train views that have none in the model, or else about their mean.
    """
    final, rows = done.diagnosis.final, list[tuple[str, float, float]]()
    known, truth = final.scene.parameters, true.parameters
    told = moved_parameters(done.diagnosis)[1]
    gains = {known.old_names.get(o, o): float(x) for o, x in zip(told.labels, final.x, strict=True) if "gain_db[" in o}
    train = [f"effects.view_gain.gain_db[{view.name}]" for view in final.scene.views if view.role == "train"]
    others = [name for name in train if name not in gains]
    for k, (label, x) in enumerate(zip(told.labels, final.x, strict=True)):
        name = known.old_names.get(label, label)
        if name in truth and name in known:
            value, level = truth[name].value, 0.0
            if name in gains:
                value = value - np.mean([truth[one].value for one in others or gains])
                level = 0.0 if others else float(np.mean(list(gains.values())))
            low, high = told.interval_95(k, float(x)) - level - float(known[name].transform.to_coordinate(value))
            rows.append((name, float(low), float(high)))
    declared = done.diagnosis.scene
    for owner, numbers in done.diagnosis.sensor.items():
        for key, one in numbers.items():
            name = f"image.{key}" if key.endswith("spacing_m") else f"views.{owner}.{key}"
            is_turn = owner == ALL and name not in truth
            value = getattr(true.views[0], key) - getattr(declared.views[0], key) if is_turn else truth[name].value
            rows.append((name, *_ends(float(one["found"] - value), one["sd"])))
    for owner, one in done.diagnosis.objects.items():
        if owner in declared.mesh.groups and owner in true.mesh.groups:
            was, now = (each.vertices[np.unique(each.faces[each.groups[owner]])] for each in (declared.mesh, true.mesh))
            scale, step = np.ptp(now, axis=0) / np.ptp(was, axis=0), now.mean(axis=0) - was.mean(axis=0)
            for key, value in (("scale", scale), ("position_m", step)):
                sds = one.get("scale_sd" if key == "scale" else "position_sd_m")
                for axis in range(3) if sds is not None and (key == "scale" or scale.max() == scale.min()) else ():
                    ends = _ends(float(one[key][axis] - value[axis]), sds[axis])
                    rows.append((f"objects.{owner}.{key}[{axis}]", *ends))
    return [(name, *(end if np.isfinite(end) else None for end in ends)) for name, *ends in rows]


def _ends(off: float, sd: float | None) -> tuple[float, float]:
    reach = 1.96 * sd if sd else np.inf
    return off - reach, off + reach


def right_names(row: Mapping[str, Any]) -> set[str]:
    """All names that are true of a run."""
    if group_of(row["number"]) == "outside":
        return set(ALSO_RIGHT.get(row["kinds"][0], set()))
    return {name for kind in row["kinds"] for name in KNOWN[kind][1]}


def is_of(name: str, names: set[str]) -> bool:
    return name in names or name.partition(" ")[0] in names


def outcome(row: Mapping[str, Any]) -> str:
    """One word for a run.

    all-clear: nothing named and nothing left. right: true names, one or more for each thing that is wrong, and nothing
    left. in part: true names and something left. unexplained: no name and something left. incomplete: true names, not
    all, and nothing left. false name: a name that is not true and is not given as one of two readings.
    """
    names = right_names(row)
    readings = dict(row["alternatives"]) | {other: one for one, other in row["alternatives"]}
    readings |= {one: other for one in SPECKLE.intersection(row["verdict"]) for other in row["rivals"]}
    false = [one for one in row["verdict"] if not is_of(one, names) and not is_of(readings.get(one, ""), names)]
    if false:
        return "false name"
    if not row["verdict"]:
        return "unexplained" if row["unexplained"] else "all-clear"
    if row["unexplained"]:
        return "in part"
    wanted = [KNOWN[kind][1] for kind in row["kinds"]] if group_of(row["number"]) == "known" else [names]
    told = {*row["verdict"], *(readings.get(one, "") for one in row["verdict"])}
    return "right" if all(any(is_of(one, set(each)) for one in told) for each in wanted) else "incomplete"


SPECKLE = {"looks", "texture"}  # whose `rivals` a row has apart
OUTCOMES = ("all-clear", "right", "in part", "incomplete", "unexplained", "false name")


@click.group()
def main() -> None:
    """Rates of right, false and missing names of `warpsar diagnose`."""


@main.command()
@runs.out
@runs.first
@runs.scenes(300)
@runs.jobs(2)
@runs.minutes(MOST_MINUTES)
@runs.max_time
@runs.device
def run(out: Path, first: int, scenes: int, jobs: int, minutes: float, max_time: float, device: str | None) -> None:
    """Make the runs that are not in the folder yet."""
    where = devices.resolve_device(device)
    runs.append(
        out, range(first, first + scenes), one_run,
        lambda row: f"{row['number']} {', '.join(row['kinds']) or 'nothing'}: {outcome(row)}: {row['line']}",
        where.alias, minutes, jobs=jobs, max_time=max_time,
    )  # fmt: skip


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """The rates of the runs that are there."""
    lines = []
    for group, kinds in (("nothing", ["nothing"]), ("known", [*KNOWN, "several"]), ("outside", [*OUTSIDE])):
        for kind in kinds:
            mine = [row for row in rows if group_of(row["number"]) == group and label(row) == kind]
            if mine:
                count = {one: sum(outcome(row) == one for row in mine) for one in OUTCOMES}
                middle = float(np.median([row["seconds"] for row in mine]))
                lines.append([group, kind, len(mine), *(count[one] or "" for one in OUTCOMES), f"{middle:.0f}"])
    by = {group: [row for row in rows if group_of(row["number"]) == group] for group in ("nothing", "known", "outside")}
    asked = [
        ("nothing missing: all-clear", by["nothing"], {"all-clear"}),
        ("something missing: false all-clear", by["known"] + by["outside"], {"all-clear"}),
        ("known: named right, nothing left", by["known"], {"right"}),
        ("known, of one thing: named right, nothing left", [r for r in by["known"] if len(r["kinds"]) == 1], {"right"}),
        ("outside: unexplained, or described rightly", by["outside"], {"unexplained", "right", "in part"}),
        ("all: a false name", rows, {"false name"}),
    ]
    sums = []
    for what, of, wanted in asked:
        if of:
            count = sum(outcome(row) in wanted for row in of)
            sums.append([what, f"{count} of {len(of)}", bounds(count, len(of))])
    # of models that are right: what another model's numbers would be the true ones of is another question
    stated = [one for row in rows if outcome(row) in ("right", "all-clear") for one in row.get("intervals", ())]
    roots_of = {"surfaces": ("materials",), "effects": ("effects",), "geometry": ("objects", "views", "image")}
    for what, roots in roots_of.items():
        mine = [ends for name, *ends in stated if name.partition(".")[0] in roots]
        if mine:
            told = [ends for ends in mine if ends != [None, None]]
            count = sum((low is None or low <= 0.0) and (high is None or high >= 0.0) for low, high in told)
            sums.append(
                [f"intervals of {what} that hold the truth", f"{count} of {len(told)}", bounds(count, len(told))]
            )
            sums.append([f"intervals of {what} that are withheld", f"{len(mine) - len(told)} of {len(mine)}", ""])
    head = ["", "wrong", "scenes", *OUTCOMES, "median [s]"]
    return {
        "search_rates": tables.markdown(head, lines),
        "search_rates_sums": tables.markdown(["", "scenes", "95 %"], sums),
    }


def label(row: Mapping[str, Any]) -> str:
    return "nothing" if not row["kinds"] else row["kinds"][0] if len(row["kinds"]) == 1 else "several"


if __name__ == "__main__":
    main()
