"""What the mesh lacks: an object that several views agree on, in pose, size and material."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.compare.observation import Observation
from warpsar.diagnosis.geometry.base.body import BodyChange
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.models.change import BodyDifference
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.movable import POSE_WORDS
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.proposals.bodies import Tried, likeliest, sound
from warpsar.diagnosis.proposals.fit import Standing, TrialGround, alone, released
from warpsar.diagnosis.proposals.left_out import explained, left_out
from warpsar.diagnosis.proposals.places import BodyPlace, Looked, Ratios
from warpsar.learning.pose_search import summary
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Learnable, Object

LOOKED_AT = 4  # places that do not overlap
PLACES, NEARLY = 2, 0.5  # that are tried, where the second scores such a share of the first
EXPLAINED = 0.6  # of what is unlike speckle in the pixels that a body touches: where others are missing, it is less
PROMISING = 0.3  # the same of a place, before a body is fitted to it: the place alone knows one width and one height
WORTH_A_FIT = 2.0  # times what a number costs: the best of all places where nothing stands scores less
LAST_STEPS, LAST_FLAT = 4, 0.1  # of the last descents


class MissingObject(BodyChange):
    """A body of the scene alone: its images propose it, and a fit gives place, heading, size and material."""

    name = "missing_object"
    order = 40
    summary = "an object is there that the scene does not have"
    edges_doubt = False  # it is there or it is not: no remainder elsewhere puts that in doubt
    commented = ("position_m", "heading_deg", "size_m")

    def is_of(self, difference: BodyDifference) -> bool:
        return difference.was is None and difference.now is not None

    def words(self, one: Object) -> tuple[Learnable, ...]:
        """A sphere is a point, whose size means nothing, and a round cylinder, which has the heading 0, stays without
        one."""
        if one.primitive == "sphere":
            return ("position",)
        return ("position", "size") if one.primitive == "cylinder" and one.heading_deg == 0.0 else (*POSE_WORDS, "size")

    def proposed(self, setup: FitSetup, here: Fitted, price: float, least: float) -> list[GeometryCandidate]:
        return proposed(here.scene, setup.device, setup.observations, price=price, least=least)


CHANGE = MissingObject()


def proposed(
    scene: Scene,
    device: wp.Device,
    observations: Mapping[str, list[Observation]] | None = None,
    *,
    loss: str = "gamma",
    price: float | None = None,
    least: float = 0.0,
) -> list[GeometryCandidate]:
    """The object that explains most of what a fitted scene leaves, if it pays and views left out confirm it.

    `observations`, by view name: the pixels that other models are compared on; by default those of the views with
    role train that the scene lights. `price`: what a number costs in 2 ln L; by default the logarithm of looks times
    pixels (Schwarz, Annals of Statistics 6, 1978). `least`: log-likelihood that a place must promise for a fit.
    Returns one candidate or none: a second object is found once the first one stands in the scene. One view cannot
    place an object, so a scene with one has none.
    """
    ground = TrialGround.of(scene, device, observations, loss)
    if len(ground.pixels) < 2:
        return []
    without = ground.settled(ground.scene)
    ground = replace(ground, scene=without.scene)
    cost = 0.5 * (price if price is not None else np.log(sum(s.looks * s.count for s in without.observations)))
    trials = ground.trials
    bare = without if trials is ground else trials.as_it_stands(trials.scene)
    looked, pays = Looked.at(ground.scene, _ratios(without)), WORTH_A_FIT * cost
    places_tried = _worth_a_fit(looked.best(LOOKED_AT), max(pays, least))
    tried: list[Tried] = []
    for place in places_tried:
        if not any(_stands_at(one, place) for one in tried):
            tried += likeliest(trials, bare, place, cost)
    best = max(tried, key=lambda one: one.worth(cost), default=None)
    if best is None or bare.loss - best.standing.loss <= cost:  # less than one number is worth
        return []
    whole = _with_all_else(ground, released(best.standing.scene, without.scene))
    size = best.numbers
    gain = without.loss - whole.loss
    console.say(f"missing object: {best.shape.table.primitive}, log-likelihood up by {gain:.4g} with {size} numbers")
    if gain <= size * cost or not sound(whole.scene) or explained(without, whole) < EXPLAINED:
        return []
    confirmed = left_out(ground, without, whole, lambda view: _likely(looked.best(LOOKED_AT, without=view), pays))
    console.say(f"missing object: views left out gain {confirmed.gain:.4g} +- {confirmed.error:.2g}")
    if not confirmed.passed:
        return []
    values, words = _values_and_words(trials.as_it_stands(whole.scene), best)
    words.append(f"views left out: log-likelihood up by {confirmed.gain:.4g} +- {confirmed.error:.2g}")
    return [GeometryCandidate(CHANGE.name, best.name, whole.scene, float(gain), size, values, words)]


def _worth_a_fit(places: list[BodyPlace], least: float) -> list[BodyPlace]:
    """Places where bodies would explain at least so much, and no much better one is among them."""
    likely = _likely(places, least)
    least = NEARLY * max((one.score for one in likely), default=0.0)
    return [one for one in likely if one.score > least][:PLACES]


def _stands_at(tried: Tried, place: BodyPlace) -> bool:
    """Whether a body that was fitted to another place reaches this one, too: the fit here would find it again."""
    one = tried.standing.scene.objects[-1]
    return math.dist(one.position_m[:2], place.position_m[:2]) < max(one.size_m or (0.0,)) / 2.0


def _likely(places: list[BodyPlace], least: float) -> list[BodyPlace]:
    """Places where a body would explain enough of what is there, and at least so much."""
    return [one for one in places if one.share > PROMISING and one.score > least]


def _ratios(standing: Standing) -> list[Ratios]:
    """Measured over modelled power of every image."""
    ratios = []
    for seen, mu in zip(standing.observations, standing.modelled(), strict=True):
        image = np.zeros(seen.interior.shape)
        image[seen.interior] = seen.values / mu
        ratios.append(Ratios(seen.view, image, seen.interior, seen.looks))
    return ratios


def _with_all_else(ground: TrialGround, scene: Scene) -> Standing:
    """Surfaces and effects with the object at their best: in turns, since a step is cheap where no object moves. Where
    paths would be followed for each step, the object stands in the end where single bounces put it."""
    for _ in range(2):
        surfaces = ground.settled(_placed(scene)).scene
        moving = alone(replace(surfaces, objects=scene.objects))
        scene = released(ground.trials.settled(moving, most=LAST_STEPS, flat=LAST_FLAT).scene, surfaces)
    if ground.trials is ground:
        return ground.settled(scene, most=LAST_STEPS, flat=LAST_FLAT)
    whole = ground.settled(_placed(scene))
    return replace(whole, scene=replace(whole.scene, objects=scene.objects))


def _placed(scene: Scene) -> Scene:
    """The scene whose last object stands still."""
    return replace(scene, objects=(*scene.objects[:-1], scene.objects[-1].model_copy(update={"learn": ()})))


def _values_and_words(whole: Standing, best: Tried) -> tuple[dict[str, Any], list[str]]:
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
        words = [f"{one.label}: a point reflector at {east:.2f} m east, {north:.2f} m north; its size means nothing"]
    return values, words
