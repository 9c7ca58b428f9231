"""Where the effects of a view put scatterers, and with what power."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.records import upload
from warpsar.collection.plan import Plan, plan_axes
from warpsar.runtime.program import Program
from warpsar.world.tables import Grid

F64 = NDArray[np.float64]


def power_gain(plan: Plan, points_m: F64, pulse: int, device: wp.Device) -> F64 | None:
    """The factor on the power of scatterers at points (n, 3) [m] about the reference point, (n,), as a pulse sees
    them; None where no effect is a gain.

    The effects record their gains as they do for an image of power, each on a power of 1.
    """
    effects = [one for one in plan.effects if one.effect.stage == "gain"]
    if not effects:
        return None
    total = np.ones(len(points_m))
    points = upload(points_m, wp.vec3, device)
    for one in effects:
        program = Program(device)
        recorder: Any = SimpleNamespace(program=program, geometry=plan.geometry_at(pulse))
        p: wp.array = wp.array(one.values, dtype=float, device=device)
        power = wp.ones(len(points_m), dtype=float, device=device)
        result = one.effect.gain(recorder, p, power, points)
        program.forward()
        total *= result.numpy()
    return total


@dataclass(frozen=True)
class MovedScatterers:
    """Scatterers where the effects put them: (n, 3) [m], the factor on their amplitudes, (n,), and which of the given
    ones each is."""

    point: F64
    factor: NDArray[np.complex64]
    index: NDArray[np.int64]


def moved(plan: Plan, points_m: F64, pulse: int, grid: Grid, seed: int, device: wp.Device) -> MovedScatterers:
    """Scatterers at points (n, 3) [m], with gains as a pulse sees them, shifted, and with their copies.

    Copies are those of scatterers that lie in the image. Each has a phase that the seed draws, one for all its
    scatterers: so smooth faces of the copy stay smooth, and two passes with one seed see one copy.
    """
    gain = power_gain(plan, points_m, pulse, device)
    factor = np.ones(len(points_m), np.complex64) if gain is None else np.sqrt(gain).astype(np.complex64)
    point, index = points_m + plan.shift_m, np.arange(len(points_m))
    if not plan.copies:
        return MovedScatterers(point, factor, index)
    row, column = plan_axes(plan)
    place = np.stack([point @ plan.geometry.d / float(row @ plan.geometry.d), point @ column], axis=1)
    inside = (np.abs(place) <= 0.5 * np.multiply(grid.shape, grid.spacing_m)).all(axis=1)
    found = [MovedScatterers(point, factor, index)]
    for number, copy in enumerate(plan.copies):
        turn = np.random.default_rng([seed, 2, number]).uniform(0.0, 2.0 * np.pi)
        amplitude = np.complex64(np.sqrt(copy.power) * np.exp(1j * turn))
        found.append(
            MovedScatterers(point[inside] + copy.azimuth_m * column, amplitude * factor[inside], index[inside])
        )
    joined = (np.concatenate([getattr(one, name) for one in found]) for name in ("point", "factor", "index"))
    return MovedScatterers(*joined)
