"""A table of sigma0 and the other surfaces: fitted in turns, and in one minimisation as `learn` does.

    python benchmarks/turns.py

Three made scenes of a table (`facet`) beside a surface whose h is learned from a wrong start: parts that
share few pixels, the same under a blur, and both in every pixel. For each of a few draws of speckle: the objective
(negative log-likelihood and prior), the largest error of the table over the incidences seen, the error of ln h, and
CPU seconds. Turns: the table first, with the surface as it is declared; then the surface, with the table held.
Together: L-BFGS over all of them, from the same start and from where the turns ended.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ["WARPSAR_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

import numpy as np
import warp as wp
from scipy.optimize import minimize
from worlds import mesh_of, plate, scene_of, view

from warpsar import Scene, simulate
from warpsar.effects.registry import validate
from warpsar.learning.device_values import put
from warpsar.learning.problem import FitProblem
from warpsar.learning.table import _block
from warpsar.world.sigma0_table import Sigma0Table

ANGLES = np.arange(20.0, 71.0, 5.0)
GIVEN = Sigma0Table(ANGLES, {"HH": -8.0 - 0.2 * (ANGLES - 20.0)})
TRUE_DB = GIVEN.sigma0_db["HH"] + 2.5 * np.cos(np.radians(2.0 * ANGLES - 60.0))
TRUE_H = 0.0015  # [m]
SOIL = {"eps_r": 6.0, "rms_height_m": TRUE_H, "correlation_length_m": 0.01, "learn": ("rms_height_m",)}
START = {"rms_height_m": 0.0008}
LOOKS = 8.0
BLUR = {"range_fwhm_m": 1.2, "azimuth_fwhm_m": 1.2, "fixed": True}


def strips(width_m: float, side_m: float = 14.4) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Level ground of strips along y, which belong to the table and to the soil in turn."""
    starts = np.arange(-side_m / 2, side_m / 2 - 1e-9, width_m)
    parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"lawn": [], "soil": []}
    for number, start in enumerate(starts):
        parts["lawn" if number % 2 else "soil"].append(
            plate((start, -side_m / 2, 0.0), (width_m, 0, 0), (0, side_m, 0))
        )
    joined = {}
    for name, plates in parts.items():
        first = np.cumsum([0, *(len(vertices) for vertices, _ in plates[:-1])])
        faces = [faces + offset for (_, faces), offset in zip(plates, first, strict=True)]
        joined[name] = np.concatenate([vertices for vertices, _ in plates]), np.concatenate(faces)
    return joined


def scene_with(width_m: float, blur: bool, folder: Path, seed: int) -> Scene:
    """The scene with a wrong start, and with images of the truth."""
    for name, column in (("given", GIVEN.sigma0_db["HH"]), ("true", TRUE_DB)):
        Sigma0Table(ANGLES, {"HH": column}).write(folder / f"{name}.csv")
    effects = {"point_spread": validate("point_spread", BLUR, "effects.point_spread")} if blur else {}
    truth = scene_of(
        mesh_of(**strips(width_m)),
        [view(70 * k, angle, name=f"v{k}") for k, angle in enumerate((28, 36, 44, 52, 60))],
        shape=(24, 24),
        spacing_m=(0.6, 0.6),
        polarizations=("HH",),
        rays_per_pixel=64.0,
        materials={"lawn": {"model": "facet", "sigma0": folder / "true.csv"}, "soil": SOIL},
    )
    truth = replace(truth, effects=effects)
    random = np.random.default_rng(seed)
    images = {one.name: one.beta0["HH"] for one in simulate(truth, device="cpu")}
    views = [
        one.model_copy(
            update={
                "images": {"HH": images[one.name] * random.gamma(LOOKS, 1 / LOOKS, images[one.name].shape)},
                "looks": LOOKS,
            }
        )
        for one in truth.views
    ]
    lawn = truth.materials["lawn"].model_copy(update={"sigma0": folder / "given.csv"})
    return replace(
        truth, views=views, materials={"lawn": lawn, "soil": truth.materials["soil"].model_copy(update=START)}
    )


class Together:
    """Loss and prior of a table's coordinates z and of x, with their slopes."""

    def __init__(self, scene: Scene) -> None:
        self.problem = FitProblem(scene, wp.get_device("cpu"))
        tables = self.problem.stage.tables
        assert tables is not None
        self.array = tables.sigma0_db
        self.block = _block(GIVEN, ["HH"], tables.rows.numpy()[self.problem.surface.materials.index("lawn")])
        self.array.requires_grad = True
        self.z, self.x = np.zeros(len(ANGLES)), self.problem.x0.copy()

    def value(self, z: np.ndarray, x: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        problem = self.problem
        put(self.array, [self.block], [self.block.values(z)])
        problem.loss_at(x)
        total, to_table, to_x = 0.5 * float(z @ z), np.zeros(self.array.shape), np.zeros(x.size)
        for each in problem.views:
            each.forward(gradient=True)
            each.backward()
            total += float(each.loss.numpy().sum())
            to_table += self.array.grad.numpy()
            to_x += each.render.nodes.grad.numpy()[problem.learned]
        return total, z + self.block.slope(to_table), to_x

    def fit(self, table: bool, surface: bool) -> None:
        """Minimise over the table, the surface, or both, from where they stand."""
        split = len(self.z) * table

        def both(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return (w[:split] if table else self.z), (w[split:] if surface else self.x)

        def one(w: np.ndarray) -> tuple[float, np.ndarray]:
            total, to_z, to_x = self.value(*both(w))
            return total, np.concatenate([to_z[:split], to_x if surface else []])

        low, high = self.problem.bounds
        bounds = [(None, None)] * split + (list(zip(low, high, strict=True)) if surface else [])
        start = np.concatenate([self.z[:split], self.x if surface else []])
        done: Any = minimize(one, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 400})
        self.z, self.x = (part.copy() for part in both(done.x))

    def row(self) -> str:
        db = self.block.values(self.z)[0]
        seen = (ANGLES >= 25) & (ANGLES <= 60)
        height = float(self.problem.surface.values("soil", "rms_height_m", self.problem.nodes(self.x)).ravel()[0])
        error = abs(np.log(height / TRUE_H))
        return f"{self.value(self.z, self.x)[0]:12.2f} {np.abs(db - TRUE_DB)[seen].max():8.2f} {error:8.4f}"


WAYS: dict[str, list[tuple[bool, bool]]] = {
    "turns": [(True, False), (False, True)],
    "turns, five times": 5 * [(True, False), (False, True)],
    "together": [(True, True)],
    "turns, then together": [(True, False), (False, True), (True, True)],
}
SCENES = {"beside each other": (7.2, False), "beside each other, blurred": (1.2, True), "in every pixel": (0.3, False)}


def main() -> None:
    print(f"{'scene':28} {'draw':>4} {'way':22} {'objective':>12} {'table dB':>8} {'ln h':>8} {'CPU s':>6}")
    for title, (width_m, blur) in SCENES.items():
        for draw in range(3):
            with tempfile.TemporaryDirectory() as folder:
                scene = scene_with(width_m, blur, Path(folder), draw)
                for way, steps in WAYS.items():
                    fit = Together(scene)
                    start = time.process_time()
                    for table, surface in steps:
                        fit.fit(table, surface)
                    seconds = time.process_time() - start
                    print(f"{title:28} {draw:4} {way:22} {fit.row()} {seconds:6.1f}", flush=True)


if __name__ == "__main__":
    main()
