"""What of a scene may change, by name, in the units of scene.toml, and where it stands among what is rendered."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.effects.base.parameter import Parameter
from warpsar.effects.registry import get
from warpsar.errors import InputError, shown
from warpsar.surface.surface import Block, Surface
from warpsar.surface.tables import Tables
from warpsar.world import sigma0_table
from warpsar.world.models import TABLE
from warpsar.world.objects.table import KEYS
from warpsar.world.sigma0_table import LARGEST_DB
from warpsar.world.world import World


@dataclass(frozen=True, eq=False)
class RenderParameter:
    """One parameter of a renderer.

    Surfaces are called "material.key", such as "ground.eps_r", and columns of a table "material.sigma0[HH]". Effects
    are called "effect.key", such as "noise_floor.level", with the view where each has its own:
    "registration.range_m[north]". Objects are called "object.key", such as "tower.heading_deg", and the mesh's vertices
    "mesh.vertices".
    """

    name: str
    value: NDArray[np.float64]
    """As the scene declares it, in the units of scene.toml. Shape () of a number, (n,) over the mesh's vertices for the
    layout "vertex", (rows, cols) for "texture", (rows,) of a table's column [dB]. Of eps' - j eps'' it is eps', of
    (lx, ly) it is lx."""
    low: float
    """The least that it may be."""
    high: float
    """The most that it may be."""
    block: Block | None = field(default=None, repr=False)
    """Of a surface: its nodes."""
    effect: tuple[str, Parameter, int, str | None] | None = field(default=None, repr=False)
    """Of an effect: its name, the parameter, its place in the effect's array, and the view where it is per view."""
    column: NDArray[np.int64] | None = field(default=None, repr=False)
    """Of a table: where its values stand among those of all tables, (rows, polarizations that it gives)."""
    moves: bool = False
    """Of the geometry: surfaces, silhouettes and shadows move with it."""

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    @property
    def used(self) -> slice:
        """Of a vertex field the vertices that are its own; the others are never looked at."""
        if self.block is None or self.block.layout != "vertex":
            return slice(None)
        return slice(self.block.first_vertex, self.block.first_vertex + self.block.size)

    def checked(self, value: Any) -> NDArray[np.float64]:
        """A value that may stand here, float64. Raises InputError for a shape or a number that may not."""
        try:
            found = np.asarray(value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.name}: found {shown(value)}; must be numbers of shape {self.shape}") from error
        if found.shape != self.shape:
            raise InputError(f"{self.name}: found shape {found.shape}; must be {self.shape}")
        inside = np.atleast_1d(found)[self.used]
        bad = inside[~((inside >= self.low) & (inside <= self.high))]  # NaN is within nothing
        if bad.size:
            raise InputError(f"{self.name}: found {bad.flat[0]:g}; must be from {self.low:g} to {self.high:g}")
        return found


def parameters_of(world: World, surface: Surface, tables: Tables | None) -> dict[str, RenderParameter]:
    """All that may change: what the materials' `learn` names, and what the tables of the effects state."""
    found = []
    for block in surface.blocks:
        if block.learn:
            name, kind = f"{block.material}.{block.kind.key}", block.kind
            found.append(RenderParameter(name, _declared(world, surface, block), kind.low, kind.high, block=block))
    if tables is not None:
        found += _columns(world, surface, tables)
    for effect, table in world.effects.items():
        for index, parameter in enumerate(get(effect).parameters):
            stated = table.get(parameter.name)
            views = stated if isinstance(stated, Mapping) else {} if stated is None else {None: stated}
            for view, value in views.items():
                name = f"{effect}.{parameter.name}" + ("" if view is None else f"[{view}]")
                ends = parameter.low, parameter.high
                place = (effect, parameter, index, view)
                found.append(RenderParameter(name, np.array(float(value)), *ends, effect=place))
    return {parameter.name: parameter for parameter in found}


def learned_tables(world: World) -> dict[str, Path]:
    """The tables that `learn` names, by material."""
    return {name: one.sigma0 for name, one in world.materials.items() if TABLE in one.learn and one.sigma0 is not None}


def _columns(world: World, surface: Surface, tables: Tables) -> Iterator[RenderParameter]:
    rows, (_, width) = tables.rows.numpy(), tables.sigma0_db.shape
    for name, file in learned_tables(world).items():
        first, count = rows[surface.materials.index(name)]
        given = sigma0_table.read(file)
        for key, values in given.sigma0_db.items():
            places = np.arange(first, first + count)[:, None] * width + np.array(given.filled(key))
            yield RenderParameter(f"{name}.{TABLE}[{key}]", values, -LARGEST_DB, LARGEST_DB, column=places)


def _declared(world: World, surface: Surface, block: Block) -> NDArray[np.float64]:
    key = block.kind.key
    if block.layout == "uniform":
        declared = getattr(world.materials[block.material], key)
        return np.array(float(declared[0] if isinstance(declared, tuple) else declared))
    return np.array(world.field(block.material, key), float)


def refuse_unknown(world: World, known: Mapping[str, RenderParameter], name: str) -> None:
    """Raise InputError, which says why no derivative can be taken to `name`, where it is not among `known`."""
    if name in known:
        return
    first, _, key = str(name).partition(".")
    key = key.partition("[")[0]
    if first in world.effects:
        parameter = get(first).parameter(key)  # refuses settings, and what is no parameter at all
        if parameter.name not in world.effects[first]:
            raise InputError(f"{name}: effects.{first} does not state it; state it to take a derivative to it")
    material = world.materials.get(first)
    if material is not None and key in type(material).model_fields and key not in material.learn:
        learn = ", ".join(material.learn) or "nothing"
        raise InputError(f"{name}: is held: materials.{first}.learn names {learn}; only what it names has a derivative")
    labels = {one.label: one for one in world.objects}
    if first in labels and key in KEYS.values():
        learn = ", ".join(labels[first].learn) or "nothing"
        raise InputError(f"{name}: is held: learn of object {first} names {learn}; only what it names has a derivative")
    if name == "mesh.vertices":
        raise InputError(f"{name}: are held; renderer(scene, vertices=True) frees them")
    raise InputError(
        f"{name}: found no such parameter; must be one of {', '.join(known) or 'none: nothing may change'}"
    )


def coordinate(key: str, value: Any, log: Any) -> Any:
    """The learned coordinate of a surface's value (surface.py), with the `log` of whichever library the value is of."""
    if key == "eps_r":
        return log(value - 1.0)
    if key == "specular_fraction":
        return log(value) - log(1.0 - value)
    return log(value)


def slope(key: str, value: Any) -> Any:
    """d coordinate / d value."""
    if key == "eps_r":
        return 1.0 / (value - 1.0)
    if key == "specular_fraction":
        return 1.0 / (value * (1.0 - value))
    return 1.0 / value
