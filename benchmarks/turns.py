"""Tables, surfaces, poses and fields: fitted in turns, and all together as `learn` does.

    python benchmarks/turns.py [--draws N] [--only SCENE]

Made scenes with starts beside the truth. Three have a table of sigma0 (`facet`) beside a surface whose h is learned:
parts that share few pixels, the same under a blur, and both in every pixel. In the fourth a box stands beside its true
place on ground of the table, with a wrong height and a wrong h. In two the box stands on a field of h, and in the
last one, which Adam fits, the table lies beside a field. For each of a few draws of speckle: the objective (negative
log-likelihood and prior), the largest error of the table over the incidences seen, that of the box's place, the error
of ln h (root mean square over a field's nodes that are seen), steps of the optimiser, and CPU seconds. Turns: some
parts move while the others are held, and then these. Together: all move, from the same start, and from where the turns
ended.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ["WARPSAR_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
import warp as wp
from worlds import ground, mesh_of, plate, scene_of, view

from warpsar import Scene, simulate
from warpsar.effects.registry import validate
from warpsar.learning.adam import Adam
from warpsar.learning.device_values import DeviceValues
from warpsar.learning.optimise import FitState
from warpsar.learning.options import LearnOptions
from warpsar.learning.pose import PosedProblem, descend
from warpsar.learning.pose_pixels import compared
from warpsar.learning.pose_search import lit_pixels
from warpsar.learning.problem import FitProblem
from warpsar.learning.table import tables_to_learn
from warpsar.scene.placing import with_objects
from warpsar.world.objects.table import Object
from warpsar.world.sigma0_table import Sigma0Table
from warpsar.world.tables import Material

ANGLES = np.arange(20.0, 71.0, 5.0)
GIVEN = Sigma0Table(ANGLES, {"HH": -8.0 - 0.2 * (ANGLES - 20.0)})
TRUE_DB = GIVEN.sigma0_db["HH"] + 2.5 * np.cos(np.radians(2.0 * ANGLES - 60.0))
TRUE_H = 0.0015  # [m]
SOIL = {"eps_r": 6.0, "rms_height_m": TRUE_H, "correlation_length_m": 0.01, "learn": ("rms_height_m",)}
START = {"rms_height_m": 0.0008}
FIELD = {"rms_height_m": "h", "layout": "vertex"}
LOOKS = 8.0
BOX = {
    "primitive": "box",
    "size_m": (4.0, 3.0, 2.0),
    "position_m": (0.0, 0.0, 0.0),
    "heading_deg": 20.0,
    "material": "soil",
    "learn": ("position", "size"),
}
MOVED = {"position_m": (0.5, -0.4, 0.0), "size_m": (4.0, 3.0, 2.6)}
BLUR = {"range_fwhm_m": 1.2, "azimuth_fwhm_m": 1.2, "fixed": True}


def strips(width_m: float, side_m: float = 14.4, cells: int = 1) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Level ground of strips along y, which belong to the table and to the soil in turn."""
    starts = np.arange(-side_m / 2, side_m / 2 - 1e-9, width_m)
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"lawn": [], "soil": []}
    for number, start in enumerate(starts):
        parts["lawn" if number % 2 else "soil"].append(
            plate((start, -side_m / 2, 0.0), (width_m, 0, 0), (0, side_m, 0), cells)
        )
    joined = {}
    for name, plates in parts.items():
        first = np.cumsum([0, *(len(vertices) for vertices, _ in plates[:-1])])
        faces = [faces + offset for (_, faces), offset in zip(plates, first, strict=True)]
        joined[name] = np.concatenate([vertices for vertices, _ in plates]), np.concatenate(faces)
    return joined


def site(mesh: Any, materials: dict[str, Any]) -> Scene:
    """Five views of a mesh."""
    return scene_of(
        mesh,
        [view(70 * k, angle, name=f"v{k}") for k, angle in enumerate((28, 36, 44, 52, 60))],
        shape=(24, 24),
        spacing_m=(0.6, 0.6),
        polarizations=("HH",),
        rays_per_pixel=64.0,
        materials=materials,
    )


