"""Values on the device that no x holds: with a Gaussian prior, minimised over all train views by Warp's adjoint.

A learned term's weights are such values, and so are those of a table of sigma0. They are sought in coordinates z of
which the prior expects a standard normal distribution: then all have one scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from scipy.optimize import minimize

from warpsar.errors import InputError
from warpsar.learning.problem import FitProblem
from warpsar.runtime import once
from warpsar.scene.scene import Scene

MOST_STEPS = 200
SEEN = (0.5, 99.5)  # percentiles of the hits' cos theta, between which a material counts as seen


@dataclass(frozen=True)
class DeviceBlock:
    """Values by channel, (channels, n), in the `rows` of a device array, where each channel fills all its `columns`.

    Before any image they are `start` + z `unit`^T, with z of a standard normal distribution; `unit` is (n, n).
    """

    rows: slice
    columns: list[list[int]]
    start: np.ndarray
    unit: np.ndarray

    def values(self, z: np.ndarray) -> np.ndarray:
        """The values at z, (channels n,)."""
        return np.asarray(self.start + z.reshape(self.start.shape) @ self.unit.T)

    def slope(self, gradient: np.ndarray) -> np.ndarray:
        """The gradient to z, (channels n,), from that to the device array."""
        own = np.stack([gradient[self.rows, column].sum(axis=1) for column in self.columns])
        return np.asarray((own @ self.unit).ravel())


def put(array: wp.array, blocks: Sequence[DeviceBlock], values: Sequence[np.ndarray]) -> None:
    """Write each block's values, (channels, n), into the array, whose other elements stay."""
    everywhere = array.numpy().copy()
    for block, its in zip(blocks, values, strict=True):
        for own, column in zip(its, block.columns, strict=True):
            everywhere[block.rows, column] = own[:, None]
    array.assign(everywhere)


def most_likely(
    problem: FitProblem, array: wp.array, blocks: Sequence[DeviceBlock]
) -> tuple[list[np.ndarray], np.ndarray, int]:
    """The blocks' values and the x that minimise loss and priors together, which then stand, and the steps taken.

    Where surfaces share pixels, values that are sought while x stands at a wrong start take up what x should explain
    (benchmarks/turns.py). A field of many nodes stays as declared. `array` belongs to the problem's stage, and has no
    gradient yet.
    """
    array.requires_grad = True
    ends = np.cumsum([block.start.size for block in blocks])
    moves = problem.uniform and not problem.variation.count
    x0 = problem.x0[: problem.x0.size * moves]

    def set_to(w: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
        *parts, x = np.split(w, ends)
        values = [block.values(part) for block, part in zip(blocks, parts, strict=True)]
        put(array, blocks, values)
        x = x if moves else problem.x0
        problem.set_to(x)
        return values, x

    def loss_and_slope(w: np.ndarray) -> tuple[float, np.ndarray]:
        _, x = set_to(w)
        z = w[: ends[-1]]
        total, slope, surface = 0.5 * float(z @ z), np.zeros(array.shape), np.zeros(problem.learned.size)
        for view in problem.views:
            if not problem.scene.grid.calibrated:
                view.run_images()
                gains = [problem.misfit.gain(*pair) for pair in zip(view.observations, view.modelled(), strict=True)]
                view.gain.assign(np.array(gains, np.float32))
            view.forward(gradient=True)
            view.backward()
            total += float(view.loss.numpy().sum() + view.outside.numpy().sum())
            slope += array.grad.numpy()
            surface += view.render.nodes.grad.numpy()[problem.learned]
        to_z = z + np.concatenate([block.slope(slope) for block in blocks])
        if not moves:
            return total, to_z
        to_x = np.concatenate([surface, problem.effect_slopes(x)]) + problem.prior.gradient(x)
        return total + problem.prior.value(x), np.concatenate([to_z, to_x])

    start: Any = np.concatenate([np.zeros(ends[-1]), x0])
    low, high = problem.bounds
    bounds: Any = [(-np.inf, np.inf)] * ends[-1] + list(zip(low, high, strict=True))[: x0.size]
    options: Any = {"maxiter": MOST_STEPS}
    done: Any = minimize(loss_and_slope, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    values, x = set_to(done.x)
    return values, x, int(done.nit)


def refuse_run(scene: Scene, name: str, key: str, folder: Path | None) -> Path:
    """The folder for a material's new file. Raises InputError without one, and with several processes."""
    if folder is None or once.processes() > 1:
        why = "needs a folder for its file" if folder is None else f"found {once.processes()} processes; must be one"
        raise InputError(f"{scene.name}: materials.{name}.learn: {key}: {why}")
    return folder


def seen_cosines(problem: FitProblem, name: str, key: str) -> np.ndarray:
    """cos theta of all hits of a material. Raises InputError where there is none, or where they are not in memory."""
    material = problem.surface.materials.index(name)
    seen = []
    for view in problem.views:
        if not view.render.keeps_hits:
            raise InputError(f"{problem.scene.name}: {key} is trained with all hits in memory; --max-memory is too low")
        hits = view.render.whole.shaded
        seen.append(hits.cos_incidence.numpy()[problem.stage.face_material.numpy()[hits.face.numpy()] == material])
    cosines = np.concatenate(seen)
    if not cosines.size:
        raise InputError(f"{problem.scene.name}: materials.{name}.learn: {key}: no train view sees the material")
    return cosines
