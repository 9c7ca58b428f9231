"""Which body stands in a place: a box first, then others, and fewer numbers where these do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from warpsar.diagnosis.proposals import shapes
from warpsar.diagnosis.proposals.fit import Standing, TrialGround, alone
from warpsar.diagnosis.proposals.left_out import explained
from warpsar.diagnosis.proposals.places import BodyPlace
from warpsar.diagnosis.proposals.shapes import TrialBody
from warpsar.scene.scene import Scene
from warpsar.world import models
from warpsar.world.tables import Material

QUICK_STEPS, QUICK_FLAT = 10, 1.0  # of a descent that only compares
GLANCE_STEPS = 3  # of a shape that may be given up
HOPELESS, NOTHING_LEFT = 0.3, 0.97  # explained by a box: below and above, no other body is tried
POINT_PX = 4.0  # a box smaller than this may be a point
THINNEST_PX = 0.5


@dataclass(frozen=True)
class Tried:
    """A shape, and the scene with it at its best while all else is held."""

    shape: TrialBody
    standing: Standing

    @property
    def name(self) -> str:
        return self.standing.scene.objects[-1].label

    @property
    def numbers(self) -> int:
        """How many are free: of pose and size, and of a material of its own."""
        one = self.standing.scene.objects[-1]
        return self.shape.numbers + (len(_own(self).learn) if one.material == one.name else 0)

    @property
    def is_point(self) -> bool:
        return self.shape.learn == shapes.BRIGHTNESS

    def worth(self, cost: float) -> float:
        """Minus the loss, less what its numbers cost."""
        return -self.standing.loss - cost * self.numbers


def likeliest(ground: TrialGround, without: Standing, place: BodyPlace, cost: float) -> list[Tried]:
    """The likeliest body in a place for its numbers, or none."""
    name, pixel_m = _free_name(ground.scene), max(ground.scene.grid.spacing_m)
    box = _first_box(ground, place, name)
    share = explained(without, box.standing)
    tried = [box] if sound(box.standing.scene) and share > HOPELESS else []
    widest_m = max(box.standing.scene.objects[-1].size_m or ()) if tried else place.width_m
    if tried and share < NOTHING_LEFT:
        tried += _other_bodies(ground, box, cost)
    if widest_m <= POINT_PX * pixel_m:
        shape = shapes.point(place.position_m, name, pixel_m)
        points = [_fitted(ground, shape, _own(box), QUICK_STEPS, blur_m=2.0 * pixel_m)]
        if tried:  # a point is a pixel wide: from the place alone a descent may end beside it
            shape = shapes.point_in(tried[0].standing.scene.objects[-1], name, pixel_m)
            points.append(_fitted(ground, shape, _own(box), QUICK_STEPS))
        tried.append(min(points, key=lambda one: one.standing.loss))
    best = max(tried, key=lambda one: one.worth(cost), default=None)
    if best is None:
        return []
    fewer = [best, *_rounded(ground, best)]
    if not best.is_point:  # whose brightness is a number of its own
        fewer += _of_known_materials(ground, best)
    return [max(fewer, key=lambda one: one.worth(cost))]


def _other_bodies(ground: TrialGround, box: Tried, cost: float) -> list[Tried]:
    tried = []
    for shape in shapes.others(box.standing.scene.objects[-1]):
        body = _fitted(ground, shape, _own(box), GLANCE_STEPS)
        tried.append(_again(ground, body) if body.worth(cost) > box.worth(cost) else body)
    return tried


def _first_box(ground: TrialGround, place: BodyPlace, name: str) -> Tried:
    """A box from the place's width and height, through blurred images."""
    blur_m = place.width_m / 2.0
    first, *turned = shapes.boxes(place, name)
    known = _materials(ground)
    losses = [ground.as_it_stands(_with(ground, first, each), blur_m).loss for each in known]
    material = known[int(np.argmin(losses))]
    starts = [(shape, ground.as_it_stands(_with(ground, shape, material), blur_m)) for shape in (first, *turned)]
    shape, start = min(starts, key=lambda one: one[1].loss)
    blurred = _quick(ground, start.scene, QUICK_STEPS, blur_m)
    scene = _tidied(ground, blurred.scene)
    return Tried(shape, _quick(ground, scene, 2 * QUICK_STEPS))


