"""sigma0 by the models beside the default: each is recorded for the hits whose materials have it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
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
from warpsar.runtime.program import Program, adjoint_of
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits


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


def has_default(stage: Stage, hits: Hits) -> bool:
    """Whether a hit's material has the default model."""
    return sum(mine.shape[0] for mine in by_model(stage, hits).values()) < hits.count


@dataclass(frozen=True)
class Asked:
    """What sigma0 is recorded for: coordinates `zeta` of the hits of a view, in one polarization.

    `of_the_mesh`: no effect has changed the coordinates, so they are the same all over a uniform material.
    """

    program: Program
    stage: Stage
    hits: Hits
    wavenumber: float
    polarization: Polarization
    spectrum: wp.array
    zeta: wp.array
    of_the_mesh: bool

    @property
    def places(self) -> list[wp.array]:
        """What all kernels read of a hit."""
        return [self.hits.face, self.stage.face_material, self.hits.cos_incidence, self.hits.cos_twist]

    @property
    def local(self) -> int:
        return int(self.stage.local_basis)


@dataclass(frozen=True)
class _Way:
    """A launch of `hits` hits a thread: the kernel of sigma0, and the one that stores its slopes too."""

    kernel: wp.Kernel
    keeping: wp.Kernel
    inputs: list[Any]
    hits: int = 1


