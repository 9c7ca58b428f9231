"""Sizes and angles that the scene frees with a tolerance, by what views left out say of them.

The likelihood of the fitted views does not do for this: it is bounded, so that it hardly feels the dark pixels of a
shadow. Each number is moved by itself, all else held.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri, stdtrit

from warpsar.diagnosis.held_out.box import ends_m
from warpsar.effects.registry import declared as effects_of
from warpsar.effects.registry import get, response_of
from warpsar.learning.geometry import NAMES, WORDS, freed
from warpsar.learning.pull import Pull
from warpsar.parameters.at import at
from warpsar.parameters.parameter import Parameter
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene

WIDE = (-2.0, -1.2, -0.6, 0.0, 0.6, 1.2)
"""Places of a first profile about the known value, in its standard deviations. A size is tried further below: bodies
that are too large in the mesh hide more."""
NEAR = (-0.6, -0.3, 0.0, 0.3, 0.6)  # of a second one, about the value that was found
FURTHER = 4  # places beyond a profile's end, where it is still falling there
ARCS = 9  # of neighbours in azimuth: their misfit is alike, so the jackknife leaves out an arc at a time
INTERVAL = 0.95
NORMAL = float(ndtri(0.5 + 0.5 * INTERVAL))
AN_END = 0.5  # of a resolution cell: standard deviation of where a body ends that has detail beyond its mesh
TURNED = "turned by 180 deg"
ALIKE = ("box", "cylinder", "sphere")  # primitives that look the same turned by 180 degrees


@dataclass(frozen=True)
class Number:
    """One number of a scene's geometry, known to a standard deviation: its parameter and which element of it."""

    parameter: Parameter
    index: int | None
    known: float
    sd: float
    declared: float

    @property
    def label(self) -> str:
        """ "car.upward" of an object, else the parameter's dotted name."""
        if self.parameter.root != "objects":
            return self.parameter.name
        key = self.parameter.key
        word = WORDS[key] if self.index is None else NAMES[key][self.index]
        return f"{self.parameter.owner}.{word}"

    def now(self, scene: Scene) -> float:
        """Its value in a scene; of an angle common to all views how far they are turned."""
        if self.parameter.root == "views":
            return float(getattr(scene.views[0], self.parameter.key)) - self.declared
        return float(np.atleast_1d(scene.parameters[self.parameter.name].value)[self.index or 0])

    def moved(self, scene: Scene, by: float) -> Scene:
        """The scene with the number moved by so much."""
        parameter = scene.parameters[self.parameter.name]
        value = np.array(parameter.value, float)
        value[() if self.index is None else self.index] += by
        return at(scene, {parameter: value})


@dataclass(frozen=True)
class Profile:
    """What views left out say of a number: its `value`, standard deviation and half width of the interval that holds
    it in `INTERVAL` of all cases; mean `scores` at the `places` that were tried. `data` +- `data_sd` is where they are
    predicted best without its tolerance; None where that lies beyond the places."""

    label: str
    unit: str
    known: float
    known_sd: float
    value: float
    sd: float
    half: float
    places: tuple[float, ...]
    scores: tuple[float, ...]
    data: float | None = None
    data_sd: float | None = None

    @property
    def pull(self) -> Pull:
        """How far it is from its tolerance."""
        tension = None
        if self.data is not None and self.data_sd is not None:
            tension = (self.data - self.known) / math.hypot(self.data_sd, self.known_sd)
        away = (self.value - self.known) / self.known_sd
        found, alone = (self.value, self.sd), (self.data, self.data_sd)
        return Pull(self.label, self.unit, self.known, self.known_sd, *found, away, *alone, tension)


def numbers(scene: Scene) -> list[Number]:
    """What the scene frees of its geometry with a tolerance, in the order in which it is moved: common angles first,
    then heights, for a shadow tells them best. Positions are left out where an effect sets them."""
    aimed = any(get(name).sets_positions for name in scene.effects)
    found = []
    for parameter in freed(scene):
        if parameter.root == "views" and parameter.owner:
            continue  # the angle of a single view is told by no view left out
        if parameter.key == "position_m" and aimed:
            continue
        values = np.atleast_1d(parameter.value)
        known = parameter.known or ((0.0, math.inf),) * len(values)
        which = range(len(values)) if parameter.layout == "vector" else [None]
        for index, (about, sd) in zip(which, known, strict=True):
            if math.isfinite(sd):
                of_views = parameter.root == "views"
                declared = float(getattr(scene.views[0], parameter.key)) if of_views else about
                found.append(Number(parameter, index, about, sd, declared))
    return sorted(found, key=lambda one: (one.parameter.root == "objects", -(one.index or 0)))


def minimum(places: Sequence[float], losses: Sequence[float]) -> float:
    """Where the quartic through a profile (cubic and less for fewer than six places) has its least value, inside it.

    A profile is not even about its least value. A parabola would put it aside: 0.3 % of a height."""
    where, loss = np.array(places), np.array(losses)
    middle, half = 0.5 * (where.min() + where.max()), 0.5 * float(np.ptp(where))
    curve = np.poly1d(np.polyfit((where - middle) / half, loss, min(4, len(where) - 1)))
    flat = [float(root.real) for root in curve.deriv().roots if abs(root.imag) < 1e-6 and abs(root.real) <= 1.0]
    return float(middle + half * min([-1.0, 1.0, *flat], key=curve))


