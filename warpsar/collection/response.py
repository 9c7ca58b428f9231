"""The response of a system to a point: widths, and the area that makes power of sigma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from warpsar.collection.presets import filled
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.base.phase import Response
from warpsar.errors import InputError
from warpsar.scene.checks import declared_twice
from warpsar.world.collection import Collection
from warpsar.world.taper import taper
from warpsar.world.world import World


def band_weights(window: str, count: int) -> NDArray[np.float64]:
    """The taper of a band's `count` samples, as `measured.focus` applies it."""
    return taper(window, (np.arange(count) + 0.5) / count - 0.5)


def asked(world: World, effects: Sequence[DeclaredEffect]) -> tuple[Collection, Response]:
    """`[collection]` with what its preset states, and the response that the scene asks for: by its effects, by the
    preset, or by the old key `resolution_m`. Raises InputError where it is asked for twice."""
    assert world.collection is not None
    stated = world.collection
    if problems := declared_twice(world.effects, stated):
        raise InputError(f"{world.name}: {problems[0]}")
    widths: list[float | None] = [None, None]
    tapers: list[str | None] = [None, None]
    for one in effects:
        response = one.effect.response(one.values, one.settings)
        widths = [new or old for new, old in zip(response.width_m, widths, strict=True)]
        tapers = [new or old for new, old in zip(response.taper, tapers, strict=True)]
    for name in tapers:
        if stated.window is not None and name not in (None, stated.window):
            raise InputError(
                f"{world.name}: collection.window: found {stated.window!r} beside effects.point_spread.window, which "
                f"means {name!r}: both state the taper; must be stated once"
            )
    table = filled(stated, resolved=widths[0] is not None)
    of_table = table.resolution_m or (None, None)
    return table, Response(
        (widths[0] or of_table[0], widths[1] or of_table[1]),
        (tapers[0] or table.window, tapers[1] or table.window),
    )
