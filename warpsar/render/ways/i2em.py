"""HV of `i2em` from a table over incidence or a spline: at every hit its integral would take too long."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import crossed_spline, crossed_table
from warpsar.kernels.codes import Layout
from warpsar.kernels.incidence_table import DOUBLE, SINGLE
from warpsar.render.asked import ShadeRequest, Way
from warpsar.render.crossed_spline import MOST_ROWS, table
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
    given = [wp.float64(asked.wavenumber), wp.array(own, dtype=wp.vec2i, device=program.device), asked.spectrum]

    def launch(kernel: wp.Kernel, dim: tuple[int, ...], inputs: list[Any], output: wp.array) -> None:
        program.launch(kernel, dim, [*given, *inputs], [output], adjoint=_nothing)

    launch(crossed_table.wave_kernel, wave.shape, [stage.eps_im, asked.zeta], wave)
    launch(crossed_table.double_kernel, (n, DOUBLE), [asked.zeta, wave], twice)
    launch(crossed_table.single_kernel, (n, SINGLE), [stage.eps_im, asked.zeta], once)
    inputs = [mine, asked.local, *asked.places, once, twice]
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
    inputs = [mine, asked.wavenumber, asked.local, *asked.places, asked.spectrum, stage.eps_im, asked.zeta]
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
