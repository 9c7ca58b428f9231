"""Which views this process holds, and how: with their hits in memory, or traced again in bands."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import warp as wp

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.registry import declared
from warpsar.render.bands import BandedRender, stretches
from warpsar.render.render import ViewRender
from warpsar.render.rendered import Rendered
from warpsar.runtime import console
from warpsar.runtime.deadline import check
from warpsar.runtime.memory import OutOfMemoryError, default_gib, in_parts, kept_bytes, ran_out
from warpsar.runtime.once import Sharing
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays, effects_grid
from warpsar.surface.stage import Stage
from warpsar.world.tables import View

T = TypeVar("T")


def views_held(
    scene: Scene, chosen: Sequence[View], rays: Rays, sharing: Sharing, max_memory_gib: float | None
) -> tuple[list[View], dict[str, int]]:
    """The views of this process, and the number of bands of each view whose hits are not kept.

    The views are dealt by their merged hits. `max_memory_gib` bounds what the hits of this process's views take (by
    default `memory.default_gib`).
    """
    device = rays.stage.target.device
    effects = {v.name: declared(scene, v, neutral=True) for v in chosen}
    budget = (default_gib(device) if max_memory_gib is None else max_memory_gib) * 2**30

    def size(view: View, hits: int) -> int:
        return kept_bytes(hits, len(view.images), len(effects[view.name]))

    def most(views: Sequence[View]) -> dict[str, int]:
        return {v.name: rays.most_hits(scene, v, effects[v.name]) for v in views}

    def expected(views: Sequence[View]) -> dict[str, int]:
        return {v.name: rays.expected_hits(scene, v, effects[v.name]) for v in views}

    if sharing.alone:
        mine, hits = list(chosen), most(chosen)
        if sum(size(v, hits[v.name]) for v in mine) > budget:
            hits = expected(mine)
    else:
        own = [chosen[i] for i in sharing.mine([1.0] * len(chosen))]

        def counted() -> dict[str, int]:
            bound = most(own)
            # a GPU takes as long for one column as for the whole image: trace it all where it is sure to fit
            if device.is_cuda and sum(size(v, bound[v.name]) for v in own) <= budget:
                return {v.name: rays.hits(scene, v, effects[v.name]).count for v in own}
            return expected(own)

        hits = {name: n for part in sharing.gather(sharing.agree(counted)) for name, n in part.items()}
        costs = [hits[v.name] * len(v.images) for v in chosen]
        mine = [chosen[i] for i in sharing.mine(costs)]
        for view in own:
            if view not in mine:
                rays.forget(view)
    smallest_first = sorted(mine, key=lambda v: hits[v.name])
    return mine, _bands({v.name: size(v, hits[v.name]) for v in smallest_first}, budget)


def _bands(sizes: dict[str, int], budget: float) -> dict[str, int]:
    """The number of bands of each view that finds no room; `sizes` [bytes] are in the order in which room is given."""
    bands, left = {}, budget
    for name, size in sizes.items():
        if size <= left:
            left -= size
        else:
            # half: the kept views need room too, and the sizes are estimates
            bands[name] = max(2, math.ceil(size / (budget / 2)))
    if bands:
        console.say(
            f"memory: the hits of {len(bands)} of {len(sizes)} views would take more than {budget / 2**30:.3g} GiB; "
            f"they are traced again in every iteration, in up to {max(bands.values())} bands"
        )
    return bands


def with_render(
    use: Callable[[Rendered, list[DeclaredEffect]], T],
    scene: Scene,
    stage: Stage,
    rays: Rays,
    view: View,
    bands: int | None,
    nodes: wp.array | None,
) -> T:
    """What `use` makes of the view's render and effects.

    The render keeps its hits, unless `bands` are given or the memory runs out in `use`. `nodes` as in `ViewRender`.
    Raises OutOfMemoryError where even the smallest bands are too large, and TimeUp where the time of the run is over.
    """
    check()
    effects = declared(scene, view, neutral=True)
    shape, polarizations = scene.grid.shape, tuple(view.images)
    if bands is None:
        try:
            hits = rays.hits(scene, view, effects)
            return use(ViewRender(stage, view, hits, shape, polarizations, effects, nodes=nodes), effects)
        except (MemoryError, RuntimeError, OutOfMemoryError) as error:
            if not ran_out(error):
                raise
        rays.forget(view)
        console.say(f"view {view.name}: out of memory for its hits; they are traced again in every iteration")

    def banded(parts: int) -> T:
        columns = stretches(effects_grid(scene, effects), (bands or 2) * parts)
        trace = partial(rays.trace, scene, view, effects)
        return use(BandedRender(stage, view, trace, columns, shape, polarizations, effects, nodes=nodes), effects)

    return in_parts(banded, f"view {view.name}")
