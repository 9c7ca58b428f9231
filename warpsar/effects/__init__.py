"""Effects a scene may declare beyond single bounce: one file each, listed here by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.errors import InputError

if TYPE_CHECKING:
    from warpsar.effects.base import Effect, Parameter
    from warpsar.render import DeclaredEffect
    from warpsar.scene import Scene, View

# In the order in which effects of one stage act. A new effect is a file and its name here.
NAMES: tuple[str, ...] = ()


def get(name: str) -> Effect:
    """The effect called `name`; each module `warpsar.effects.<name>` holds it as `EFFECT`."""
    effect: Effect = import_module(f"warpsar.effects.{name}").EFFECT
    return effect


def validate(name: str, table: Any, where: str) -> dict[str, Any]:
    """The table `[effects.<name>]` with defaults filled in; `where` names file and key in the refusal (InputError)."""
    if name not in NAMES:
        raise InputError(f"{where}: found {name!r}; allowed are {', '.join(NAMES) or 'no effects yet'}")
    effect = get(name)
    if not isinstance(table, dict):
        raise InputError(f"{where}: found {table!r}; allowed is a table")
    parameters = {p.name: p for p in effect.parameters}
    settings = {s.name: s for s in effect.settings}
    for key, value in table.items():
        at = f"{where}.{key}"
        if key in parameters:
            p = parameters[key]
            values = value.values() if p.per_view and isinstance(value, dict) else [value]
            for one in values:
                number = isinstance(one, int | float) and not isinstance(one, bool)
                if not number or not (math.isnan(p.neutral) or math.isfinite(one) or one == p.neutral):
                    raise InputError(f"{at}: found {one!r}; allowed is a number [{p.unit}]")
                if not p.low <= one <= p.high:
                    raise InputError(f"{at}: found {one!r}; allowed is {p.low:g} to {p.high:g} {p.unit}")
        elif key in settings:
            if value not in settings[key].allowed:
                raise InputError(f"{at}: found {value!r}; allowed is one of {list(settings[key].allowed)}")
        else:
            raise InputError(f"{at}: unknown key; allowed are {', '.join([*parameters, *settings])}")
    # Parameters stay as stated: a fit moves those and no others. Settings get their defaults.
    return {**table, **{s.name: table.get(s.name, s.default) for s in effect.settings}}


def declared(scene: Scene, view: View, *, neutral: bool = False) -> list[DeclaredEffect]:
    """The scene's effects with their values in `view`, in the order in which they act.

    Those at their neutral values are left out unless `neutral` asks for them (a fit may start there).
    """
    from warpsar.render import DeclaredEffect

    found = []
    for name in NAMES:
        if name not in scene.effects:
            continue
        effect, table = get(name), scene.effects[name]
        values = [value_in(view, p, table) for p in effect.parameters]
        if not neutral and all(v == p.neutral for v, p in zip(values, effect.parameters, strict=True)):
            continue
        settings = {s.name: table[s.name] for s in effect.settings}
        found.append(DeclaredEffect(effect, np.array(values, float), settings))
    return found


def value_in(view: View, parameter: Parameter, table: Mapping[str, Any]) -> float:
    """What `table` says of a parameter in one view; its neutral value where it says nothing."""
    value = table.get(parameter.name, parameter.neutral)
    return float(value.get(view.name, parameter.neutral) if isinstance(value, Mapping) else value)
