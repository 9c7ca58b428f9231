"""All parameters of a scene, by name."""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property, partial
from typing import Any, Generic, TypeVar

import numpy as np

from warpsar.effects.base.fitted import is_fitted
from warpsar.effects.registry import get
from warpsar.models.base.parameters import EPS_R
from warpsar.parameters.parameter import Layout, Parameter, Product
from warpsar.surface.surface import Kind, kinds_of
from warpsar.world import scattering_term, sigma0_table
from warpsar.world.models import TABLE, TERM
from warpsar.world.objects.table import CABIN, KEYS, VEHICLES, Object
from warpsar.world.objects.table import LIMITS as OBJECT_LIMITS
from warpsar.world.pixels import Pixels
from warpsar.world.scattering_term import LARGEST_WEIGHT
from warpsar.world.sigma0_table import LARGEST_DB
from warpsar.world.tables import LARGEST_OF_LAYER, LOSS, Grid, Material, Radar, View, layer_of
from warpsar.world.tolerance import known_sd, known_value
from warpsar.world.transform import Transform
from warpsar.world.world import World

P = TypeVar("P", bound=Parameter)

POWER: frozenset[Product] = frozenset({"power"})
AMPLITUDE: frozenset[Product] = frozenset({"amplitude"})
BOTH = POWER | AMPLITUDE
OBJECT_UNITS = {"position": "m", "size": "m", "heading": "deg", "pitch": "deg", "roll": "deg"}
OBJECT_ENDS = {"position": (-1e8, 1e8), "scale": (1e-6, 1e6), "size": (0.0, 1e6), **OBJECT_LIMITS}
TURN = (-360.0, 360.0)
OBJECT_REACH = {"position": 50.0, "scale": 4.0, "size": 4.0, "heading": 180.0, "pitch": 180.0, "roll": 180.0}
"""How far a fit moves and turns an object [m, deg], and the factor by which it changes its size."""
VIEW_REACH = 20.0
"""How far a fit turns views [deg]."""
SPACING_REACH = 1.25
"""Factor by which a fit changes a pixel spacing."""
STEEPEST = (1.0, 89.0)
"""Least and largest incidence of a fit [deg]."""
POSE = ("position", "heading", "pitch", "roll")
THICKNESS, FILLING, LOSSES = (1e-7, 100.0), (0.01, LARGEST_OF_LAYER), (1e-4, LARGEST_OF_LAYER)
"""Ends of a fit of a layer: its thickness [m], a permittivity or permeability, and the loss of one."""
CONTRAST = (EPS_R.low, EPS_R.high)
"""Ends of a fit of a permittivity over 1: those of a surface."""