def _fitted(ground: TrialGround, shape: TrialBody, material: Material, steps: int, blur_m: float = 0.0) -> Tried:
    scene = _with(ground, shape, material)
    if blur_m:
        scene = _quick(ground, scene, steps, blur_m).scene
    return Tried(shape, _quick(ground, scene, steps))


def _again(ground: TrialGround, tried: Tried) -> Tried:
    return replace(tried, standing=_quick(ground, tried.standing.scene, QUICK_STEPS))


def _quick(ground: TrialGround, scene: Scene, steps: int, blur_m: float = 0.0) -> Standing:
    """The scene as a descent leaves it that only compares bodies."""
    return ground.settled(scene, blur_m, most=steps, flat=QUICK_FLAT)


def _rounded(ground: TrialGround, tried: Tried) -> list[Tried]:
    """A cylinder on a circle in the place of one on an ellipse."""
    shape = shapes.round_one(TrialBody(tried.standing.scene.objects[-1], tried.shape.numbers, tried.shape.learn))
    return [] if shape is None else [Tried(shape, ground.as_it_stands(_with(ground, shape, _own(tried))))]


def _of_known_materials(ground: TrialGround, tried: Tried) -> list[Tried]:
    """The same body, of one of the scene's own materials that are no fields."""
    bodies = []
    for name in (name for name, one in ground.scene.materials.items() if not one.fields):
        table = tried.standing.scene.objects[-1].model_copy(update={"material": name})
        scene = alone(ground.holding(table))
        bodies.append(Tried(tried.shape, ground.as_it_stands(scene)))
    best = min(bodies, key=lambda one: one.standing.loss, default=None)
    return [] if best is None else [_again(ground, best)]


def _with(ground: TrialGround, shape: TrialBody, material: Material) -> Scene:
    return alone(ground.holding(shape.table, material.model_copy(update={"learn": _free(shape, material)})))


def _free(shape: TrialBody, material: Material) -> tuple[str, ...]:
    """What is free of a body's material: what the shape names, as far as the model has it, else the model's own; of a
    table its level alone."""
    return models.keys_of(material.model, shape.learn) or models.keys_of(material.model)


def _tidied(ground: TrialGround, scene: Scene) -> Scene:
    own = scene.materials[str(scene.objects[-1].material)]
    return alone(ground.holding(shapes.tidy(scene.objects[-1]), own))


def _own(tried: Tried) -> Material:
    scene = tried.standing.scene
    return scene.materials[str(scene.objects[-1].material)]


def _materials(ground: TrialGround) -> list[Material]:
    """Starts for a material: the scene's own, without what is known of them. Of a field a body gets the median."""
    scene, found = ground.scene, list[Material]()
    for name, material in scene.materials.items():
        update: dict[str, Any] = {"tolerance": {}, "layout": "uniform"}
        update |= {key: float(np.median(scene.field(name, key))) for key in material.fields}
        found.append(material.model_copy(update=update))
    return found


def _free_name(scene: Scene) -> str:
    taken = {*scene.materials, *(one.label for one in scene.objects)}
    return next(name for k in range(1, len(taken) + 2) if (name := f"found_{k}") not in taken)


def sound(scene: Scene) -> bool:
    """Whether the last object is a body: not flatter than half a pixel, of which neither layover nor shadow tells, nor
    wider than half the image."""
    grid, size = scene.grid, scene.objects[-1].size_m
    assert size is not None
    widest = max(n * step for n, step in zip(grid.shape, grid.spacing_m, strict=True)) / 2.0
    return min(size) > THINNEST_PX * min(grid.spacing_m) and max(size) < widest
