"""The effects by name, and the effects that a scene declares. A file in this folder is an effect."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from warpsar.effects.base.effect import STAGES, DeclaredEffect, Effect
from warpsar.effects.base.fitted import FITTED_KEYS, is_fitted, refuse_fitted_keys
from warpsar.effects.base.parameter import EffectParameter, Setting
from warpsar.effects.base.phase import Response
from warpsar.errors import InputError, did_you_mean, shown
from warpsar.models import registry as models
from warpsar.models.base.model import DEFAULT
from warpsar.runtime.plugins import names_in
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of


@cache
def _files() -> frozenset[str]:
    """The modules of this folder that are effects: all but this one."""
    return frozenset(names_in(__package__))


@cache
def names() -> tuple[str, ...]:
    """All effects, in the order in which they act: stage after stage, and within a stage by their `order`."""
    return tuple(sorted(_files(), key=lambda name: (STAGES.index(get(name).stage), get(name).order)))


@cache
def get(name: str) -> Effect:
    """The effect called `name`; each module `warpsar.effects.<name>` holds it as `EFFECT`."""
    effect: Effect = import_module(f"warpsar.effects.{name}").EFFECT
    return effect


@cache
def refused_with(model: str) -> tuple[str, ...]:
    """The effects that a material with this backscatter model does not take."""
    missing = set() if model == DEFAULT else {"default"}
    if not models.get(model).of_surface:
        missing.add("eps_r")
    return tuple(name for name in names() if get(name).of_surfaces_with in missing)


def validate(name: str, table: Any, where: str, views: Collection[str] | None = None) -> dict[str, Any]:
    """The table `[effects.<name>]` with default settings filled in.

    `where` names file and key in an error. `views` are the view names that tables of per-view values may use; None
    leaves this to `check`. Raises InputError.
    """
    if name not in _files():
        raise InputError(f"{where}: found {name!r}; allowed are {', '.join(names())}{did_you_mean(name, names())}")
    effect = get(name)
    if not isinstance(table, dict):
        raise InputError(f"{where}: found {shown(table)}; allowed is a table")
    parameters = {p.name: p for p in effect.parameters}
    settings = {s.name: s for s in effect.settings}
    for key, value in table.items():
        at = f"{where}.{key}"
        if key in parameters:
            for place, one in _entries(at, value, parameters[key].keyed_by, views):
                _check_number(place, one, parameters[key])
        elif key in settings:
            setting = settings[key]
            for place, one in _entries(at, value, "view" if setting.per_view else None, views):
                if not setting.accepts(one):
                    raise InputError(f"{place}: found {shown(one)}; allowed is {setting.allowed}")
        elif key not in FITTED_KEYS:
            allowed = [*parameters, *settings, *FITTED_KEYS]
            raise InputError(f"{at}: unknown key; allowed are {', '.join(allowed)}{did_you_mean(key, allowed)}")
    refuse_fitted_keys(table, parameters, where)
    _refuse_nothing(effect, table, where)
    for key, known in table.get("tolerance", {}).items():
        if isinstance(known, Mapping):
            at, p = f"{where}.tolerance.{key}.about", parameters[key]
            for place, one in _entries(at, known["about"], p.keyed_by, views):
                _check_number(place, one, p)
    # Parameters stay as stated: a fit moves those and no others (`is_fitted`). Settings get their defaults, if any.
    chosen = {s.name: table.get(s.name, s.default) for s in effect.settings}
    return {**table, **{name: value for name, value in chosen.items() if value is not None}}


def _refuse_nothing(effect: Effect, table: Mapping[str, Any], where: str) -> None:
    """Raise InputError for a table that says nothing by which the effect is there, not even a neutral value."""
    needed = effect.needed()
    if needed is not None and not any(p.name in table for p in needed):
        found = ", ".join(table) or "no key"
        keys = " or ".join(p.name for p in needed)
        raise InputError(f"{where}: found {found}; without {keys} it has no effect: state one, or leave the table out")


def _entries(at: str, value: Any, keyed_by: str | None, views: Collection[str] | None) -> list[tuple[str, Any]]:
    """The values at a key, each with its place: one value, or one for each view or material that is named."""
    if keyed_by is None:
        return [(at, value)]
    if not isinstance(value, dict):
        raise InputError(f"{at}: found {shown(value)}; allowed is a table of {keyed_by} names and values")
    for name in value:
        if keyed_by == "view" and views is not None and name not in views:
            raise InputError(f"{at}: found {name!r}; allowed are the views {', '.join(views)}")
    return [(f"{at}.{name}", one) for name, one in value.items()]


def _check_number(at: str, value: Any, p: EffectParameter) -> None:
    unit = "" if p.unit == "1" else f" {p.unit}"
    number = isinstance(value, int | float) and not isinstance(value, bool)
    # abs, not isfinite: a whole number may be too long for a float.
    if not number or not (abs(value) < math.inf or value == p.neutral):
        raise InputError(f"{at}: found {shown(value)}; allowed is a number{f' [{p.unit}]' if unit else ''}")
    if not p.low <= value <= p.high:
        raise InputError(f"{at}: found {shown(value)}; allowed is {p.low:g} to {p.high:g}{unit}")


def check(scene: World) -> None:
    """Raises InputError where an effect names views that the scene lacks, or belongs to another kind of scene."""
    views = [view.name for view in scene.views]
    for name, table in scene.effects.items():
        where = f"{scene.name}: effects.{name}"
        validate(name, table, where, views)
        for p in get(name).parameters:
            unknown = [m for m in table.get(p.name, ()) if m not in scene.mesh.materials] if p.per_material else []
            if unknown:
                allowed = ", ".join(scene.mesh.materials)
                raise InputError(f"{where}.{p.name}: found {', '.join(unknown)}; allowed are the materials {allowed}")
        problem = get(name).check(scene, table)
        if problem is not None:
            raise InputError(f"{where}{problem}")


def declared(scene: World, view: View, *, neutral: bool = False) -> list[DeclaredEffect]:
    """The scene's effects with their values in `view`, in the order in which they act.

    Effects at their neutral values are left out, unless `neutral` asks for them: a fit may start there. Raises
    InputError as `check` does.
    """
    check(scene)
    found = []
    for name in names() if scene.effects else ():
        if name not in scene.effects:
            continue
        effect, table = get(name), scene.effects[name]
        if not neutral and not _acts(scene, view, effect):
            continue
        settings = {s.name: setting_in(view, s, table) for s in effect.settings}
        found.append(DeclaredEffect(effect, values_in(scene, view, effect, table), settings))
    return found


def shift_m(scene: World, view: View) -> np.ndarray:
    """Range and azimuth [m] by which the scene's effects move the image of a view, shape (2,)."""
    axes = geometry_of(scene, view)
    return sum((one.effect.shift_m(one.values, axes) for one in declared(scene, view)), np.zeros(2))