def seeing(scene: Scene, truth: Scene, seed: int) -> Scene:
    """The scene with images of the truth, times speckle."""
    random = np.random.default_rng(seed)
    images = {one.name: one.beta0["HH"] for one in simulate(truth, device="cpu")}
    views = []
    for one in truth.views:
        image = images[one.name] * random.gamma(LOOKS, 1 / LOOKS, images[one.name].shape)
        views.append(one.model_copy(update={"images": {"HH": image.astype(np.float32)}, "looks": LOOKS}))
    return replace(scene, views=views)


def table_of(folder: Path, name: str, column: np.ndarray, **more: Any) -> Material:
    """A material whose sigma0 is a column, written into the folder."""
    Sigma0Table(ANGLES, {"HH": column}).write(folder / f"{name}.csv")
    return Material(model="facet", sigma0=folder / f"{name}.csv", **more)


def strips_scene(width_m: float, blur: bool, folder: Path, seed: int) -> Scene:
    """Strips of lawn and soil: both start wrong."""
    effects = {"point_spread": validate("point_spread", BLUR, "effects.point_spread")} if blur else {}
    soil = Material(**SOIL)
    truth = site(mesh_of(**strips(width_m)), {"lawn": {"model": "facet", "sigma0": _written(folder)}, "soil": SOIL})
    truth = replace(truth, effects=effects)
    lawn = table_of(folder, "given", GIVEN.sigma0_db["HH"], learn=("sigma0",))
    start = {"lawn": lawn, "soil": soil.model_copy(update=START)}
    return seeing(replace(truth, materials=start), truth, seed)


def _written(folder: Path) -> Path:
    Sigma0Table(ANGLES, {"HH": TRUE_DB}).write(folder / "true.csv")
    return folder / "true.csv"


def box_on_a_table(folder: Path, seed: int) -> Scene:
    """A box on a lawn: its place, its sizes, its h and the lawn's table start wrong."""
    plain = site(mesh_of(lawn=ground(14.4)), {"lawn": {"model": "facet", "sigma0": _written(folder)}})
    lawn, soil = table_of(folder, "true", TRUE_DB), Material(**SOIL)
    truth = with_objects(plain, [Object(**BOX)], {"lawn": lawn, "soil": soil})
    lawn = table_of(folder, "given", GIVEN.sigma0_db["HH"], learn=("sigma0",))
    start = with_objects(plain, [Object(**BOX | MOVED)], {"lawn": lawn, "soil": soil.model_copy(update=START)})
    return seeing(start, truth, seed)


def field_beside_a_table(folder: Path, seed: int) -> Scene:
    """Strips of lawn and of a soil whose h is another at each vertex, under a blur: both start wrong."""
    mesh = mesh_of(**strips(1.2, cells=6))
    own = Material(**SOIL | FIELD)
    begun = table_of(folder, "given", GIVEN.sigma0_db["HH"], learn=("sigma0",))
    lawns = Material(model="facet", sigma0=_written(folder)), begun
    truth, start = (
        replace(
            site(mesh, {"lawn": {"model": "facet", "sigma0": lawn.sigma0}, "soil": SOIL}),
            mesh=replace(mesh, vertex_scalars={"h": values}),
            materials={"lawn": lawn, "soil": own},
            effects={"point_spread": validate("point_spread", BLUR, "effects.point_spread")},
        )
        for lawn, values in zip(
            lawns, (field_of(mesh.vertices), np.full(len(mesh.vertices), START["rms_height_m"])), strict=True
        )
    )
    return seeing(start, truth, seed)


def field_of(vertices: np.ndarray) -> np.ndarray:
    """The true h [m] of a field at vertices."""
    return np.asarray(TRUE_H * np.exp(0.5 * np.sin(0.7 * vertices[:, 0]) * np.cos(0.6 * vertices[:, 1])))