def record(asked: Asked, sigma: wp.array, slopes: Callable[[], wp.array], adjoint: Callable[[], None]) -> None:
    """Record sigma0 of the hits of further models over that of the default, which has been recorded where it has hits.

    `slopes()` makes the array of the slopes of all hits. `adjoint` multiplies with them, whosever they are: it belongs
    to the default, or to the first launch where no hit has the default.
    """
    stage, hits, program = asked.stage, asked.hits, asked.program
    adjoints = [] if has_default(stage, hits) else [adjoint]
    none = wp.empty(0, dtype=wp.vec4, device=program.device)
    for model, mine in by_model(stage, hits).items():
        for way in _ways(asked, model, mine):
            dim = -(-mine.shape[0] // way.hits)
            if model == Model.FACET:
                adjoints.append(_to_the_table(dim, way.inputs, sigma))
            program.launch(
                way.kernel,
                dim,
                way.inputs,
                [sigma, none],
                adjoint=partial(_all, adjoints),
                keeping=partial(_keeping, way, dim, sigma, slopes, mine),
                pieces=by_elements([mine], way.hits),
            )
            adjoints = []


def _ways(asked: Asked, model: Model, mine: wp.array) -> list[_Way]:
    """The launches for the hits `mine` of a model, one after the other."""
    if model == Model.FACET:
        tables = asked.stage.tables
        assert tables is not None
        own_tables = [tables.rows, tables.incidence_deg, tables.sigma0_db]
        inputs = [mine, int(asked.polarization), asked.local, *asked.places, *own_tables, asked.zeta]
        return [_Way(facet.scatter_kernel, facet.scatter_kernel, inputs)]
    if model == Model.I2EM and asked.polarization.crossed:
        own = _one_of_each(asked.stage, asked.hits, mine)
        if asked.of_the_mesh and _uniform(asked.stage, own):
            return [_tabled(asked, mine, own)]
        surfaces = _surfaces(asked, own)
        if len(set(surfaces.values())) <= MOST_ROWS:
            return _splined(asked, mine, surfaces)
    if asked.program.device.is_cpu:
        kernel, inputs = models_lanes.scatter_kernel, [int(model), int(asked.polarization), *_inputs(asked, mine)]
        return [_Way(kernel, kernel, inputs, models_lanes.HITS)]
    kernel, keeping = (models.scatter_kernel(model, asked.polarization, kept) for kept in (False, True))
    return [_Way(kernel, keeping, _inputs(asked, mine))]


def _inputs(asked: Asked, mine: wp.array) -> list[Any]:
    return [mine, asked.wavenumber, asked.local, *asked.places, asked.spectrum, asked.stage.eps_im, asked.zeta]


def _tabled(asked: Asked, mine: wp.array, own: np.ndarray) -> _Way:
    """HV from tables over incidence, one row for each material of the scene; `own` as of `_one_of_each`."""
    program, stage = asked.program, asked.stage
    n, materials = len(own), stage.surface.places.shape[0]
    wave = program.array((n, crossed_table.DOUBLE, crossed_table.WAVES), wp.vec4d, grad=False)
    once = program.array((materials, crossed_table.SINGLE), wp.vec4, grad=False)
    twice = program.array((materials, crossed_table.DOUBLE), wp.vec4, grad=False)
    given = [wp.float64(asked.wavenumber), wp.array(own, dtype=wp.vec2i, device=program.device), asked.spectrum]

    def launch(kernel: wp.Kernel, dim: tuple[int, ...], inputs: list[Any], output: wp.array) -> None:
        program.launch(kernel, dim, [*given, *inputs], [output], adjoint=partial(_all, []))

    launch(crossed_table.wave_kernel, wave.shape, [stage.eps_im, asked.zeta], wave)
    launch(crossed_table.double_kernel, (n, crossed_table.DOUBLE), [asked.zeta, wave], twice)
    launch(crossed_table.single_kernel, (n, crossed_table.SINGLE), [stage.eps_im, asked.zeta], once)
    inputs = [mine, asked.local, *asked.places, once, twice]
    if program.device.is_cpu:
        kernel = crossed_table_lanes.scatter_kernel
        return _Way(kernel, kernel, inputs, crossed_table_lanes.HITS)
    return _Way(crossed_table.scatter_kernel, crossed_table.scatter_kernel, inputs)


def _splined(asked: Asked, mine: wp.array, surfaces: dict[int, tuple[int, float]]) -> list[_Way]:
    """HV of surfaces that vary from a spline, and by the integral beyond its ends."""
    device: wp.Device = asked.program.device
    rows = sorted(set(surfaces.values()))
    row = np.zeros(len(asked.stage.surface.materials), np.int32)
    for m, surface in surfaces.items():
        row[m] = rows.index(surface)
    inputs = _inputs(asked, mine)
    read = [*inputs, wp.array(row, dtype=int, device=device), table(tuple(rows), device)]
    if device.is_cpu:
        kernel = crossed_spline_lanes.scatter_kernel
        return [_Way(kernel, kernel, read, crossed_spline_lanes.HITS)]
    within, keeping = (crossed_spline.scatter_kernel(kept) for kept in (False, True))
    beyond = crossed_spline.beyond_kernel
    return [_Way(within, keeping, read), _Way(beyond, beyond, inputs)]


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


def _surfaces(asked: Asked, own: np.ndarray) -> dict[int, tuple[int, float]]:
    """Spectrum and eps_im of the materials `own`."""
    spectra = asked.spectrum.numpy()
    return {int(m): (int(spectra[m]), float(asked.stage.surface.eps_im[m])) for m in own[:, 0]}


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


def _all(adjoints: list[Callable[[], None]]) -> None:
    """Run them; none where another launch's adjoint multiplies with the slopes."""
    for adjoint in adjoints:
        adjoint()


def _to_the_table(hits: int, inputs: list[Any], sigma: wp.array) -> Callable[[], None]:
    """What adds sigma's gradient to that of the tables' values, where they have one: Warp's adjoint of the kernel."""
    *others, values, zeta = inputs

    @cache
    def recorded() -> tuple[wp.array, wp.Launch]:
        # The adjoint of a store sets its gradient to 0, and the default's adjoint needs it still: this has a copy. The
        # slopes carry the gradient of zeta, which so has none here.
        kept = wp.empty_like(sigma.grad)
        power: wp.array = wp.array(ptr=sigma.ptr, dtype=float, shape=sigma.shape, device=sigma.device, grad=kept)
        held: wp.array = wp.array(ptr=zeta.ptr, dtype=wp.vec4, shape=zeta.shape, device=zeta.device)
        none = wp.empty(0, dtype=wp.vec4, device=zeta.device)
        return kept, adjoint_of(facet.scatter_kernel, hits, [*others, values, held], [power, none], zeta.device)

    def run() -> None:
        if values.requires_grad:
            kept, launch = recorded()
            wp.copy(kept, sigma.grad)
            launch.launch()

    return run


def _keeping(way: _Way, dim: int, sigma: wp.array, slopes: Callable[[], wp.array], mine: wp.array) -> Launch:
    """The launch that stores the slopes too, when a gradient is asked for."""
    device = mine.device
    assert device is not None
    return Launch(way.keeping, dim, way.inputs, [sigma, slopes()], device, by_elements([mine], way.hits))
