"""Which parameters of a scene its images have derivatives to, and where they stand among what is rendered."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.parameters.tree import Parameters
from warpsar.scene.scene import Scene
from warpsar.surface.surface import Block, Surface
from warpsar.surface.tables import Tables
from warpsar.world import sigma0_table
from warpsar.world.models import TABLE, TERM
from warpsar.world.world import World

VERTICES = "mesh.vertices"
STEP = 1e-5  # of a number's own unit, for d vertices / d number: their error is then under 1e-9


class GeometryParameters:
    """The parameters of a scene's geometry among those of a renderer, and the mesh that they make.

    `parameters`: what the objects' `learn` names, such as "objects.tower.heading_deg", or "mesh.vertices" [m], shape
    (n, 3). None of them: rays stay where they are.
    """

    def __init__(self, scene: Scene, vertices: bool) -> None:
        self._scene = scene
        self.parameters = {name: one for name, one in scene.parameters.items() if one.root == "objects" and one.freed}
        if vertices and self.parameters:
            raise InputError(
                f"vertices: found objects with `learn` ({', '.join(self.parameters)}); free these or the vertices"
            )
        if vertices:
            self.parameters[VERTICES] = scene.parameters[VERTICES]
        if self.parameters:
            _refuse_without_derivative(scene)

    def scene_at(self, values: Mapping[str, NDArray[np.float64]]) -> Scene:
        """The scene with the `values` of these parameters. Raises InputError for a plate that would change its kind."""
        return at(self._scene, {self.parameters[name]: value for name, value in values.items()})

    def pulled(
        self, values: Mapping[str, NDArray[np.float64]], to_vertices: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Gradients to the parameters at `values` from those to the vertices, (n, 3). A size of 0 is held."""
        if VERTICES in self.parameters:
            return {VERTICES: to_vertices}
        found = {}
        for name, parameter in self.parameters.items():
            gradient = np.zeros(parameter.shape)
            for place in np.ndindex(parameter.shape):
                if parameter.key == "size_m" and parameter.value[place] == 0.0:
                    continue
                along = np.zeros(parameter.shape)
                along[place] = 1.0
                gradient[place] = np.sum(to_vertices * self.displacement(values, {name: along}))
            found[name] = gradient
        return found

    def displacement(
        self, values: Mapping[str, NDArray[np.float64]], along: Mapping[str, NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """How the vertices move, (n, 3) [m], per unit of a direction among the parameters."""
        if VERTICES in along:
            return np.asarray(along[VERTICES], float)
        ends = [
            self.scene_at({**values, **{name: values[name] + sign * STEP * along[name] for name in along}})
            for sign in (1.0, -1.0)
        ]
        return np.asarray((ends[0].mesh.vertices - ends[1].mesh.vertices) / (2.0 * STEP))


def _refuse_without_derivative(scene: Scene) -> None:
    """Raise InputError for what makes an image that has no derivative to where its surfaces lie, or none yet."""
    why = None
    for view in scene.views:
        if scene.slant_range_m(view) is not None:
            why = f"view {view.name}, which has a track ([radar] slant_range_m); a plane wave has one"
    for name, material in scene.materials.items():
        if material.layout != "uniform":
            why = f'materials.{name}, whose layout is "{material.layout}"; a uniform one has one'
    for name in scene.effects:
        effect = get(name)
        if effect.stage != "image" and not effect.by_incidence:
            why = f"effects.{name}, which looks where surfaces lie; effects on the whole image have one"
    if why is not None:
        raise InputError(f"{scene.name}: a derivative to poses, sizes or vertices is not there beside {why}")


@dataclass(frozen=True, eq=False, kw_only=True)
class RenderParameter(Parameter):
    """A parameter of a renderer: one of the scene's, and where it stands on the device."""

    block: Block | None = field(default=None, repr=False)
    """Of a surface: its nodes."""
    index: int | None = field(default=None, repr=False)
    """Of an effect: its place in the effect's array of values."""
    zero_sum: bool = field(default=False, repr=False)
    """Of an effect: whether only differences from the mean over the views act."""
    column: NDArray[np.int64] | None = field(default=None, repr=False)
    """Of a table: where its values stand among those of all tables, (rows, polarizations that it gives)."""

    @property
    def moves(self) -> bool:
        """Whether it is of the geometry: surfaces, silhouettes and shadows move with it."""
        return self.root in ("objects", "mesh")


def render_parameters(
    scene: Scene, surface: Surface, tables: Tables | None, moves: Collection[str]
) -> Parameters[RenderParameter]:
    """All that may change: what the materials' `learn` names, what the effects' tables state, and what `moves`."""
    found: dict[str, RenderParameter] = {}
    for name, one in scene.parameters.items():
        place: dict[str, Any] = {}
        if one.layout == "table" and one.key != TABLE:
            continue
        if one.root == "effects":
            its = get(one.owner).parameter(one.key)
            index = get(one.owner).parameters.index(its)
            if its.per_material:  # it stands last, with a value for each of the mesh's materials
                index += scene.mesh.materials.index(str(one.entry))
            place = {"index": index, "zero_sum": its.zero_sum}
        elif one.key == TABLE and one.freed:
            assert tables is not None
            place = {"column": _column(surface, tables, one, scene)}
        elif one.root == "materials" and one.freed and "power" in one.derivatives:
            assert one.fit_bounds is not None
            low, high = one.fit_bounds
            place = {"block": surface.block(one.owner, one.key), "low": low, "high": high}
        elif name not in moves:
            continue
        found[name] = RenderParameter(**{each.name: getattr(one, each.name) for each in fields(one)} | place)
    return Parameters(found)


def learned_tables(world: World) -> dict[str, Path]:
    """The tables that `learn` names, by material."""
    return {name: one.sigma0 for name, one in world.materials.items() if TABLE in one.learn and one.sigma0 is not None}


def _column(surface: Surface, tables: Tables, one: Parameter, world: World) -> NDArray[np.int64]:
    rows, (_, width) = tables.rows.numpy(), tables.sigma0_db.shape
    first, count = rows[surface.materials.index(one.owner)]
    given = sigma0_table.read(learned_tables(world)[one.owner])
    return np.arange(first, first + count)[:, None] * width + np.array(given.filled(str(one.entry)))


def known_name(scene: Scene, known: Parameters[RenderParameter], name: str) -> str:
    """The name of a parameter among `known`. Raises InputError, which says why no derivative can be taken to it."""
    try:
        return known.named(name)
    except KeyError:
        pass
    try:
        one = scene.parameters[name]
    except KeyError:
        raise InputError(f"{name}: {_no_parameter(scene, known, name)}") from None
    if one.root == "mesh":
        raise InputError(f"{name}: are held; renderer(scene, vertices=True) frees them")
    if one.key == TERM:
        raise InputError(f"{name}: is trained by learn alone")
    if "power" not in one.derivatives:
        raise InputError(f"{name}: images of power have no derivative to it")
    learn: tuple[str, ...] = ()
    if one.root == "materials":
        learn = scene.materials[one.owner].learn
    elif one.root == "objects":
        learn = next(each for each in scene.objects if each.label == one.owner).learn
    whose = f"{one.root}.{one.owner}.learn"
    named = ", ".join(learn) or "nothing"
    raise InputError(f"{name}: is held: {whose} names {named}; only what it names has a derivative")


def _no_parameter(scene: Scene, known: Parameters[RenderParameter], name: str) -> str:
    """Why a name is none of a parameter."""
    first, _, key = name.removeprefix("effects.").partition(".")
    key = key.partition("[")[0]
    if first in scene.effects:
        parameter = get(first).parameter(key)  # refuses settings, and what is no parameter at all
        if parameter.name not in scene.effects[first]:
            return f"effects.{first} does not state it; state it to take a derivative to it"
    return f"found no such parameter; must be one of {', '.join(known) or 'none: nothing may change'}"