def box_on_a_field(begin_m: float, folder: Path, seed: int) -> Scene:
    """A box, whose place and sizes start wrong, on a soil whose h is another at each vertex, and starts as one number,
    `begin_m`."""
    mesh = mesh_of(soil=ground(16.0, 8))
    soils = []
    for values in (field_of(mesh.vertices), np.full(len(mesh.vertices), begin_m)):
        laid = replace(mesh, vertex_scalars={"h": values})
        soils.append(replace(site(mesh, {"soil": SOIL}), mesh=laid))
    rock = Material(**SOIL | {"learn": ()})
    box = BOX | {"material": "rock"}
    truth, start = (
        with_objects(plain, [Object(**box | moved)], {"soil": Material(**SOIL | FIELD), "rock": rock})
        for plain, moved in zip(soils, ({}, MOVED), strict=True)
    )
    return seeing(start, truth, seed)


class HeldFit(FitProblem):
    """A fit problem of which the elements `held` of x stay where x `stands`."""

    stands: np.ndarray | None = None
    held: np.ndarray | None = None

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """As `FitProblem.bounds`."""
        low, high = super().bounds
        if self.held is None or self.stands is None:
            return low, high
        return tuple(np.where(self.held, self.stands, end) for end in (low, high))  # type: ignore[return-value]


