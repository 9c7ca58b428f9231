"""HV of `i2em` from a table over incidence or a spline: at every hit its integral would take too long."""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import crossed_spline, crossed_table
from warpsar.kernels.codes import Layout
from warpsar.kernels.incidence_table import DOUBLE, SINGLE
from warpsar.kernels.models.i2em import RINGS
from warpsar.render.asked import ShadeRequest, Way
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits


def ways(asked: ShadeRequest, mine: wp.array) -> list[Way] | None:
    if not asked.polarization.crossed:
        return None
    own = _one_of_each(asked.stage, asked.hits, mine)
    if asked.of_the_mesh and _uniform(asked.stage, own):
        return [_tabled(asked, mine, own)]
    surfaces = _surfaces(asked, own)
    return _splined(asked, mine, surfaces) if len(set(surfaces.values())) <= MOST_ROWS else None


def _nothing() -> None:
    """A table's adjoint: its slopes say all."""


def _tabled(asked: ShadeRequest, mine: wp.array, own: np.ndarray) -> Way:
    """HV from tables over incidence, one row for each material of the scene; `own` as of `_one_of_each`."""
    program, stage = asked.program, asked.stage
    n, materials = len(own), stage.surface.places.shape[0]
    wave = program.array((n, DOUBLE, crossed_table.WAVES), wp.vec4d, grad=False)
    once = program.array((materials, SINGLE), wp.vec4, grad=False)
    twice = program.array((materials, DOUBLE), wp.vec4, grad=False)
    given = [
        wp.float64(asked.hits.geometry.wavenumber),
        wp.array(own, dtype=wp.vec2i, device=program.device),
        asked.spectrum,
    ]

    def launch(kernel: wp.Kernel, dim: tuple[int, ...], inputs: list[Any], output: wp.array) -> None:
        program.launch(kernel, dim, [*given, *inputs], [output], adjoint=_nothing)

    launch(crossed_table.wave_kernel, wave.shape, [stage.eps_im, asked.zeta], wave)
    launch(crossed_table.double_kernel, (n, DOUBLE), [asked.zeta, wave], twice)
    launch(crossed_table.single_kernel, (n, SINGLE), [stage.eps_im, asked.zeta], once)
    inputs = [mine, asked.surfaces, once, twice]
    kernel, keeping = map(crossed_table.scatter_kernel, (False, True))
    return Way(kernel, keeping, inputs)


def _splined(asked: ShadeRequest, mine: wp.array, surfaces: dict[int, tuple[int, float]]) -> list[Way]:
    """HV of surfaces that vary from a spline, and by the integral beyond its ends."""
    device: wp.Device = asked.program.device
    rows = sorted(set(surfaces.values()))
    stage = asked.stage
    row = np.zeros(len(stage.surface.materials), np.int32)
    for m, surface in surfaces.items():
        row[m] = rows.index(surface)
    inputs = [mine, asked.surfaces, asked.zeta]
    read = [*inputs, wp.array(row, dtype=int, device=device), table(tuple(rows), device)]
    kernel, keeping = (crossed_spline.scatter_kernel(kept, beyond=device.is_cpu) for kept in (False, True))
    found = [Way(kernel, keeping, read)]
    if not device.is_cpu:
        found.append(Way(crossed_spline.beyond_kernel, crossed_spline.beyond_kernel, inputs))
    return found


def _one_of_each(stage: Stage, hits: Hits, mine: wp.array) -> np.ndarray:
    """The materials of some hits and one hit of each, int32, (n, 2); kept with the hits."""
    key = "one of each", id(mine)
    if key not in hits.derived:
        numbers = mine.numpy()
        material = stage.face_material.numpy()[hits.face.numpy()[numbers]]
        found = np.flatnonzero(np.bincount(material))
        hits.derived[key] = np.array([[m, numbers[np.argmax(material == m)]] for m in found], np.int32)
    own: np.ndarray = hits.derived[key]
    return own