class Parameters(Mapping[str, P], Generic[P]):
    """The parameters of a scene by dotted name. An older name ("soil.eps_r", "vertices") is understood, with a warning.

    >>> scene.parameters["views.north.azimuth_deg"].value
    """

    def __init__(self, found: Mapping[str, P]) -> None:
        self._found = dict(found)

    def __getitem__(self, name: str) -> P:
        return self._found[self.named(name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def __contains__(self, name: object) -> bool:
        return name in self._found

    def named(self, name: str) -> str:
        """The dotted name of a parameter that may be called by its old one. Raises KeyError for what is none."""
        if name not in self._found and name in self.old_names:
            new = self.old_names[name]
            warnings.warn(f"{name}: is called {new} now", FutureWarning, stacklevel=_outside())
            return new
        if name not in self._found:
            raise KeyError(name)
        return name

    @cached_property
    def old_names(self) -> dict[str, str]:
        """What each older name is called now."""
        return {one.old_name: name for name, one in reversed(self._found.items())}


class Named(dict[str, Any]):
    """Values by name of a parameter, which an older name finds too, with a warning."""

    def __init__(self, parameters: Parameters[Any], values: Mapping[str, Any]) -> None:
        super().__init__(values)
        self._parameters = parameters

    def __missing__(self, name: str) -> Any:
        new = self._parameters.named(name)  # raises KeyError
        if new not in self:
            raise KeyError(name)
        return self[new]


def parameters_of(world: World) -> Parameters[Parameter]:
    """All that a scene has."""
    every = [*_of_materials(world), *_of_effects(world), *_of_objects(world), *_of_views(world)]
    return Parameters({one.name: one for one in [*every, *_of_image(world), _vertices(world)]})


def _outside() -> int:
    """How many frames up the caller's own code is, for a warning to point at it."""
    frame, level = sys._getframe(2), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith("warpsar."):
        frame, level = frame.f_back, level + 1
    return level


def _of_materials(world: World) -> Iterator[Parameter]:
    for name in world.mesh.materials:
        material = world.materials[name]
        for kind in kinds_of(material.model):
            if getattr(material, kind.key) is not None:
                yield _surface(world, name, material, kind)
        if material.thickness_m is not None:
            read = partial(getattr, material, "thickness_m")
            yield _of_a_stack(name, material, "thickness_m", read)
        for called in material.stacked if material.layers else ():
            number, key = layer_of(called)
            yield _of_a_stack(name, material, called, partial(material.layers[number].number, key))
        if material.sigma0 is not None:
            table = sigma0_table.read(material.sigma0)
            for polarization, column in table.sigma0_db.items():
                yield Parameter(
                    *("materials", name, TABLE, "dB", -LARGEST_DB, LARGEST_DB, partial(np.asarray, column)),
                    entry=polarization,
                    layout="table",
                    freed=TABLE in material.learn,
                    prior_root=table.prior_root,
                    derivatives=POWER,
                )
        if material.learned_term is not None:
            term = scattering_term.read(material.learned_term)
            for polarization, weights in term.weights.items():
                yield Parameter(
                    *("materials", name, TERM, "1", -LARGEST_WEIGHT, LARGEST_WEIGHT, partial(np.asarray, weights)),
                    entry=polarization,
                    layout="table",
                    freed=TERM in material.learn,
                    prior_root=term.prior_root,
                    derivatives=POWER,
                )


def _of_a_stack(name: str, material: Material, key: str, read: Callable[[], float]) -> Parameter:
    """A value of the layers of a material. A permittivity over 1 has the coordinate of a surface's."""
    thick = key.endswith("thickness_m")
    unit, high, bounds = ("m", 100.0, THICKNESS) if thick else ("1", LARGEST_OF_LAYER, FILLING)
    bounds = LOSSES if key.endswith(LOSS) else bounds
    contrast = key.endswith("eps_r") and read() >= CONTRAST[0]
    return Parameter(
        *("materials", name, key, unit, 0.0, high, read),
        transform=Transform("contrast" if contrast else "log"),
        fit_bounds=CONTRAST if contrast else bounds,
        freed=key in material.learn,
        derivatives=AMPLITUDE,
    )


def _surface(world: World, name: str, material: Material, kind: Kind) -> Parameter:
    stated = getattr(material, kind.key)
    field = isinstance(stated, str | Pixels)
    layout: Layout = "number" if not field else "vertex" if material.layout == "vertex" else "texture"
    number = stated[0] if isinstance(stated, tuple) else stated
    tolerance = dict[Any, Any](material.tolerance).get(kind.key)
    known: tuple[tuple[float, float], ...] = ()
    if tolerance is not None:
        about = known_value(tolerance, float(number))
        known = ((about, known_sd(tolerance, about)),)

    def own_vertices() -> slice:
        corners = world.mesh.faces[world.mesh.face_material == world.mesh.materials.index(name)]
        return slice(int(corners.min()), int(corners.max()) + 1)

    return Parameter(
        *("materials", name, kind.key, "m" if kind.key.endswith("_m") else "1", kind.low_limit, kind.high_limit),
        partial(world.field, name, kind.key) if field else partial(float, number),
        layout=layout,
        transform=kind.transform,
        fit_bounds=(kind.low, kind.high),
        freed=kind.key in material.learn,
        known=known,
        span=own_vertices if layout == "vertex" else None,
        derivatives=POWER if kind.own or kind.key == "specular_fraction" else BOTH,
    )


def _of_effects(world: World) -> Iterator[Parameter]:
    """What the tables of the effects state."""
    for name, table in world.effects.items():
        for setting in get(name).settings:
            for number, column in enumerate(setting.columns):
                rows = table.get(setting.name) or []
                read = partial(np.array, [row[number] for row in rows])
                ends = (column.unit, column.low, column.high)
                yield Parameter("effects", name, setting.name, *ends, read, entry=column.name, layout="table")
        for its in get(name).parameters:
            stated = table.get(its.name)
            if stated is None:
                continue
            tolerance = table.get("tolerance", {}).get(its.name)
            for entry, value in stated.items() if isinstance(stated, Mapping) else [(None, stated)]:
                known: tuple[tuple[float, float], ...] = ()
                if tolerance is not None:
                    about = known_value(tolerance, float(value), entry)
                    known = ((about, known_sd(tolerance, about)),)
                layout: Layout = "number" if entry is None else "per view" if its.per_view else "per material"
                yield Parameter(
                    *("effects", name, its.name, its.unit, its.low, its.high, partial(float, value)),
                    entry=entry,
                    layout=layout,
                    transform=its.transform,
                    fit_bounds=its.fit_bounds,
                    freed=is_fitted(its.name, table),
                    known=known,
                    derivatives=POWER,
                )


def _of_objects(world: World) -> Iterator[Parameter]:
    for one in world.objects:
        for word, key in KEYS.items():
            vehicle = one.primitive in VEHICLES
            of_kind = {"size": one.size_m is not None, "cabin": vehicle, "side_curvature": vehicle}
            if not of_kind.get(word, True):
                continue
            values = object_values(one, word)
            known = one.known_of(key, values) if key in one.tolerance else ()
            yield Parameter(
                *("objects", one.label, key, OBJECT_UNITS.get(word, "1"), *OBJECT_ENDS.get(word, TURN)),
                partial(np.array, values if len(values) > 1 else values[0]),
                layout="vector" if len(values) > 1 else "number",
                transform=Transform("log" if word in ("scale", "size") else "linear"),
                fit_bounds=OBJECT_LIMITS.get(word),
                reach=OBJECT_REACH.get(word, math.inf),
                freed=word in one.learn,
                known=known,
                derivatives=BOTH if word in POSE else POWER,
            )


def object_values(one: Object, word: str) -> tuple[float, ...]:
    """The value, or the three values, of the key that a word of an object's `learn` frees."""
    value = getattr(one, KEYS[word])
    if value is None:
        value = CABIN[str(one.primitive)] if word == "cabin" else 0.0
    return tuple(value) if isinstance(value, tuple) else (float(value),)


def _of_views(world: World) -> Iterator[Parameter]:
    log = Transform("log")
    for key in ("azimuth_deg", "incidence_deg"):  # of all views by one number, from where they stand
        known = _known(world.radar, key, 0.0)
        yield Parameter(
            *("views", "", key, "deg", *TURN, float),
            fit_bounds=TURN,
            reach=VIEW_REACH,
            freed=key in world.radar.learn,
            known=known,
        )
    for view in world.views:
        read = partial(partial, getattr, view)
        for key, low, high, reach in (("azimuth_deg", -360.0, 360.0, TURN), ("incidence_deg", 0.0, 90.0, STEEPEST)):
            yield Parameter(
                *("views", view.name, key, "deg", low, high, read(key)),
                fit_bounds=reach,
                reach=VIEW_REACH,
                freed=key in view.learn,
                known=_known(view, key, getattr(view, key)),
            )
        if view.slant_range_m is not None:
            yield Parameter("views", view.name, "slant_range_m", "m", 0.0, 1e9, read("slant_range_m"), transform=log)
        if view.looks is not None:
            yield Parameter("views", view.name, "looks", "1", 0.0, 1e9, read("looks"), transform=log)
        if view.texture is not None:
            yield Parameter("views", view.name, "texture", "1", 0.05, 1e6, read("texture"), transform=log)


def _of_image(world: World) -> Iterator[Parameter]:
    for key in ("range_spacing_m", "azimuth_spacing_m"):
        yield Parameter(
            *("image", "", key, "m", 1e-5, 1e5, partial(getattr, world.grid, key)),
            transform=Transform("log"),
            reach=SPACING_REACH,
            freed=key in world.grid.learn,
            known=_known(world.grid, key, getattr(world.grid, key)),
        )


def _known(table: Radar | View | Grid, key: str, stated: float) -> tuple[tuple[float, float], ...]:
    """What the tolerance of a table that has one says of a key."""
    tolerance = dict[Any, Any](table.tolerance).get(key)
    if tolerance is None:
        return ()
    about = known_value(tolerance, stated)
    return ((about, known_sd(tolerance, about)),)


def _vertices(world: World) -> Parameter:
    read = partial(getattr, world.mesh, "vertices")
    return Parameter("mesh", "", "vertices", "m", -1e8, 1e8, read, layout="vertex", derivatives=BOTH)
