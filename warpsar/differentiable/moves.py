"""What of a scene's geometry may move: poses and sizes of its objects, or every vertex of its mesh."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.parameters.at import at
from warpsar.scene.scene import Scene

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
