"""The response of a system to a point: widths, and the area that makes power of sigma."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from warpsar.collection.presets import filled
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.base.phase import Response
from warpsar.effects.registry import response_of
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
    of_effects = response_of(effects)
    for name in of_effects.taper:
        if stated.window is not None and name not in (None, stated.window):
            raise InputError(
                f"{world.name}: collection.window: found {stated.window!r} beside effects.point_spread.window, which "
                f"means {name!r}: both state the taper; must be stated once"
            )
    table = filled(stated, resolved=of_effects.width_m[0] is not None)
    return table, of_effects.over(Response(table.resolution_m or (None, None), (table.window, table.window)))
