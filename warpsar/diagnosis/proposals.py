"""What the mesh lacks: an object that several views agree on, in pose, size and material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.diagnosis import proposals_shapes as shapes
from warpsar.diagnosis.geometry import GeometryCandidate
from warpsar.diagnosis.proposals_fit import Ground, Standing, alone, released
from warpsar.diagnosis.proposals_left_out import explained, left_out
from warpsar.diagnosis.proposals_place import Place, Ratios, places
from warpsar.diagnosis.proposals_shapes import Shape
from warpsar.learning.observation import Observation
from warpsar.learning.pose_search import summary
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.world.tables import Material

KIND = "missing_object"
LOOKED_AT = 6  # places that do not overlap
PLACES, NEARLY = 2, 0.5  # that are tried, where the second scores such a share of the first
EXPLAINED = 0.5  # of what is unlike speckle in the pixels that a body touches: where others are missing, it is less
THINNEST_PX = 0.5
WORTH_A_FIT = 2.0  # times what a number costs: the best of all places where nothing stands scores less
QUICK_STEPS, QUICK_FLAT = 10, 1.0  # of a descent that only compares
NOTHING_LEFT = 0.97  # of the same, from which no other body is tried
POINT_PX = 4.0  # a box smaller than this may be a point
LAST_STEPS, LAST_FLAT = 4, 0.1  # of the last descents
GLANCE_STEPS = 3  # of a shape that may be given up


def proposed(
    scene: Scene,
    device: wp.Device,
    observations: Mapping[str, list[Observation]] | None = None,
    *,
    loss: str = "gamma",
    price: float | None = None,
) -> list[GeometryCandidate]:
    """The object that explains most of what a fitted scene leaves, if it pays and views left out confirm it.

    `observations`, by view name: the pixels that other models are compared on; by default those of the views with role
    train that the scene lights. `price`: what a number costs in 2 ln L; by default the logarithm of looks times pixels
    (Schwarz, Annals of Statistics 6, 1978). Returns one candidate or none: a second object is found once the first
    one stands in the scene. One view cannot place an object, so a scene with one has none.
    """
    ground = Ground.of(scene, device, observations, loss)
    if len(ground.pixels) < 2:
        return []
    without = ground.settled(ground.scene)
    ground = replace(ground, scene=without.scene)
    cost = 0.5 * (price if price is not None else np.log(sum(s.looks * s.count for s in without.observations)))
    places_tried = _worth_a_fit(ground, without, cost)
    found = [one for place in places_tried for one in _likeliest(ground, without, place, cost)]
    best = max(found, key=lambda one: one.worth(cost), default=None)
    if best is None:
        return []
    whole = _with_all_else(ground, released(best.standing.scene, without.scene))
    size = _numbers(best, whole.scene)
    gain = without.loss - whole.loss
    console.say(f"missing object: {best.shape.table.primitive}, log-likelihood up by {gain:.4g} with {size} numbers")
    if gain <= size * cost or not _sound(whole.scene) or explained(without, whole) < EXPLAINED:
        return []
    confirmed = left_out(ground, without, whole)
    console.say(f"missing object: views left out gain {confirmed.gain:.4g} +- {confirmed.error:.2g}")
    if not confirmed.passed:
        return []
    values, words = _told(whole, best)
    words.append(f"views left out: log-likelihood up by {confirmed.gain:.4g} +- {confirmed.error:.2g}")
    return [GeometryCandidate(KIND, best.name, whole.scene, float(gain), size, values, words)]


@dataclass(frozen=True)
class _Tried:
    """A shape, and the scene with it at its best while all else is held."""

    shape: Shape
    standing: Standing

    @property
    def name(self) -> str:
        return self.standing.scene.objects[-1].label

    @property
    def is_point(self) -> bool:
        return self.shape.learn == shapes.BRIGHTNESS

    def worth(self, cost: float) -> float:
        """Minus the loss, less what its numbers cost."""
        return -self.standing.loss - cost * _numbers(self, self.standing.scene)


def _worth_a_fit(ground: Ground, without: Standing, cost: float) -> list[Place]:
    """Places where bodies would explain enough, and no much better one is among them."""
    found = [one for one in places(ground.scene, _ratios(without), LOOKED_AT) if one.share > EXPLAINED]
    least = max(WORTH_A_FIT * cost, NEARLY * max((one.score for one in found), default=0.0))
    return [one for one in found if one.score > least][:PLACES]


def _sound(scene: Scene) -> bool:
    """Whether the last object is a body: not flatter than half a pixel, of which neither layover nor shadow tells, nor
    wider than half the image."""
    grid, size = scene.grid, scene.objects[-1].size_m
    assert size is not None
    widest = max(n * step for n, step in zip(grid.shape, grid.spacing_m, strict=True)) / 2.0
    return min(size) > THINNEST_PX * min(grid.spacing_m) and max(size) < widest


def _numbers(tried: _Tried, scene: Scene) -> int:
    one = scene.objects[-1]
    own = one.material == one.name
    return tried.shape.numbers + (len(tried.shape.learn) if own else 0)


def _ratios(standing: Standing) -> list[Ratios]:
    """Measured over modelled power of every image."""
    found = []
    for seen, mu in zip(standing.observations, standing.modelled(), strict=True):
        image = np.zeros(seen.interior.shape)
        image[seen.interior] = seen.values / mu
        found.append(Ratios(seen.view, image, seen.interior, seen.looks))
    return found


def _likeliest(ground: Ground, without: Standing, place: Place, cost: float) -> list[_Tried]:
    """The likeliest body in a place for its numbers, or none."""
    name, pixel_m = _free_name(ground.scene), max(ground.scene.grid.spacing_m)
    box = _first_box(ground, place, name)
    narrow = min(place.width_m, max(box.standing.scene.objects[-1].size_m or ())) <= POINT_PX * pixel_m
    tried = [box] if _sound(box.standing.scene) else []
    if tried and explained(without, box.standing) < NOTHING_LEFT:
        tried += _other_bodies(ground, box, cost)
    if narrow:
        shape = shapes.point(place, name, pixel_m)
        tried.append(_fitted(ground, shape, _own(box), QUICK_STEPS, blur_m=2.0 * pixel_m))
    best = max(tried, key=lambda one: one.worth(cost), default=None)
    if best is None:
        return []
    fewer = [best, *_rounded(ground, best)]
    if not best.is_point:  # whose brightness is a number of its own
        fewer += _of_known_materials(ground, best)
    return [max(fewer, key=lambda one: one.worth(cost))]


def _other_bodies(ground: Ground, box: _Tried, cost: float) -> list[_Tried]:
    tried = []
    for shape in shapes.others(box.standing.scene.objects[-1]):
        found = _fitted(ground, shape, _own(box), GLANCE_STEPS)
        tried.append(_again(ground, found) if found.worth(cost) > box.worth(cost) else found)
    return tried


def _first_box(ground: Ground, place: Place, name: str) -> _Tried:
    """A box from the place's width and height, through blurred images."""
    blur_m = place.width_m / 2.0
    starts = [(shape, _with(ground, shape, m)) for shape in shapes.boxes(place, name) for m in _materials(ground)]
    losses = []
    for _, scene in starts:
        problem = ground.problem(scene, blur_m)
        losses.append(problem.value(problem.x0))
    shape, scene = starts[int(np.argmin(losses))]
    blurred = ground.settled(scene, blur_m, most=QUICK_STEPS, flat=QUICK_FLAT)
    found = _tidied(ground, blurred.scene)
    return _Tried(shape, ground.settled(found, most=2 * QUICK_STEPS, flat=QUICK_FLAT))


