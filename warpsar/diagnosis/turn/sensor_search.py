"""Which wrong angle or pixel spacing may explain what is left: one Jacobian screens all, and the likeliest are fitted.

They show at edges and shadow borders, hardly inside. So all usable pixels count, on images of exact areas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
from warpsar.learning.pose import PosedProblem, without_shading
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


def screened_sensor(declared: Scene, setup: FitSetup, here: Fitted) -> list[Hypothesis]:
    """`screening` of all angles and spacings, as the first process finds it."""
    return once.find(lambda: screening(declared, setup, here))


def sensor_candidates(
    declared: Scene, setup: FitSetup, here: Fitted, screened: Sequence[Hypothesis], price: float, least: float
) -> list[GeometryCandidate]:
    """Changes of angles or spacings that pay, each fitted with surface and effects, as the first process finds them.
    One that is foretold less than `least` is not fitted."""
    worth = [one for one in screened if one.foretold > max(0.5 * len(one.parameters) * price, least)]
    best = max((one.foretold for one in worth), default=0.0)
    found = []
    for one in sorted(worth, key=lambda one: -one.foretold)[:FITTED]:
        if one.foretold >= NEAR * best:
            found.append(_fitted(declared, setup, here, one))
    return of_the_first(declared, here, [one for one in found if 2.0 * one.gain > one.size * price])


def hypotheses(declared: Scene, here: Fitted) -> list[Hypothesis]:
    """Every hypothesis that the model has not taken yet: angles of each view and of all, and both spacings."""
    views = [view.view.name for view in here.problem.views]
    taken = sensor_changes(declared, here.scene)
    found = [Hypothesis(SPACING, label, (f"image.{key}",)) for label, key in SPACINGS.items()]
    if len(views) > 1:
        found += [Hypothesis(ANGLES, ALL, (f"views.{key}",)) for key in ANGLE_KEYS]
    found += [Hypothesis(ANGLES, name, (f"views.{name}.{key}",)) for name in views for key in ANGLE_KEYS]
    return [one for one in found if name_of(one.kind, one.label) not in taken]


def screening(declared: Scene, setup: FitSetup, here: Fitted) -> list[Hypothesis]:
    """What each hypothesis would gain, foretold to second order on blurred images, surface and effects moving along."""
    asked = hypotheses(declared, here)
    single = [name for one in asked for name in one.parameters if name.count(".") == 2 or name.startswith("image.")]
    problem = Exact.of(setup, here).problem(sensor_freed(here.scene, single), blur_m=SEARCH_BLUR_M[0], bound=BOUND)
    left, slope = without_shading(problem)
    return [
        Hypothesis(one.kind, one.label, one.parameters, _foretold(left, slope, _directions(problem, one)))
        for one in asked
    ]


def _directions(problem: PosedProblem, one: Hypothesis) -> np.ndarray:
    """Where the hypothesis may move the geometry's coordinates, shape (coordinates, parameters)."""
    rows = []
    for name in one.parameters:
        root, _, key = name.partition(".")
        ending = name.rpartition(".")[2]
        common = root == "views" and "." not in key
        moved = [
            c.label == name or (common and c.parameter.root == "views" and c.parameter.key == ending)
            for c in problem.geometry.coordinates
        ]
        rows.append(np.array(moved, float))
    return np.stack(rows, axis=1)


def _foretold(left: np.ndarray, slope: np.ndarray, directions: np.ndarray) -> float:
    """The gain of the best step along the directions, to second order."""
    own, along = directions.T @ left @ directions, directions.T @ slope
    return 0.5 * float(along @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ along)


def _fitted(declared: Scene, setup: FitSetup, here: Fitted, one: Hypothesis) -> GeometryCandidate:
    """The scene with the hypothesis at its likeliest, surface and effects fitted along."""
    views = [view.view.name for view in here.problem.views]
    free = sensor_freed(here.scene, one.parameters)
    found = find_poses(free, setup.device, views=views, observations=setup.observations)
    scene = still(found.scene)
    words = [*found.words, reading(one.kind, one.label)]
    return GeometryCandidate(one.kind, one.label, scene, found.gain, found.size, found.numbers, words)
