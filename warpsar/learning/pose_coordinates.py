"""The poses and sizes of objects that a fit may change, as one vector of metres."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpsar.effects.registry import fitted_effects, get
from warpsar.parameters.tree import object_values
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import KEYS, LIMITS, Object

FARTHEST_M = 50.0  # that a fit moves an object
LARGEST_FACTOR = 4.0  # by which it changes a size
NAMES = {
    "position": ("east", "north", "up"),
    "scale": ("along", "across", "upward"),
    "size": ("length", "width", "height"),
}
"""What the elements of a key of three are called."""


@dataclass(frozen=True)
class PoseCoordinate:
    """One number of the vector: it moves the object's outermost points by about a metre for each metre.

    `word` is the word of `learn`, `index` the element of its key where that has three. A value is `start` +
    coordinate * `slope`, or `start` * exp(coordinate * `slope`) for a size or a scale (`factor`).
    """

    object: int
    label: str
    word: str
    index: int | None
    start: float
    slope: float
    factor: bool

    def value(self, coordinate: float) -> float:
        """The value in the table's unit."""
        return self.start * math.exp(coordinate * self.slope) if self.factor else self.start + coordinate * self.slope

    def per_metre(self, coordinate: float) -> float:
        """The value's derivative to the coordinate [unit / m]."""
        return self.value(coordinate) * self.slope if self.factor else self.slope

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest coordinate [m]."""
        if self.factor:
            reach = math.log(LARGEST_FACTOR) / self.slope
        elif self.word in LIMITS:
            low, high = LIMITS[self.word]
            return (low - self.start) / self.slope, (high - self.start) / self.slope
        else:
            reach = FARTHEST_M if self.word == "position" else 180.0 / self.slope
        return -reach, reach


class Poses:
    """What `learn` of a scene's objects frees; the vector p, shape (n,) [m], is 0 where the scene file puts it.

    `known` says of each element about which value it is known, and to which standard deviation, in the key's unit; it
    is infinite without a tolerance. Positions are held where a fit moves an effect that can do what they do
    (`Effect.sets_positions`); `held` has a sentence for each object.
    """

    def __init__(self, scene: Scene) -> None:
        assert scene.assembly is not None
        self.objects = scene.objects
        self.coordinates: list[PoseCoordinate] = []
        self.known: list[tuple[float, float]] = []
        self.held: list[str] = []
        holding = next((name for name in fitted_effects(scene.effects) if get(name).sets_positions), None)
        for number, one in enumerate(scene.objects):
            vertices = scene.assembly.vertices_of(one)
            radius = float(np.linalg.norm(np.ptp(vertices, axis=0)) / 2.0)
            for word in one.learn:
                if word == "position" and holding is not None:
                    self.held.append(f"{one.label}.position: held, because {holding} shifts each view by itself")
                    continue
                self._add(number, one, word, radius)

    def _add(self, number: int, one: Object, word: str, radius: float) -> None:
        given = object_values(one, word)
        known = one.known_of(KEYS[word], given)
        for index, (start, about_sd) in enumerate(zip(given, known, strict=True)):
            if word == "size" and start == 0.0:
                continue  # a plate's thickness
            factor = word in ("size", "scale")
            slope = {"position": 1.0, "size": 2.0 / max(start, 1e-9), "scale": 1.0 / radius}.get(word, 1.0 / radius)
            slope = math.degrees(slope) if word in ("heading", "pitch", "roll") else slope
            named = f"{one.label}.{word}" if len(given) == 1 else f"{one.label}.{NAMES[word][index]}"
            c = PoseCoordinate(number, named, word, index if len(given) > 1 else None, start, slope, factor)
            self.coordinates.append(c)
            self.known.append(about_sd)

    @property
    def labels(self) -> list[str]:
        return [c.label for c in self.coordinates]

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        ends = np.array([c.bounds for c in self.coordinates]).reshape(-1, 2)
        return ends[:, 0].copy(), ends[:, 1].copy()

    def at(self, p: np.ndarray) -> tuple[Object, ...]:
        """The objects with p in place."""
        found = list(self.objects)
        for c, coordinate in zip(self.coordinates, p, strict=True):
            value = c.value(float(coordinate))
            new: Any = value
            if c.index is not None:
                three = list(object_values(found[c.object], c.word))
                three[c.index] = value
                new = tuple(three)
            found[c.object] = found[c.object].model_copy(update={KEYS[c.word]: new})
        return tuple(found)