def _fitted(ground: Ground, shape: Shape, material: Material, steps: int, blur_m: float = 0.0) -> _Tried:
    scene = _with(ground, shape, material)
    if blur_m:
        scene = ground.settled(scene, blur_m, most=steps, flat=QUICK_FLAT).scene
    return _Tried(shape, ground.settled(scene, most=steps, flat=QUICK_FLAT))


def _again(ground: Ground, tried: _Tried) -> _Tried:
    return replace(tried, standing=ground.settled(tried.standing.scene, most=QUICK_STEPS, flat=QUICK_FLAT))


def _rounded(ground: Ground, tried: _Tried) -> list[_Tried]:
    """A cylinder on a circle in the place of one on an ellipse."""
    shape = shapes.round_one(Shape(tried.standing.scene.objects[-1], tried.shape.numbers, tried.shape.learn))
    return [] if shape is None else [_Tried(shape, _as_it_stands(ground, _with(ground, shape, _own(tried))))]


def _of_known_materials(ground: Ground, tried: _Tried) -> list[_Tried]:
    """The same body, of one of the scene's own materials."""
    found = []
    for name in ground.scene.materials:
        table = tried.standing.scene.objects[-1].model_copy(update={"material": name})
        scene = alone(ground.with_object(table))
        found.append(_Tried(tried.shape, _as_it_stands(ground, scene)))
    best = min(found, key=lambda one: one.standing.loss)
    return [_again(ground, best)]


