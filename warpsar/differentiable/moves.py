"""What of a scene's geometry may move: poses and sizes of its objects, or every vertex of its mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.differentiable.parameters import RenderParameter
from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import CABIN, KEYS, LIMITS, Object
from warpsar.world.world import posed

VERTICES = "mesh.vertices"
STEP = 1e-5  # of a number's own unit, for d vertices / d number: their error is then under 1e-9
ENDS = {"position": (-1e8, 1e8), "scale": (1e-6, 1e6), "size": (0.0, 1e6), **LIMITS}
TURN = (-360.0, 360.0)


class Moves:
    """The parameters of a scene's geometry, by name, and the mesh that they make.

    `parameters` are "<object>.<key>" for what the objects' `learn` names, such as "tower.heading_deg", in the unit of
    scene.toml; or "mesh.vertices" [m], shape (n, 3). None of them: rays stay where they are.
    """

    def __init__(self, scene: Scene, vertices: bool) -> None:
        self._scene = scene
        self.parameters: dict[str, RenderParameter] = {}
        self._of: dict[str, tuple[int, str]] = {}
        for index, one in enumerate(scene.objects):
            for word in one.learn:
                name = f"{one.label}.{KEYS[word]}"
                low, high = ENDS.get(word, TURN)
                self.parameters[name] = RenderParameter(name, _value(one, word), low, high, moves=True)
                self._of[name] = index, word
        if vertices and self.parameters:
            raise InputError(
                f"vertices: found objects with `learn` ({', '.join(self.parameters)}); free these or the vertices"
            )
        if vertices:
            self.parameters[VERTICES] = RenderParameter(
                VERTICES, np.array(scene.mesh.vertices, float), -1e8, 1e8, moves=True
            )
        if self.parameters:
            _refuse_without_derivative(scene)

    def scene_at(self, values: Mapping[str, NDArray[np.float64]]) -> Scene:
        """The scene with the `values` of these parameters. Raises InputError for a plate that would change its kind."""
        if VERTICES in values:
            return replace(self._scene, mesh=replace(self._scene.mesh, vertices=values[VERTICES]))
        objects = list(self._scene.objects)
        for name, value in values.items():
            index, word = self._of[name]
            if word == "size" and ((value == 0.0) != (self.parameters[name].value == 0.0)).any():
                raise InputError(f"{name}: found {value.tolist()}; a size of 0 must stay 0, and no other may become 0")
            new: Any = float(value) if value.ndim == 0 else tuple(value.tolist())
            objects[index] = objects[index].model_copy(update={KEYS[word]: new})
        return posed(self._scene, objects) if values else self._scene

    def pulled(
        self, values: Mapping[str, NDArray[np.float64]], to_vertices: NDArray[np.float64]
    ) -> dict[str, NDArray[np.float64]]:
        """Gradients to the parameters at `values` from those to the vertices, (n, 3). A size of 0 is held."""
        if VERTICES in self.parameters:
            return {VERTICES: to_vertices}
        found = {}
        for name, parameter in self.parameters.items():
            gradient = np.zeros(parameter.shape)
            for at in np.ndindex(parameter.shape):
                if name.endswith(".size_m") and parameter.value[at] == 0.0:
                    continue
                along = np.zeros(parameter.shape)
                along[at] = 1.0
                gradient[at] = np.sum(to_vertices * self.displacement(values, {name: along}))
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


def _value(one: Object, word: str) -> NDArray[np.float64]:
    value = getattr(one, KEYS[word])
    if value is None:
        value = CABIN[str(one.primitive)] if word == "cabin" else 0.0
    return np.array(value, float)


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