def _uniform(stage: Stage, own: np.ndarray) -> bool:
    """Whether each of the materials `own` has one value of everything that sigma0 depends on."""
    return bool(np.isin(stage.surface.places[own[:, 0], :, 0], (Layout.UNIFORM, Layout.HELD)).all())


def _surfaces(asked: ShadeRequest, own: np.ndarray) -> dict[int, tuple[int, float]]:
    """Spectrum and eps_im of the materials `own`."""
    spectra = asked.spectrum.numpy()
    return {int(m): (int(spectra[m]), float(asked.stage.surface.eps_im[m])) for m in own[:, 0]}


MOST_ROWS = 32
"""Of a table, 4.3 MB each: with more there is none, and every hit has the integral"""
_NODES = crossed_spline.COSINES, crossed_spline.HEIGHTS, crossed_spline.LENGTHS, crossed_spline.CONTRASTS
_making = threading.Lock()  # views are recorded side by side: the first makes the table, and the others wait


def table(surfaces: tuple[tuple[int, float], ...], device: wp.Device) -> wp.array:
    """The coefficients of each (spectrum, eps_im), one row after the other, float.

    They depend on nothing else. So they are made once for all views and fits of a process.
    """
    with _making:
        return _table(surfaces, device.alias)


@lru_cache(maxsize=4)
def _table(surfaces: tuple[tuple[int, float], ...], device: str) -> wp.array:
    rows = np.stack([_coefficients(*surface, device) for surface in surfaces])
    return wp.array(rows.ravel(), dtype=float, device=device)


def _coefficients(spectrum: int, eps_im: float, device: str) -> np.ndarray:
    """Of one spectrum and eps_im, float32 (COSINES + 2, HEIGHTS + 2, LENGTHS + 2, ROW)."""
    power = _launched(
        crossed_spline.power_kernel, (crossed_spline.COSINES, crossed_spline.CONTRASTS, RINGS), [eps_im], device
    )
    found = _launched(crossed_spline.lattice_kernel, _NODES, [power, _series(spectrum, device)], device).numpy()
    for axis in range(4):
        found = np.moveaxis(spline(np.moveaxis(found, axis, 0)), 0, axis)
    padded = np.zeros((*found.shape[:3], crossed_spline.ROW), np.float32)
    padded[..., : found.shape[3]] = found
    return padded


@lru_cache(maxsize=4)
def _series(spectrum: int, device: str) -> wp.array:
    return _launched(crossed_spline.series_kernel, (*_NODES[:3], RINGS), [spectrum], device)


def _launched(kernel: wp.Kernel, shape: tuple[int, ...], inputs: list[object], device: str) -> wp.array:
    made = wp.empty(shape, dtype=wp.float64, device=device)
    wp.launch(kernel, shape, inputs=inputs, outputs=[made], device=device, record_tape=False)
    return made


def spline(values: np.ndarray) -> np.ndarray:
    """Coefficients (n + 2, ...) of the quadratic spline through values (n, ...) at equal steps along the first axis.

    (c[i] + 6 c[i + 1] + c[i + 2]) / 8 is value i. At both ends third differences of the coefficients are zero.
    """
    n = len(values)
    found = np.empty((n + 2, *values.shape[1:]))
    inner = found[1:-1]
    # a tridiagonal system, by elimination: the ends give c[1] - c[2] = values[0] - values[1], and the same at the last
    inner[0] = values[0] - values[1]
    above = np.full(n, -1.0)
    for i in range(1, n - 1):
        above[i] = 1.0 / (6.0 - above[i - 1])
        inner[i] = above[i] * (8.0 * values[i] - inner[i - 1])
    inner[-1] = (values[-1] - values[-2] + inner[-2]) / (1.0 + above[n - 2])
    for i in range(n - 2, -1, -1):
        inner[i] -= above[i] * inner[i + 1]
    found[0] = 3.0 * (inner[0] - inner[1]) + inner[2]
    found[-1] = 3.0 * (inner[-1] - inner[-2]) + inner[-3]
    return found
