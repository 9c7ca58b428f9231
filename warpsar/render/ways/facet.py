"""sigma0 from tables over incidence, which a fit may move too."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import warp as wp

from warpsar.kernels.models import facet
from warpsar.render.asked import ShadeRequest, Way
from warpsar.runtime.program import adjoint_of


def ways(asked: ShadeRequest, mine: wp.array) -> list[Way]:
    tables = asked.stage.tables
    assert tables is not None
    own_tables = [tables.rows, tables.incidence_deg, tables.sigma0_db]
    inputs = [mine, asked.surfaces, *own_tables, asked.zeta]
    return [Way(facet.scatter_kernel, facet.scatter_kernel, inputs, partial(_to_the_table, inputs), in_lanes=False)]


def _to_the_table(inputs: list[Any], sigma: wp.array) -> Callable[[], None]:
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
        return kept, adjoint_of(
            facet.scatter_kernel, others[0].shape[0], [*others, values, held], [power, none], zeta.device
        )

    def run() -> None:
        if values.requires_grad:
            kept, launch = recorded()
            wp.copy(kept, sigma.grad)
            launch.launch()

    return run
