"""A scene with other values of its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.parameters.parameter import Parameter
from warpsar.world.pixels import Pixels
from warpsar.world.tables import layer_of
from warpsar.world.world import World, posed

W = TypeVar("W", bound=World)


def at(world: W, values: Mapping[Parameter, Any]) -> W:
    """The scene with these values, of the parameters' shapes; what is left out stays.

    Bounds are not asked here, because a difference may step over one (`Parameter.checked` asks them, and
    `Scene.with_values`). Raises InputError for a size of 0 that would become another or another that would become 0,
    and for a column of a material's table, which stands in a file.
    """
    given = {parameter: _plain(parameter, value) for parameter, value in values.items()}
    objects = list(world.objects)
    for parameter, new in given.items():
        if parameter.root == "objects":
            number = [one.label for one in objects].index(parameter.owner)
            objects[number] = objects[number].model_copy(update={parameter.key: new})
    # the bodies first: they make the mesh, on which the others work
    posed_one = posed(world, objects) if any(one.root == "objects" for one in given) else world
    others = {parameter: new for parameter, new in given.items() if parameter.root != "objects"}
    if not others:
        return posed_one
    changed: dict[str, Any] = {"mesh": posed_one.mesh, "views": list(world.views), "grid": world.grid}
    changed |= {"materials": dict(world.materials), "effects": {name: dict(t) for name, t in world.effects.items()}}
    for parameter, new in others.items():
        _set(changed, parameter, new)
    return replace(posed_one, **changed)


def _set(changed: dict[str, Any], parameter: Parameter, new: Any) -> None:
    """Put a value into what is `changed`: the mesh, the views, the grid, the materials and the effects of a scene."""
    owner, key = parameter.owner, parameter.key
    if parameter.root == "mesh":
        changed["mesh"] = replace(changed["mesh"], vertices=new)
    elif parameter.root == "image":
        rows, columns = changed["grid"].spacing_m
        spacing_m = (new, columns) if key == "range_spacing_m" else (rows, new)
        changed["grid"] = changed["grid"].model_copy(update={"spacing_m": spacing_m})
    elif parameter.root == "views" and not owner:
        changed["views"] = [_seen(view, key, getattr(view, key) + new) for view in changed["views"]]
    elif parameter.root == "views":
        number = [one.name for one in changed["views"]].index(owner)
        changed["views"][number] = _seen(changed["views"][number], key, new)
    elif parameter.root == "effects":
        table = changed["effects"][owner]
        if parameter.layout == "table":
            number = get(owner).setting(key).column(str(parameter.entry))
            rows = zip(table[key], new, strict=True)
            table[key] = [[*row[:number], float(one), *row[number + 1 :]] for row, one in rows]
            return
        table[key] = new if parameter.entry is None else {**table[key], parameter.entry: new}
    elif parameter.root == "materials":
        material = changed["materials"][owner]
        if parameter.layout == "vertex":
            mesh, name = changed["mesh"], getattr(material, key)
            whole = mesh.vertex_scalars[name].copy()  # which other materials may name, too
            whole[parameter.used] = new[parameter.used]
            changed["mesh"] = replace(mesh, vertex_scalars={**mesh.vertex_scalars, name: whole})
        else:
            changed["materials"][owner] = _covered(material, parameter, new)


def _plain(parameter: Parameter, value: Any) -> Any:
    """The value as the tables hold it: a float, a tuple, or an array of a field and of vertices."""
    given = np.asarray(value, float)
    if parameter.key == "size_m" and ((given == 0.0) != (parameter.value == 0.0)).any():
        raise InputError(
            f"{parameter.name}: found {given.tolist()}; a size of 0 must stay 0, and no other may become 0"
        )
    if given.ndim == 0:
        return float(given)
    return tuple(given.tolist()) if parameter.layout == "vector" else given


def _seen(view: Any, key: str, new: float) -> Any:
    if key != "incidence_deg":
        return view.model_copy(update={key: new})
    other = {"depression_deg": None, "grazing_deg": None}  # whichever of the three was stated
    return view.model_copy(update={"stated_incidence_deg": new, **other})


def _covered(material: Any, parameter: Parameter, new: Any) -> Any:
    if parameter.layout == "table":
        raise InputError(
            f"{parameter.name}: stands in the file {getattr(material, parameter.key)}; only a fit changes it"
        )
    if parameter.key.startswith("layers."):
        return _layered(material, parameter.key, new)
    stated = getattr(material, parameter.key)
    if parameter.layout == "texture":
        new = Pixels(np.asarray(new, np.float32))
    elif isinstance(stated, tuple):  # eps' - j eps'' keeps its loss, and (lx, ly) its ratio
        new = (new, stated[1] if parameter.key == "eps_r" else new * stated[1] / stated[0])
    return material.model_copy(update={parameter.key: new})


def _layered(material: Any, key: str, new: float) -> Any:
    """With another value of one of `layers`; in air its mirror image gets it, too."""
    number, of = layer_of(key)
    layers = list(material.layers)
    changed = layers[number].with_number(of, new)
    for each in material.alike(number):
        layers[each] = changed
    return material.model_copy(update={"layers": tuple(layers)})