def likeliest(places: Sequence[float], losses: np.ndarray, pull: np.ndarray) -> tuple[float, float, float]:
    """Where the views' losses, (places, views) in order of azimuth, and the `pull` of what is known, (places,), are
    least together; its standard deviation by the jackknife over arcs of neighbours, and the interval's half width."""
    n = losses.shape[1]
    groups = np.array_split(np.arange(n), min(ARCS, n))
    rest = [np.setdiff1d(np.arange(n), group) for group in groups]
    without = [minimum(places, (losses[:, some].sum(axis=1) * n / some.size + pull).tolist()) for some in rest]
    sd = float(np.std(without) * np.sqrt(len(groups) - 1))
    found = minimum(places, (losses.sum(axis=1) + pull).tolist())
    return found, sd, float(stdtrit(len(groups) - 1, 0.5 + 0.5 * INTERVAL)) * sd


def beyond_mesh(number: Number, scene: Scene) -> float:
    """What detail beyond the mesh leaves unknown of a length or a width, as a standard deviation in the number's unit;
    0 of any other number, and where the scene has no such detail.

    The images show where the last detail ends, and not where the mesh does. Either end is known to `AN_END` of a cell.
    A height is told by the shadow's end, where a cell is a small part of it.
    """
    axis = number.index or 0
    root, key = number.parameter.root, number.parameter.key
    if root != "objects" or key not in ("size_m", "scale") or axis == 2:
        return 0.0
    if not any(get(name).beyond_mesh for name in scene.effects):
        return 0.0
    widths = response_of(effects_of(scene, scene.views[0])).width_m
    cell_m = max(max(width or 0.0, step) for width, step in zip(widths, scene.grid.spacing_m, strict=True))
    left_m = AN_END * cell_m * math.sqrt(2.0)
    if key == "size_m":
        return left_m
    one = next(one for one in scene.objects if one.label == number.parameter.owner)
    low, high = ends_m(scene, one)
    across_m, along_m, _ = high - low
    return left_m * number.now(scene) / float(across_m if axis == 1 else along_m)


def profiled(
    number: Number,
    scene: Scene,
    offsets: Sequence[float],
    scored: Callable[[Callable[[Scene], Scene]], np.ndarray],
    weight: float,
) -> tuple[Profile, float]:
    """The profile of a number, and how far the scene's value is to move. `scored` gives the scores of all views, by
    azimuth, of the models changed by a function; `weight` turns a score into log-likelihood. Where the least value lies
    at an end, places beyond it are tried."""
    now = number.now(scene)

    def at(by: float) -> np.ndarray:
        return scored(lambda one: number.moved(one, by))

    steps = [offset * number.sd for offset in offsets]
    known = {step: at(step) for step in steps}
    for left in range(FURTHER, -1, -1):
        places = [now + step for step in steps]
        scores = np.array([known[step] for step in steps])
        pull = 0.5 * ((np.array(places) - number.known) / number.sd) ** 2
        value, sd, half = likeliest(places, weight * scores, pull)
        low, high = (math.isclose(value, end, abs_tol=1e-9 * number.sd) for end in (places[0], places[-1]))
        if not (low or high):
            break
        step = steps[1] - steps[0] if low else steps[-1] - steps[-2]
        if not left:  # it falls further than anybody looked: no more is known than that
            half = max(half, step)
            break
        # as many places as before, so that the curve through them is as near to them
        steps = [steps[0] - step, *steps[:-1]] if low else [*steps[1:], steps[-1] + step]
        known = {one: known[one] if one in known else at(one) for one in steps}
    beyond = beyond_mesh(number, scene)
    sd, half = math.hypot(sd, beyond), math.hypot(half, NORMAL * beyond)
    data, data_sd, _ = likeliest(places, weight * scores, np.zeros(len(places)))
    inside = min(places) < data < max(places)
    alone = (data, math.hypot(data_sd, beyond)) if inside else (None, None)
    means = tuple(float(one) for one in scores.mean(axis=1))
    unit = number.parameter.unit
    found = Profile(number.label, unit, number.known, number.sd, value, sd, half, tuple(places), means, *alone)
    return found, value - now


def turned(scene: Scene, label: str) -> Scene:
    """The scene with one of its objects turned round."""
    objects = [
        one.model_copy(update={"heading_deg": (one.heading_deg + 360.0) % 360.0 - 180.0}) if one.label == label else one
        for one in scene.objects
    ]
    return with_objects(scene, objects)


def bodies(scene: Scene) -> list[str]:
    """The objects of whose size or heading something is not known. A plate is ground, and a group has its place in the
    scene's own mesh."""
    own = [one for one in scene.objects if one.group is None and one.primitive != "plate"]
    return [one.label for one in own if {"size", "scale", "heading"} & set(one.learn)]


def turnable(scene: Scene) -> list[str]:
    """The bodies that have a front and of whose heading something is not known; a box looks the same from behind."""
    own = {one.label: one for one in scene.objects if one.primitive not in ALIKE and "heading" in one.learn}
    return [label for label in bodies(scene) if label in own]