def acting(scene: World) -> list[str]:
    """The declared effects that are not neutral in every view, in the order in which they act.

    Raises InputError as `check` does.
    """
    check(scene)
    some = [name for name in names() if name in scene.effects] if scene.effects else []
    return [name for name in some if any(_acts(scene, view, get(name)) for view in scene.views)]


def _acts(scene: World, view: View, effect: Effect) -> bool:
    """Whether a value in this view is not neutral. Those per material say nothing alone."""
    table = scene.effects[effect.name]
    return any(p.brings_it and _values_of(scene, view, p, table) != [p.neutral] for p in effect.parameters)


def values_in(scene: World, view: View, effect: Effect, table: Mapping[str, Any]) -> np.ndarray:
    """The values of all parameters in one view, float64: one each, or one for each of the mesh's materials."""
    return np.concatenate([_values_of(scene, view, p, table) for p in effect.parameters])


def _values_of(scene: World, view: View, parameter: EffectParameter, table: Mapping[str, Any]) -> list[float]:
    if parameter.per_material:
        stated = table.get(parameter.name, {})
        return [float(stated.get(material, parameter.default)) for material in scene.mesh.materials]
    return [value_in(view, parameter, table, scene.views)]


def value_in(view: View, parameter: EffectParameter, table: Mapping[str, Any], views: Collection[View] = ()) -> float:
    """The value of a parameter in one view: from `table`, or its default where `table` says nothing.

    A `zero_sum` parameter has its mean over `views` subtracted.
    """
    value = table.get(parameter.name, parameter.default)
    if not isinstance(value, Mapping):
        return float(value)
    mean = 0.0
    if parameter.zero_sum and views:
        mean = sum(value.get(v.name, parameter.default) for v in views) / len(views)
    return float(value.get(view.name, parameter.default)) - mean


def fitted_effects(effects: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The effects of a scene of which a fit moves a parameter."""
    return [name for name, table in effects.items() if any(is_fitted(p.name, table) for p in get(name).parameters)]


def effects_at_edges(effects: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """The effects of a scene that a fit moves and edges tell (`Effect.at_edges`)."""
    return [name for name in fitted_effects(effects) if get(name).at_edges]


def sets_all_positions(world: World) -> str | None:
    """The effect by which a fit shifts every train view by itself, so that images say nothing of places (`Effect.
    sets_positions`); None where a view that its table does not name holds them."""
    train = {view.name for view in world.views if view.role == "train"}
    for name in fitted_effects(world.effects):
        stated = [set(world.effects[name].get(p.name, ())) for p in get(name).parameters if p.per_view]
        if get(name).sets_positions and any(train <= one for one in stated):
            return name
    return None


def held_by(effects: Mapping[str, Mapping[str, Any]]) -> dict[str, str]:
    """The effects of a scene that a fit holds, each with the one that it moves and that can do all they do."""
    return {one: name for name in fitted_effects(effects) for one in get(name).contains if one in effects}


def response_of(effects: Iterable[DeclaredEffect]) -> Response:
    """What effects ask of a system's response; what acts later is asked last, and counts."""
    whole = Response()
    for one in effects:
        whole = one.effect.response(one.values, one.settings).over(whole)
    return whole


def setting_in(view: View, setting: Setting, table: Mapping[str, Any]) -> Any:
    """The value of a setting in one view: from `table`, or its default. None for a view that is not named."""
    value = table.get(setting.name, setting.default)
    return value.get(view.name) if setting.per_view else value
