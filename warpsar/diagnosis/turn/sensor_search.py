"""Which wrong angle or pixel spacing may explain what is left: one Jacobian screens all, and the likeliest are fitted.

They show at edges and shadow borders, hardly inside. So all usable pixels count, on images of exact areas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.change import GeometryCandidate
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.names import name_of
from warpsar.diagnosis.models.refit import BOUND, Fitted
from warpsar.diagnosis.models.sensor import (
    ALL,
    ANGLE_KEYS,
    ANGLES,
    SPACING,
    SPACINGS,
    reading,
    sensor_changes,
    sensor_freed,
)
from warpsar.diagnosis.turn.geometry_search import of_the_first
from warpsar.learning.geometry import still
from warpsar.learning.pose import foretold_gain, without_shading
from warpsar.learning.pose_search import SEARCH_BLUR_M, find_poses
from warpsar.runtime import once
from warpsar.scene.scene import Scene

FITTED = 2  # of the screened hypotheses, how many are fitted
NEAR = 0.5  # of the largest foretold gain, from which on another hypothesis is fitted, too


@dataclass(frozen=True)
class Hypothesis:
    """Angles or spacings that are freed together: what the change is called, its parameters, its foretold gain."""

    kind: str
    label: str
    parameters: tuple[str, ...]
    foretold: float = 0.0


def screened_sensor(declared: Scene, setup: FitSetup, here: Fitted) -> tuple[list[Hypothesis], float]:
    """`screening` of all angles and spacings, and of shifts, as the first process finds it."""
    return once.find(lambda: screening(declared, setup, here))


def sensor_candidates(
    declared: Scene, setup: FitSetup, here: Fitted, screened: Sequence[Hypothesis], price: float, least: float
) -> list[GeometryCandidate]:
    """Changes of angles or spacings that pay, each fitted with surface and effects, as the first process finds them.
    One that is foretold less than `least` is not fitted."""
    found = [_fitted(declared, setup, here, one) for one in worth_a_fit(screened, price, least)]
    return of_the_first(declared, here, [one for one in found if 2.0 * one.gain > one.size * price])


def worth_a_fit(screened: Sequence[Hypothesis], price: float, least: float) -> list[Hypothesis]:
    """Those that get a fit, the likeliest first; `price` and `least` as in `sensor_candidates`."""
    worth = [one for one in screened if one.foretold > max(0.5 * len(one.parameters) * price, least)]
    best = max((one.foretold for one in worth), default=0.0)
    order = sorted(worth, key=lambda one: -one.foretold)[:FITTED]
    return [one for one in order if one.foretold >= NEAR * best]


def hypotheses(declared: Scene, here: Fitted) -> list[Hypothesis]:
    """Every hypothesis that the model has not taken yet: angles of each view and of all, and both spacings.

    Where all views were turned, the angle of one is not offered, nor the reverse: two such turns of one angle would not
    be told apart by the angles that they leave.
    """
    views = [view.view.name for view in here.problem.views]
    taken = sensor_changes(declared, here.scene)
    found = [Hypothesis(SPACING, label, (f"image.{key}",)) for label, key in SPACINGS.items()]
    if len(views) > 1:
        found += [Hypothesis(ANGLES, ALL, (f"views.{key}",)) for key in ANGLE_KEYS]
    found += [Hypothesis(ANGLES, name, (f"views.{name}.{key}",)) for name in views for key in ANGLE_KEYS]
    turned = [parameter for parameters in taken.values() for parameter in parameters if parameter.startswith("views.")]

    def mixed(one: Hypothesis) -> bool:
        key = one.parameters[0].rpartition(".")[2]
        others = [each for each in turned if each.endswith(f".{key}")]
        return any((each == f"views.{key}") != (one.label == ALL) for each in others)

    return [one for one in found if name_of(one.kind, one.label) not in taken and not mixed(one)]


def screening(declared: Scene, setup: FitSetup, here: Fitted) -> tuple[list[Hypothesis], float]:
    """What each hypothesis would gain, foretold to second order on blurred images, surface and effects moving along;
    and what a shift of every image by itself would, which no shift common to all exceeds."""
    views = [view.view.name for view in here.problem.views]
    moved = {one: _moved(one, views) for one in hypotheses(declared, here)}
    free = sensor_freed(here.scene, [name for names in moved.values() for name in names])
    problem = Exact.of(setup, here).problem(free, blur_m=SEARCH_BLUR_M[0], bound=BOUND, rough=True)
    left, slope = without_shading(problem, shifts=True)
    count = len(problem.geometry.coordinates)
    found = []
    for one, names in moved.items():
        along = np.array([[c.label in names] for c in problem.geometry.coordinates], float)
        along = np.pad(along, ((0, len(slope) - count), (0, 0)))
        found.append(replace(one, foretold=foretold_gain(along.T @ left @ along, along.T @ slope)))
    return found, foretold_gain(left[count:, count:], slope[count:])


def _moved(one: Hypothesis, views: Sequence[str]) -> list[str]:
    """The dotted names of what a hypothesis moves alike: of each view, where it turns all."""
    if one.label != ALL:
        return list(one.parameters)
    return [f"views.{view}.{name.rpartition('.')[2]}" for name in one.parameters for view in views]


def _fitted(declared: Scene, setup: FitSetup, here: Fitted, one: Hypothesis) -> GeometryCandidate:
    """The scene with the hypothesis at its likeliest, surface and effects fitted along."""
    views = [view.view.name for view in here.problem.views]
    free = sensor_freed(here.scene, one.parameters)
    found = find_poses(free, setup.device, views=views, observations=setup.observations)
    scene = still(found.scene)
    words = [*found.words, reading(one.kind, one.label)]
    return GeometryCandidate(one.kind, one.label, scene, found.gain, found.size, found.numbers, words)
