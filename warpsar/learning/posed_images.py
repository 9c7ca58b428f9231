"""Renders of a view whose geometry lies elsewhere, for derivatives: without a fit problem of their own.

A derivative to a pose needs two renders of each view, and nothing of what a fit records beside them. So only the hits
are traced anew, and only where a body can change the image. The power before the image stage is enough: a body changes
it near by alone, whatever sidelobes a point has.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.registry import declared, get
from warpsar.learning.problem import FitProblem
from warpsar.learning.view import FitView
from warpsar.render.render import ViewRender
from warpsar.runtime.deadline import check
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.simulation.rays import effects_grid
from warpsar.trace.target import Target


def without_paths(scene: Scene) -> Scene:
    """The scene with single bounces alone."""
    if all(get(name).stage != "path" for name in scene.effects):
        return scene
    return replace(scene, effects={name: t for name, t in scene.effects.items() if get(name).stage != "path"})


def render_elsewhere(
    problem: FitProblem,
    view: FitView,
    x: np.ndarray,
    scene: Scene,
    columns: tuple[int, int] | None = None,
    faces: np.ndarray | None = None,
    *,
    paths: bool = True,
) -> ViewRender:
    """The view with its geometry as `scene` has it; surface and effects as x of `problem` says. It has run.

    `columns`: from the first to before the last column of the image that is made; the others stay without hits.
    `faces`: those that are there, shape (faces,), as `exact_hits` has them; by default all.
    `paths`: whether light that went over several surfaces is in them. The scene has the faces of the problem's own, in
    the same order. Raises TimeUp where the time of the run is over.
    """
    check()
    there = next(one for one in scene.views if one.name == view.view.name)
    placed = replace(scene, effects=problem.effect_tables(x))
    placed = placed if paths else without_paths(placed)
    effects = declared(placed, there, neutral=True)
    stage = replace(problem.stage, target=Target.upload(scene.mesh, scene.reference_point_m, problem.device))
    rays = ExactRays(stage, seed=scene.sampling.seed)
    hits = rays.trace(placed, there, effects, _of_the_grid(placed, effects, columns), only_faces=faces)
    render = ViewRender(stage, there, hits, scene.grid.shape, tuple(there.images), effects)
    render.set_parameters(problem.float_nodes(x))
    render.forward()
    return render


def _of_the_grid(
    scene: Scene, effects: list[DeclaredEffect], columns: tuple[int, int] | None
) -> tuple[int, int] | None:
    """The columns of the hits' grid that columns of the image are, one at least."""
    if columns is None:
        return None
    grid, wide = effects_grid(scene, effects), scene.grid.shape[1]
    fine = grid.bins_per_pixel
    margin = (grid.shape[1] // fine - wide) // 2
    first, last = (min(max(column + margin, 0) * fine, grid.shape[1]) for column in columns)
    first = min(first, grid.shape[1] - 1)  # one column at least: a body may lie beside a view's image
    return first, max(last, first + 1)
