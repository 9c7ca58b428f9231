"""sigma0 by the models beside the default: each is recorded for the hits whose materials have it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import (
    crossed_spline,
    crossed_spline_lanes,
    crossed_table,
    crossed_table_lanes,
    facet,
    learned_term,
    models,
    models_lanes,
)
from warpsar.kernels.codes import Layout, Model, Polarization
from warpsar.render.crossed_spline import MOST_ROWS, table
from warpsar.runtime.launches import Launch, by_elements
from warpsar.runtime.program import Program
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits

_Launches = list[tuple[wp.Kernel, wp.Kernel, list[Any]]]
"""Kernels without and with slopes, and their inputs"""


def by_model(stage: Stage, hits: Hits) -> dict[Model, wp.array]:
    """The numbers of the hits of each model but the default, int, ascending; empty where all have the default.

    They are kept with the hits: every polarization and effect asks again.
    """
    models_of = stage.surface.model
    if not models_of.any() or not hits.count:
        return {}
    key = "models", models_of.tobytes()
    if key not in hits.derived:
        model = models_of[stage.face_material.numpy()[hits.face.numpy()]]
        device = hits.face.device
        hits.derived[key] = {
            Model(code): wp.array(np.flatnonzero(model == code).astype(np.int32), dtype=int, device=device)
            for code in np.unique(model).tolist()
            if code != Model.KA_SPM
        }
    found: dict[Model, wp.array] = hits.derived[key]
    return found


def record(
    program: Program,
    stage: Stage,
    hits: Hits,
    wavenumber: float,
    polarization: int,
    spectrum: wp.array,
    zeta: wp.array,
    sigma: wp.array,
    slopes: Callable[[], wp.array],
    *,
    of_the_mesh: bool,
) -> None:
    """Record sigma0 of the hits of further models over that of the default, which has been recorded for all hits.

    `slopes()` makes the array of the slopes of all hits. The default's adjoint multiplies with them, whosever they are.
    `of_the_mesh`: no effect has changed the coordinates, so they are the same all over a uniform material.
    """
    device: wp.Device = program.device
    local = int(stage.local_basis)
    for model, mine in by_model(stage, hits).items():
        places = [hits.face, stage.face_material, hits.cos_incidence, hits.cos_twist]
        block = 1
        crossed = model == Model.I2EM and Polarization(polarization).crossed
        own = _one_of_each(stage, hits, mine) if crossed else np.zeros((0, 2), np.int32)
        surfaces = _surfaces(stage, own, spectrum)
        if model == Model.FACET:
            tables = stage.tables
            assert tables is not None
            rows = [tables.rows, tables.incidence_deg, tables.sigma0_db]
            kernel = facet.scatter_kernel
            launches: _Launches = [(kernel, kernel, [mine, polarization, local, *places, *rows, zeta])]
        elif crossed and of_the_mesh and _uniform(stage, own):
            kernel = crossed_table_lanes.scatter_kernel if device.is_cpu else crossed_table.scatter_kernel
            block = crossed_table_lanes.HITS if device.is_cpu else 1
            made = _crossed_tables(program, stage, own, wavenumber, spectrum, zeta)
            launches = [(kernel, kernel, [mine, local, *places, *made])]
        elif crossed and len(set(surfaces.values())) <= MOST_ROWS:
            inputs = [mine, wavenumber, local, *places, spectrum, stage.eps_im, zeta]
            block, launches = _splined(stage, surfaces, inputs)
        else:
            kernel = models_lanes.scatter_kernel if device.is_cpu else models.scatter_kernel
            block = models_lanes.HITS if device.is_cpu else 1
            inputs = [int(model), mine, polarization, wavenumber, local, *places, spectrum, stage.eps_im, zeta]
            launches = [(kernel, kernel, inputs)]
        dim, none = -(-mine.shape[0] // block), wp.empty(0, dtype=wp.vec4, device=device)
        for kernel, keeping, inputs in launches:
            program.launch(
                kernel,
                dim,
                inputs,
                [sigma, none],
                adjoint=lambda: None,
                keeping=partial(_keeping, keeping, dim, inputs, sigma, slopes, mine, block),
                pieces=by_elements([mine], block),
            )


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


def _crossed_tables(
    program: Program, stage: Stage, own: np.ndarray, wavenumber: float, spectrum: wp.array, zeta: wp.array
) -> list[wp.array]:
    """Record the tables of HV over incidence, one row for each material of the scene; `own` as of `_one_of_each`."""
    n, materials = len(own), stage.surface.places.shape[0]
    wave = program.array((n, crossed_table.DOUBLE, crossed_table.WAVES), wp.vec4d, grad=False)
    once = program.array((materials, crossed_table.SINGLE), wp.vec4, grad=False)
    twice = program.array((materials, crossed_table.DOUBLE), wp.vec4, grad=False)
    given = [wp.float64(wavenumber), wp.array(own, dtype=wp.vec2i, device=program.device), spectrum]

    def launch(kernel: wp.Kernel, dim: tuple[int, ...], inputs: list[Any], output: wp.array) -> None:
        program.launch(kernel, dim, [*given, *inputs], [output], adjoint=lambda: None)

    launch(crossed_table.wave_kernel, wave.shape, [stage.eps_im, zeta], wave)
    launch(crossed_table.double_kernel, (n, crossed_table.DOUBLE), [zeta, wave], twice)
    launch(crossed_table.single_kernel, (n, crossed_table.SINGLE), [stage.eps_im, zeta], once)
    return [once, twice]


def _surfaces(stage: Stage, own: np.ndarray, spectrum: wp.array) -> dict[int, tuple[int, float]]:
    """Spectrum and eps_im of the materials `own`."""
    spectra = spectrum.numpy()
    return {int(m): (int(spectra[m]), float(stage.surface.eps_im[m])) for m in own[:, 0]}


def _splined(stage: Stage, surfaces: dict[int, tuple[int, float]], inputs: list[Any]) -> tuple[int, _Launches]:
    """The launches of HV from a spline, and how many hits a thread of theirs takes."""
    device = stage.target.device
    rows = sorted(set(surfaces.values()))
    row = np.zeros(len(stage.surface.materials), np.int32)
    for m, surface in surfaces.items():
        row[m] = rows.index(surface)
    read = [*inputs, wp.array(row, dtype=int, device=device), table(tuple(rows), device)]
    if device.is_cpu:
        kernel = crossed_spline_lanes.scatter_kernel
        return crossed_spline_lanes.HITS, [(kernel, kernel, read)]
    kernel, keeping = (crossed_spline.scatter_kernel(slopes) for slopes in (False, True))
    beyond = crossed_spline.beyond_kernel
    return 1, [(kernel, keeping, read), (beyond, beyond, inputs)]


def with_term(
    program: Program, stage: Stage, hits: Hits, wavenumber: float, polarization: int, zeta: wp.array, sigma: wp.array
) -> wp.array:
    """Record the learned terms on `sigma`; without any it is `sigma`."""
    terms = stage.terms
    if terms is None:
        return sigma
    result = program.array(sigma.shape[0])
    units = [terms.first, terms.inverse_width, terms.places, terms.weights]
    places = [hits.face, stage.face_material, hits.cos_incidence]
    inputs = [polarization, math.log(wavenumber), *units, *places, zeta, sigma]
    program.launch(learned_term.term_kernel, sigma.shape[0], inputs, [result])
    return result


def _keeping(
    kernel: wp.Kernel,
    dim: int,
    inputs: list[Any],
    sigma: wp.array,
    slopes: Callable[[], wp.array],
    mine: wp.array,
    block: int,
) -> Launch:
    """The launch that stores the slopes too, when a gradient is asked for."""
    device = mine.device
    assert device is not None
    return Launch(kernel, dim, inputs, [sigma, slopes()], device, by_elements([mine], block))
