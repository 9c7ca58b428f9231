"""sigma0 by the models beside the default: each is recorded for the hits whose materials have it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import facet, learned_term, models, models_lanes
from warpsar.kernels.codes import Model
from warpsar.runtime.launches import Launch, by_elements
from warpsar.runtime.program import Program
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
) -> None:
    """Record sigma0 of the hits of further models over that of the default, which has been recorded for all hits.

    `slopes()` makes the array of the slopes of all hits. The default's adjoint multiplies with them, whosever they are.
    """
    device: wp.Device = program.device
    local = int(stage.local_basis)
    for model, mine in by_model(stage, hits).items():
        places = [hits.face, stage.face_material, hits.cos_incidence, hits.cos_twist]
        if model == Model.FACET:
            tables = stage.tables
            assert tables is not None
            kernel = facet.scatter_kernel
            inputs: list[Any] = [
                mine,
                polarization,
                local,
                *places,
                tables.rows,
                tables.incidence_deg,
                tables.sigma0_db,
                zeta,
            ]
            block = 1
        else:
            kernel = models_lanes.scatter_kernel if device.is_cpu else models.scatter_kernel
            block = models_lanes.HITS if device.is_cpu else 1
            inputs = [int(model), mine, polarization, wavenumber, local, *places, spectrum, stage.eps_im, zeta]
        dim, none = -(-mine.shape[0] // block), wp.empty(0, dtype=wp.vec4, device=device)

        program.launch(
            kernel,
            dim,
            inputs,
            [sigma, none],
            adjoint=lambda: None,
            keeping=partial(_keeping, kernel, dim, inputs, sigma, slopes, mine, block),
            pieces=by_elements([mine], block),
        )


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
