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


def most_likely(problem: FitProblem, array: wp.array, blocks: Sequence[DeviceBlock]) -> tuple[list[np.ndarray], int]:
    """The blocks' values that minimise loss and prior, which then stand in the array, and the steps taken.

    All else is held as the scene declares it. `array` belongs to the problem's stage, and has no gradient yet.
    """
    array.requires_grad = True
    problem.loss_at(problem.x0)  # the surface and the effects, at which everything else stays
    ends = np.cumsum([block.start.size for block in blocks])

    def set_to(z: np.ndarray) -> list[np.ndarray]:
        values = [block.values(part) for block, part in zip(blocks, np.split(z, ends[:-1]), strict=True)]
        put(array, blocks, values)
        return values

    def loss_and_slope(z: np.ndarray) -> tuple[float, np.ndarray]:
        set_to(z)
        total, slope = 0.5 * float(z @ z), np.zeros(array.shape)
        for view in problem.views:
            if not problem.scene.grid.calibrated:
                view.run_images()
                gains = [problem.misfit.gain(*pair) for pair in zip(view.observations, view.modelled(), strict=True)]
                view.gain.assign(np.array(gains, np.float32))
            view.forward(gradient=True)
            view.backward()
            total += float(view.loss.numpy().sum())
            slope += array.grad.numpy()
        return total, z + np.concatenate([block.slope(slope) for block in blocks])

    start: Any = np.zeros(ends[-1])
    done: Any = minimize(loss_and_slope, start, jac=True, method="L-BFGS-B", options={"maxiter": MOST_STEPS})
    return set_to(done.x), int(done.nit)


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
