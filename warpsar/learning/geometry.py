"""What a fit may change of a scene's geometry, as one vector of metres: bodies, the views' angles, pixel spacings.

All of it moves where surfaces lie in an image. So each is moved by tracing anew, where surfaces and effects only shade
what was traced.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from warpsar.effects.registry import sets_all_positions
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import KEYS, Object
from warpsar.world.tables import Grid, Radar, View

T = TypeVar("T", Object, View, Radar, Grid)

NAMES = {
    "position_m": ("east", "north", "up"),
    "scale": ("along", "across", "upward"),
    "size_m": ("length", "width", "height"),
}
"""What the elements of a key of three are called."""
WORDS = {key: word for word, key in KEYS.items()}


@dataclass(frozen=True)
class GeometryCoordinate:
    """One number of the vector: it moves the outermost points of what it belongs to by about a metre for each metre.

    `index` is the element of a parameter of three. A value is `start` + coordinate * `slope`, or `start` *
    exp(coordinate * `slope`) where the parameter's coordinate is logarithmic (`factor`): a size, a scale, a spacing.
    Coordinates end at `bounds` [m].
    """

    parameter: Parameter
    index: int | None
    start: float
    slope: float
    bounds: tuple[float, float]

    @property
    def label(self) -> str:
        """ "car.east" of an object, else the parameter's dotted name."""
        if self.parameter.root != "objects":
            return self.parameter.name
        key = self.parameter.key
        return f"{self.parameter.owner}.{WORDS[key] if self.index is None else NAMES[key][self.index]}"

    @property
    def body(self) -> str | None:
        """The object that it belongs to."""
        return self.parameter.owner if self.parameter.root == "objects" else None

    def changes(self, view: str) -> bool:
        """Whether the image of a view changes with it."""
        return self.parameter.root != "views" or self.parameter.owner in ("", view)

    @property
    def factor(self) -> bool:
        """Whether it multiplies."""
        return self.parameter.transform.kind == "log"

    def value(self, coordinate: float) -> float:
        """The value in the parameter's unit."""
        return self.start * math.exp(coordinate * self.slope) if self.factor else self.start + coordinate * self.slope

    def per_metre(self, coordinate: float) -> float:
        """The value's derivative to the coordinate [unit / m]."""
        return self.value(coordinate) * self.slope if self.factor else self.slope


