"""A body's brightest place beside what its shape returns: a mirror, a wheel arch, a windscreen's corner."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from warpsar.effects.registry import declared, response_of
from warpsar.learning.pose_pixels import compared
from warpsar.learning.pose_search import lit_pixels
from warpsar.learning.problem import FitProblem
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.simulation.exact_rays import ExactRays
from warpsar.surface.stage import Stage
from warpsar.world.objects.table import Object
from warpsar.world.tables import View
from warpsar.world.world import geometry_of

GLINT = "glint"  # "car012.glint" is that of car012
SIZE_M, ABOVE_M = (0.3, 0.3, 0.1), 0.2  # a small box above the body, where nothing hides it
REACH_M = 1.0  # beyond the body's extent
AROUND = 2  # pixels about a point that are compared
LEVELS = (0.1, 0.3, 1.0, 3.0, 10.0)  # of a tried point, against the brightest modelled pixel about it
NUMBERS = 3.0  # gain in ln L that a glint's place in range and in azimuth and its power cost
TOLERANCE_M = (1.0, 1.0, 0.0)  # its height is held: range tells it as east and north do


@dataclass(frozen=True)
class _Image:
    """One measured image over its gain, the model's, and the pixels that count, (rows, cols) each."""

    view: View
    measured: np.ndarray
    model: np.ndarray
    usable: np.ndarray
    looks: float


def with_glints(scene: Scene, device: wp.Device, loss: str) -> Scene:
    """The scene with a glint for each body that may have one (`glint`) and where the train images pay for it.

    Three numbers of a point are told by images of one incidence: where it lies in range and in azimuth, and its power.
    So a glint stands above its body, where nothing hides it. Its place says where it is seen, and not where it is.
    """
    images = _images(scene, device, loss)
    glints, materials = [], {}
    for one in scene.objects:
        place = _best_place(scene, one, images) if one.glint else None
        if place is None or one.material is None:
            continue
        name = f"{one.label}.{GLINT}"
        tolerance = {"position_m": list(TOLERANCE_M)}
        glints.append(
            Object.model_validate(
                {"name": name, "primitive": "box", "size_m": SIZE_M, "position_m": place, "material": name}
                | {"learn": ("position",), "tolerance": tolerance}
            )
        )
        materials[name] = scene.materials[one.material].model_copy(update={"learn": ("rms_height_m",)})
    bodies = [_asked(one) if one.glint else one for one in scene.objects]
    return with_objects(scene, [*bodies, *glints], {**scene.materials, **materials})


def _asked(one: Object) -> Object:
    """The body without the question."""
    return Object.model_validate(one.model_dump(mode="python", exclude_unset=True, exclude={"glint"}, warnings=False))


def _images(scene: Scene, device: wp.Device, loss: str) -> list[_Image]:
    pixels, gains = lit_pixels(scene, device, loss)
    both = compared(scene, pixels, 0.0, gains)
    rays = ExactRays(Stage.of(both.scene, device), seed=scene.sampling.seed)
    problem = FitProblem(both.scene, device, loss=loss, rays=rays, observations=both.observations)
    modelled = problem.modelled(problem.x0)
    found = []
    for seen, mu, gain in zip(problem.observations, modelled, problem.gains(modelled), strict=True):
        model = np.ones(scene.grid.shape)
        model[seen.interior] = mu
        measured = np.where(seen.interior, np.asarray(seen.measured, float) / gain, 1.0)
        found.append(_Image(seen.view, measured, model, seen.interior, seen.looks))
    return found


def _best_place(scene: Scene, one: Object, images: Sequence[_Image]) -> tuple[float, float, float] | None:
    """Where a point above the body gains most, in metres; None where it gains no more than its numbers cost."""
    assert scene.assembly is not None
    vertices = scene.assembly.vertices_of(one)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    up = float(high[2]) + ABOVE_M
    d = geometry_of(scene, images[0].view).d
    # what stands this high is seen nearer to the radar by as much
    nearer = (up - low[2]) * -d[2] / float(d[:2] @ d[:2]) * d[:2]
    step = min(scene.grid.spacing_m)
    begin = low[:2] + np.minimum(nearer, 0.0) - REACH_M
    end = high[:2] + np.maximum(nearer, 0.0) + REACH_M + step
    east, north = (np.arange(begin[k], end[k], step) for k in (0, 1))
    places = np.stack([axis.ravel() for axis in np.meshgrid(east, north, indexing="ij")], axis=1)
    places = np.column_stack([places, np.full(len(places), up)])
    gains = _gains(scene, images, places)
    best = int(np.argmax(gains))
    cells = len(places) * step**2 / float(np.prod(scene.grid.spacing_m))  # of as many, one is bright by chance
    least = NUMBERS + math.log(max(cells, 1.0))
    return (float(places[best, 0]), float(places[best, 1]), up) if gains[best] > least else None


def _gains(scene: Scene, images: Sequence[_Image], places: np.ndarray) -> np.ndarray:
    """What a point of the best of `LEVELS` gains in ln L at each of the places (n, 3), (n,); 0 at an image's edge."""
    spacing, shape = scene.grid.spacing_m, scene.grid.shape
    asked = response_of(declared(scene, images[0].view)).width_m
    width = [wide or step for wide, step in zip(asked, spacing, strict=True)]
    near = np.arange(-AROUND, AROUND + 1)
    parts, inside, top = [], np.ones(len(places), bool), np.zeros(len(places))
    for image in images:
        geometry = geometry_of(scene, image.view)
        away = places - np.asarray(scene.reference_point_m)
        axes = zip((geometry.d, geometry.u), spacing, shape, strict=True)
        at = np.stack([away @ axis / s + n / 2.0 - 0.5 for axis, s, n in axes], axis=1)
        middle = np.rint(at).astype(int)
        inside &= ((middle > AROUND) & (middle < np.array(shape) - 1 - AROUND)).all(axis=1)
        middle = np.clip(middle, AROUND, np.array(shape) - 1 - AROUND)
        row, col = (middle[:, k, None] + near for k in (0, 1))
        of_row, of_col = (((i - at[:, k, None]) * spacing[k] / width[k]) ** 2 for k, i in enumerate((row, col)))
        point = np.exp(-4.0 * math.log(2.0) * (of_row[:, :, None] + of_col[:, None, :]))
        window = row[:, :, None], col[:, None, :]
        parts.append((image, window, point))
        top = np.maximum(top, image.model[window].max(axis=(1, 2)))
    best = np.zeros(len(places))
    for level in LEVELS:
        gain = np.zeros(len(places))
        for image, window, point in parts:
            old, measured = image.model[window], image.measured[window]
            new = old + level * top[:, None, None] * point
            each = np.log(old / new) + measured / old - measured / new
            gain += image.looks * np.where(image.usable[window], each, 0.0).sum(axis=(1, 2))
        best = np.maximum(best, gain)
    return np.where(inside, best, 0.0)