class FieldFit:
    """Adam over a field and a table, as `learn` fits them."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        begun = tables_to_learn(scene, folder / "out", "gamma")
        values = DeviceValues.of([one.block(name) for name, one in begun.items()])
        smooth = {"rms_height_m": 1.0}
        self.problem = HeldFit(scene, wp.get_device("cpu"), values=values, total_variation=smooth)
        self.x, self.steps = self.problem.x0.copy(), 0

    def fit(self, parts: str) -> None:
        """Minimise over some parts from where all stand."""
        problem, of_table = self.problem, np.arange(self.x.size) >= self.problem.of_values.start
        problem.stands = self.x
        problem.held = (of_table & ("table" not in parts)) | (~of_table & ("surface" not in parts))
        state = FitState(self.x, np.inf, self.x, np.inf)
        options = LearnOptions()
        descent = Adam(problem, state, options.rate)
        while not state.arrived and state.iteration < options.iterations:
            state = descent.step(state)
        self.x, self.steps = np.asarray(state.best_x), self.steps + state.iteration

    def row(self) -> str:
        """The objective, and the errors."""
        problem = self.problem
        heights = problem.surface.values("soil", "rms_height_m", problem.nodes(self.x)).ravel()
        at = problem.scene.mesh.vertices[problem.scene.parameters["materials.soil.rms_height_m"].used]
        off = np.log(heights / field_of(at))
        errors = f"{off_table(problem.values, self.x[problem.of_values])} {'':8} {np.sqrt(np.mean(off**2)):8.4f}"
        return f"{problem.loss_at(self.x):12.2f} {errors} {self.steps:5}"


def off_table(values: DeviceValues, z: np.ndarray) -> str:
    """The largest error of the table over the incidences seen [dB]."""
    if not values.blocks:
        return " " * 8
    db = values.blocks[0].values(z)[0]
    return f"{np.abs(db - TRUE_DB)[(ANGLES >= 25) & (ANGLES <= 60)].max():8.2f}"


class Fit:
    """One Gauss-Newton over whatever of a scene may move, and where its parts stand in x."""

    def __init__(self, scene: Scene, folder: Path) -> None:
        cpu = wp.get_device("cpu")
        begun = tables_to_learn(scene, folder / "out", "gamma")
        self.values = DeviceValues.of([one.block(name) for name, one in begun.items()])
        pixels, gains = lit_pixels(scene, cpu, "gamma")
        both = compared(scene, pixels, 0.0, gains)
        self.problem = PosedProblem(both.scene, cpu, both.observations, smooth=True, values=self.values)
        self.x, self.steps = self.problem.x0.copy(), 0
        inner, _ = self.problem.split(self.x)
        places = np.arange(self.x.size)
        self.parts = {
            "surface": places[: inner.of_effects.stop],
            "table": places[inner.of_values],
            "pose": places[self.problem.size :],
        }

    def fit(self, parts: str) -> None:
        """Minimise over some parts from where all stand."""
        moved = np.concatenate([self.parts[one] for one in parts.split()]).astype(int)
        low, high = (end.copy() for end in self.problem.bounds)
        held = np.setdiff1d(np.arange(self.x.size), moved)
        self.problem.bounds = tuple(np.where(np.isin(np.arange(low.size), held), self.x, end) for end in (low, high))
        done = descend(self.problem, self.x, most=200)
        self.problem.bounds = low, high
        self.x, self.steps = done.x, self.steps + done.steps

    def row(self) -> str:
        """The objective, and the errors."""
        inner, rest = self.problem.split(self.x)
        errors = [off_table(self.values, rest[inner.of_values])]
        (*objects,) = self.problem.geometry.at(self.x[self.problem.size :]).objects
        away = [np.linalg.norm(np.subtract(one.position_m, BOX["position_m"])[:2]) for one in objects]
        errors.append(f"{away[0]:8.3f}" if away else f"{'':8}")
        heights = inner.surface.values("soil", "rms_height_m", inner.nodes(rest)).ravel()
        if heights.size == 1:
            errors.append(f"{abs(np.log(heights[0] / TRUE_H)):8.4f}")
        else:
            at = inner.scene.mesh.vertices[inner.scene.parameters["materials.soil.rms_height_m"].used]
            seen = (np.abs(at).max(axis=1) < 6.0) & (np.abs(at).max(axis=1) > 2.6)
            off = np.log(heights / field_of(at))[seen]
            errors.append(f"{np.sqrt(np.mean(off**2)):8.4f}")
        return f"{self.problem.value(self.x):12.2f} {' '.join(errors)} {self.steps:5}"


def ways(*turn: str) -> dict[str, list[str]]:
    """The ways of a scene whose parts take turns so."""
    together = " ".join(dict.fromkeys(" ".join(turn).split()))
    return {
        "turns": [*turn],
        "turns, five times": 5 * [*turn],
        "together": [together],
        "turns, then together": [*turn, together],
    }


TABLE = ways("table", "surface")
SCENES = {
    "beside each other": (partial(strips_scene, 7.2, False), TABLE),
    "beside each other, blurred": (partial(strips_scene, 1.2, True), TABLE),
    "in every pixel": (partial(strips_scene, 0.3, False), TABLE),
    "a box on a table": (box_on_a_table, ways("table surface", "pose surface")),
    "a box on a field": (partial(box_on_a_field, TRUE_H), ways("pose", "surface")),
    "a box on a field, wrong h": (partial(box_on_a_field, START["rms_height_m"]), ways("pose", "surface")),
    "a field beside a table": (field_beside_a_table, {one: TABLE[one] for one in ("turns", "together")}),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Fits in turns and together.")
    parser.add_argument("--only", choices=SCENES, help="one of the scenes")
    parser.add_argument("--draws", type=int, default=3, help="draws of speckle of each scene")
    asked = parser.parse_args()
    errors = f"{'table dB':>8} {'place m':>8} {'ln h':>8} {'steps':>5}"
    print(f"{'scene':28} {'draw':>4} {'way':22} {'objective':>12} {errors} {'CPU s':>6}")
    for title, (made, its_ways) in SCENES.items():
        for draw in range(asked.draws if asked.only in (None, title) else 0):
            with tempfile.TemporaryDirectory() as folder:
                scene = made(Path(folder), draw)
                for way, steps in its_ways.items():
                    fit = (FieldFit if made is field_beside_a_table else Fit)(scene, Path(folder))
                    start = time.process_time()
                    for parts in steps:
                        fit.fit(parts)
                    seconds = time.process_time() - start
                    print(f"{title:28} {draw:4} {way:22} {fit.row()} {seconds:6.1f}", flush=True)


if __name__ == "__main__":
    main()