class Geometry:
    """The freed parameters of bodies, views and image; the vector p, shape (n,) [m], is 0 where the scene puts them.

    `known` says of each element about which value it is known, and to which standard deviation, in the parameter's
    unit; it is infinite without a tolerance, and what is known to 0 is no element. Positions are held where a fit
    shifts every view by itself, which can do what they do (`sets_all_positions`); `held` has a sentence for each
    object.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.coordinates: list[GeometryCoordinate] = []
        self.known: list[tuple[float, float]] = []
        self.held: list[str] = []
        holding = sets_all_positions(scene)
        for parameter in freed(scene):
            if parameter.key == "position_m" and holding is not None:
                self.held.append(f"{parameter.owner}.position: held, because {holding} shifts each view by itself")
                continue
            self._add(parameter, _radius(scene, parameter))

    def _add(self, parameter: Parameter, radius: float) -> None:
        values = np.atleast_1d(parameter.value).tolist()
        known = parameter.known or ((0.0, math.inf),) * len(values)
        ends = np.column_stack([np.atleast_1d(end) for end in parameter.fit_ends]).tolist()
        factor = parameter.transform.kind == "log"
        for index, (start, about_sd, own) in enumerate(zip(values, known, ends, strict=True)):
            if parameter.key == "size_m" and start == 0.0:
                continue  # a plate's thickness
            if about_sd[1] == 0.0:
                continue  # held by its tolerance
            slope = {"position_m": 1.0, "size_m": 2.0 / max(start, 1e-9)}.get(parameter.key, 1.0 / radius)
            slope = math.degrees(slope) if parameter.unit == "deg" else slope
            which = index if parameter.layout == "vector" else None
            low, high = ((math.log(end / start) if factor else end - start) / slope for end in own)
            self.coordinates.append(GeometryCoordinate(parameter, which, start, slope, (low, high)))
            self.known.append(about_sd)

    def shared(self, c: GeometryCoordinate) -> tuple[str, float] | None:
        """The error that a number has in common with those of other bodies: its name and its standard deviation.

        A plan that is shifted or turned moves every body of one survey alike.
        """
        body = next((one for one in self.scene.objects if one.label == c.body), None)
        of_survey = {} if body is None else {str(key): sd for key, sd in body.survey_tolerance.items()}
        if body is None or c.parameter.key not in of_survey:
            return None
        element = c.parameter.key if c.index is None else NAMES[c.parameter.key][c.index]
        return f"{body.survey}.{element}", of_survey[c.parameter.key]

    @property
    def labels(self) -> list[str]:
        return [c.label for c in self.coordinates]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        ends = np.array([c.bounds for c in self.coordinates]).reshape(-1, 2)
        return ends[:, 0].copy(), ends[:, 1].copy()

    def at(self, p: np.ndarray) -> Scene:
        """The scene with p in place."""
        values = {c.parameter: c.parameter.value.copy() for c in self.coordinates}
        for c, coordinate in zip(self.coordinates, p, strict=True):
            values[c.parameter][() if c.index is None else c.index] = c.value(float(coordinate))
        return at(self.scene, values)

    def stepped(self, scene: Scene, p: np.ndarray, step: np.ndarray) -> Scene:
        """`scene`, which has p in place, with p + `step`; the step moves bodies alone. Only those are made anew."""
        moved = {self.coordinates[k].parameter for k in np.flatnonzero(step)}
        values = {parameter: parameter.value.copy() for parameter in moved}
        for c, coordinate in zip(self.coordinates, p + step, strict=True):
            if c.parameter in moved:
                values[c.parameter][() if c.index is None else c.index] = c.value(float(coordinate))
        return at(scene, values)


def still(scene: Scene) -> Scene:
    """The scene with nothing of its geometry to learn."""
    if next(freed(scene), None) is None:
        return scene
    objects = tuple(one.model_copy(update={"learn": ()}) for one in scene.objects)
    views = [view.model_copy(update={"learn": (), "tolerance": {}}) if view.learn else view for view in scene.views]
    grid = scene.grid.model_copy(update={"learn": (), "tolerance": {}})
    radar = scene.radar.model_copy(update={"learn": (), "tolerance": {}})
    return replace(scene, objects=objects, views=views, grid=grid, radar=radar)


def with_free(scene: Scene, parameters: Sequence[str]) -> Scene:
    """The scene with nothing but these parameters of its geometry to learn, by their dotted names.

    A view has its angles in one order, whatever that of the names; all else is as the names come.
    """
    scene = still(scene)
    keys: dict[str, list[str]] = {}  # by what they are of: "objects.car", "views", "views.north", "image"
    for name in dict.fromkeys(parameters):
        owner, _, key = name.rpartition(".")
        keys.setdefault(owner, []).append(key)

    def learning(table: T, learn: Iterable[str]) -> T:
        return table.model_copy(update={"learn": tuple(learn)})

    return replace(
        scene,
        objects=tuple(
            learning(one, (WORDS[key] for key in keys.get(f"objects.{one.label}", ()))) for one in scene.objects
        ),
        views=[learning(view, sorted(keys.get(f"views.{view.name}", ()))) for view in scene.views],
        radar=learning(scene.radar, keys.get("views", ())),
        grid=learning(scene.grid, keys.get("image", ())),
    )


def freed(scene: Scene) -> Iterator[Parameter]:
    """The parameters of a scene's geometry that its file lets a fit change: bodies in the order of their `learn`."""
    if (
        scene.radar.learn
        or scene.grid.learn
        or any([*(one.learn for one in scene.objects), *(view.learn for view in scene.views)])
    ):
        parameters = scene.parameters
        for one in scene.objects:
            yield from (parameters[f"objects.{one.label}.{KEYS[word]}"] for word in one.learn)
        yield from (parameters[f"views.{key}"] for key in scene.radar.learn)
        for view in scene.views:
            yield from (parameters[f"views.{view.name}.{key}"] for key in view.learn)
        yield from (parameters[f"image.{key}"] for key in scene.grid.learn)


def _radius(scene: Scene, parameter: Parameter) -> float:
    """How far the outermost points lie from the middle [m]: of the body, of the image's side, or of its diagonal."""
    if parameter.root == "objects":
        assert scene.assembly is not None
        own = next(one for one in scene.objects if one.label == parameter.owner)
        return float(np.linalg.norm(np.ptp(scene.assembly.vertices_of(own), axis=0)) / 2.0)
    sides = np.multiply(scene.grid.shape, scene.grid.spacing_m)
    if parameter.root == "views":
        return float(np.linalg.norm(sides)) / 2.0
    return float(sides[0] if parameter.key == "range_spacing_m" else sides[1]) / 2.0
