"""sigma0 of hits: each backscatter model is recorded for the hits whose materials have it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import warp as wp

from warpsar.kernels import learned_term, shade
from warpsar.kernels.codes import PAGE
from warpsar.kernels.lane_kernels import LANES, at_once
from warpsar.kernels.scatter import page_kernels, places_of, scatter_kernel
from warpsar.models.base.model import DEFAULT
from warpsar.render.asked import ShadeRequest, Way
from warpsar.runtime.launches import Launch, by_elements
from warpsar.surface.stage import Stage
from warpsar.trace.hits import Hits


def by_model(stage: Stage, hits: Hits) -> dict[str, wp.array]:
    """The numbers of the hits of each model but the default, int, ascending; empty where all have the default.

    They are kept with the hits: every polarization and effect asks again.
    """
    models_of = stage.surface.model
    if stage.surface.by_default.all() or not hits.count:
        return {}
    key = "models", models_of
    if key not in hits.derived:
        names = sorted(set(models_of))
        code = np.array([names.index(one) for one in models_of])[stage.face_material.numpy()[hits.face.numpy()]]
        device = hits.face.device
        hits.derived[key] = {
            names[one]: wp.array(np.flatnonzero(code == one).astype(np.int32), dtype=int, device=device)
            for one in np.unique(code).tolist()
            if names[one] != DEFAULT
        }
    found: dict[str, wp.array] = hits.derived[key]
    return found


def record(asked: ShadeRequest, sigma: wp.array) -> None:
    """Record sigma0 of all hits into `sigma`: the default's first, and over it those of the other models.

    Of each model the slopes of its hits are kept where a gradient is asked for. One launch's adjoint multiplies with
    all of them, whosever they are: that of the first.
    """
    stage, hits, program, zeta = asked.stage, asked.hits, asked.program, asked.zeta
    n, device = hits.count, program.device
    others = by_model(stage, hits)

    @cache
    def slopes() -> wp.array:  # when a gradient is asked for
        # zero of hits that keep theirs elsewhere
        return (wp.zeros if asked.more else wp.empty)(n, dtype=wp.vec4, device=device)

    @cache
    def adjoint() -> Launch:
        pieces = by_elements([slopes(), sigma.grad, zeta.grad])
        return Launch(shade.scatter_adjoint_kernel, n, [slopes(), sigma.grad], [zeta.grad], device, pieces)

    def launch(way: Way, threads: int, per_thread: list[wp.array], first: bool) -> None:
        adjoints = [lambda: adjoint().launch()] if first else []
        if way.also is not None:
            adjoints.append(way.also(sigma))
        kernel, keeping, block = way.kernel, way.keeping, 1
        if device.is_cpu and way.in_lanes:
            kernel, keeping, block = at_once(kernel), at_once(keeping), LANES
        dim = -(-threads // block)
        kept = len(per_thread) > 1  # where each thread sees its own element, slopes are cut too
        keep = way.slopes or slopes
        none = wp.empty(0, dtype=way.coordinates, device=device)
        program.launch(
            kernel,
            dim,
            way.inputs,
            [sigma, none],
            adjoint=partial(_all, adjoints),
            keeping=lambda: Launch(
                keeping,
                dim,
                way.inputs,
                [sigma, keep()],
                device,
                by_elements([*per_thread, keep()] if kept else per_thread, block),
            ),
            pieces=by_elements(per_thread, block),
        )

    first = True
    if sum(mine.shape[0] for mine in others.values()) < n:
        own = Way(
            scatter_kernel(DEFAULT, False, some=False),
            scatter_kernel(DEFAULT, True, some=False),
            [none_of(device), asked.surfaces, asked.zeta],
        )
        cut = [hits.face, hits.cos_incidence, hits.cos_twist, hits.cos2_azimuth, zeta, sigma]
        launch(own, n, cut, first)
        first = False
    for model, mine in others.items():
        for way in ways_of(asked, model, mine):
            launch(way, mine.shape[0], [mine], first)
            first = False


def none_of(device: wp.Device) -> wp.array:
    """Where a kernel is for all hits: no numbers."""
    return wp.empty(0, dtype=int, device=device)


def ways_of(asked: ShadeRequest, model: str, mine: wp.array) -> list[Way]:
    """The launches for the hits `mine` of a model, one after the other."""
    own = f"warpsar.render.ways.{model}"
    if find_spec(own) is not None:
        found: list[Way] | None = import_module(own).ways(asked, mine)
        if found is not None:
            return found
    # on a GPU a kernel for each polarization
    fixed = None if asked.program.device.is_cpu else asked.polarization
    kernel, keeping = (scatter_kernel(model, kept, fixed) for kept in (False, True))
    if places_of(model) == PAGE:
        return [Way(kernel, keeping, [mine, asked.surfaces, asked.zeta])]
    whole, slopes, also = _joined(asked, mine, places_of(model))
    inputs = [mine, asked.surfaces, whole]
    return [Way(kernel, keeping, inputs, also, slopes=slopes, coordinates=whole.dtype)]


def _joined(
    asked: ShadeRequest, mine: wp.array, places: int
) -> tuple[wp.array, Callable[[], wp.array], Callable[[wp.array], Callable[[], None]]]:
    """Record all coordinates of the hits as one vector; where its slopes are kept, and what is their adjoint."""
    n, device = asked.hits.count, asked.program.device
    join, part_adjoint = page_kernels(places)
    dtype = wp.types.vector(length=places, dtype=float)
    whole = asked.program.array(n, dtype, grad=False)
    pages = [asked.zeta, *asked.more][: places // PAGE]
    for page, part in enumerate(pages):
        # the adjoint of sigma0 goes past it
        pieces = by_elements([part, whole])
        asked.program.launch(join, n, [page, part], [whole], adjoint=lambda: None, pieces=pieces)

    @cache
    def slopes() -> wp.array:
        return wp.empty(n, dtype=dtype, device=device)

    def also(sigma: wp.array) -> Callable[[], None]:
        @cache
        def launches() -> list[Launch]:
            return [
                Launch(
                    part_adjoint,
                    mine.shape[0],
                    [mine, page, slopes(), sigma.grad],
                    [part.grad],
                    device,
                    by_elements([mine]),
                )
                for page, part in enumerate(pages)
            ]

        def run() -> None:
            for one in launches():
                one.launch()

        return run

    return whole, slopes, also


def with_term(asked: ShadeRequest, sigma: wp.array) -> wp.array:
    """Record the learned terms on `sigma`; without any it is `sigma`."""
    terms = asked.stage.terms
    if terms is None:
        return sigma
    result = asked.program.array(sigma.shape[0])
    units = [terms.first, terms.inverse_width, terms.places, terms.weights]
    inputs = [asked.surfaces, math.log(asked.hits.geometry.wavenumber), *units, asked.zeta, sigma]
    asked.program.launch(learned_term.term_kernel, sigma.shape[0], inputs, [result])
    return result


def _all(adjoints: list[Callable[[], None]]) -> None:
    """Run them; none where another launch's adjoint multiplies with the slopes."""
    for adjoint in adjoints:
        adjoint()