def _as_it_stands(ground: Ground, scene: Scene) -> Standing:
    problem = ground.problem(scene)
    return Standing(scene, problem.value(problem.x0), problem, problem.x0)


def _with(ground: Ground, shape: Shape, material: Material) -> Scene:
    return alone(ground.with_object(shape.table, material.model_copy(update={"learn": shape.learn})))


def _tidied(ground: Ground, scene: Scene) -> Scene:
    own = scene.materials[str(scene.objects[-1].material)]
    return alone(ground.with_object(shapes.tidy(scene.objects[-1]), own))


def _own(tried: _Tried) -> Material:
    scene = tried.standing.scene
    return scene.materials[str(scene.objects[-1].material)]


def _materials(ground: Ground) -> list[Material]:
    """Starts for a material: the scene's own, without what is known of them."""
    update: dict[str, Any] = {"tolerance": {}, "layout": "uniform"}
    return [material.model_copy(update=update) for material in ground.scene.materials.values()]


def _free_name(scene: Scene) -> str:
    taken = {*scene.materials, *(one.label for one in scene.objects)}
    return next(name for k in range(1, len(taken) + 2) if (name := f"found_{k}") not in taken)


def _with_all_else(ground: Ground, scene: Scene) -> Standing:
    """Surfaces and effects with the object at their best: in turns, since a step is cheap where no object moves."""
    for _ in range(2):
        placed = replace(scene, objects=(*scene.objects[:-1], scene.objects[-1].model_copy(update={"learn": ()})))
        surfaces = ground.settled(placed).scene
        moving = alone(replace(surfaces, objects=scene.objects))
        scene = released(ground.settled(moving, most=LAST_STEPS, flat=LAST_FLAT).scene, surfaces)
    return ground.settled(scene, most=LAST_STEPS, flat=LAST_FLAT)


def _told(whole: Standing, best: _Tried) -> tuple[dict[str, Any], list[str]]:
    """For diagnosis.json: the object's values with their standard deviations, and what is said beside them."""
    identified = whole.problem.identified(whole.x)
    one = whole.scene.objects[-1]
    values = {"primitive": one.primitive, **summary(whole.problem, whole.x, identified)[one.label]}
    east, north, _ = one.position_m
    length, width, height = one.size_m or (0.0, 0.0, 0.0)
    words = [
        f"{one.label}: a {one.primitive} of {length:.2f} x {width:.2f} x {height:.2f} m at {east:.2f} m east, "
        f"{north:.2f} m north"
    ]
    if best.is_point:
        words = [f"{one.label}: a point reflector at {east:.2f} m east, {north:.2f} m north; its size stands for a point"]
    return values, words
