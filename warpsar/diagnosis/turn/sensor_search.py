"""Which wrong angle or pixel spacing may explain what is left: one Jacobian screens all, and the likeliest are fitted.

They show at edges and shadow borders, hardly inside. So all usable pixels count, on images of exact areas.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import cast

import numpy as np

from warpsar.diagnosis.geometry.base.change import GeometryCandidate, Hypothesis
from warpsar.diagnosis.geometry.base.sensor import SensorChange
from warpsar.diagnosis.geometry.registry import get, sensor_changes
from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.refit import BOUND, Fitted
from warpsar.diagnosis.turn.geometry_search import of_the_first
from warpsar.learning.geometry import still, with_free
from warpsar.learning.pose import foretold_gain, without_shading
from warpsar.learning.pose_search import SEARCH_BLUR_M, PoseSearch, search_poses
from warpsar.runtime import once
from warpsar.scene.scene import Scene

FITTED = 2  # of the screened hypotheses, how many are fitted
NEAR = 0.5  # of the largest foretold gain, from which on another hypothesis is fitted, too
CLOSE = 0.8  # of the largest gain on blurred images, from which on a hypothesis is fitted to sharp ones


def screened_sensor(declared: Scene, setup: FitSetup, here: Fitted) -> tuple[list[Hypothesis], float]:
    """`screening` of all angles and spacings, and of shifts, as the first process finds it."""
    return once.find(lambda: screening(declared, setup, here))


def sensor_candidates(
    declared: Scene, setup: FitSetup, here: Fitted, screened: Sequence[Hypothesis], price: float, least: float
) -> list[GeometryCandidate]:
    """Changes of angles or spacings that pay, each fitted with surface and effects, as the first process finds them.

    One that is foretold less than `least` is not fitted. All others are searched on blurred images, and one that gains
    far less than the best there is not fitted to sharp ones.
    """
    searches = [(one, _searched(setup, here, one)) for one in worth_a_fit(screened, price, least)]
    best = max((search.gain for _, search in searches), default=0.0)
    close = [pair for pair in searches if pair[1].gain >= CLOSE * best]
    without = cache(close[0][1].loss_without) if close else lambda: 0.0  # one fit: all stand on the same model
    found = [_fitted(one, search, without) for one, search in close]
    return of_the_first(declared, here, [one for one in found if 2.0 * one.gain > one.size * price])


def worth_a_fit(screened: Sequence[Hypothesis], price: float, least: float) -> list[Hypothesis]:
    """Those that get a fit, the likeliest first; `price` and `least` as in `sensor_candidates`."""
    worth = [one for one in screened if one.foretold > max(0.5 * one.numbers * price, least)]
    best = max((one.foretold for one in worth), default=0.0)
    order = sorted(worth, key=lambda one: -one.foretold)[:FITTED]
    return [one for one in order if one.foretold >= NEAR * best]


def hypotheses(declared: Scene, here: Fitted) -> list[Hypothesis]:
    """Every hypothesis that the model has not taken yet: angles of each view and of all, and both spacings. A view
    whose azimuth was taken may have another incidence, too."""
    views = _views(here)
    asked = [one for change in sensor_changes() for one in change.hypotheses(declared, here.scene, views)]
    changed = [change.changed(declared, here.scene) for change in sensor_changes()]
    taken = {name for each in changed for names in each.values() for name in names}
    return [one for one in asked if not taken & set(one.parameters)]


def screening(declared: Scene, setup: FitSetup, here: Fitted) -> tuple[list[Hypothesis], float]:
    """What each hypothesis would gain, foretold to second order on blurred images, surface and effects moving along;
    and what a shift of every image by itself would, which no shift common to all exceeds."""
    views = _views(here)
    moved = {one: _sensor_change(one).each(one.parameters, views) for one in hypotheses(declared, here)}
    free = with_free(here.scene, [name for names in moved.values() for name in names])
    problem = Exact.of(setup, here).problem(free, blur_m=SEARCH_BLUR_M[0], bound=BOUND, rough=True)
    left, slope = without_shading(problem, shifts=True)
    count = len(problem.geometry.coordinates)
    found = []
    for one, names in moved.items():
        along = np.array([[c.label in names] for c in problem.geometry.coordinates], float)
        along = np.pad(along, ((0, len(slope) - count), (0, 0)))
        found.append(replace(one, foretold=foretold_gain(along.T @ left @ along, along.T @ slope)))
    return found, foretold_gain(left[count:, count:], slope[count:])


def _searched(setup: FitSetup, here: Fitted, one: Hypothesis) -> PoseSearch:
    free = with_free(here.scene, one.parameters)
    return search_poses(free, setup.device, views=_views(here), observations=setup.observations)


def _fitted(one: Hypothesis, search: PoseSearch, without: Callable[[], float]) -> GeometryCandidate:
    """The scene with the hypothesis at its likeliest, surface and effects fitted along; `without` as in
    `FoundPoses`."""
    found = replace(search.finish(), without=without)
    words = [*found.words, _sensor_change(one).reading(one.label)]
    return GeometryCandidate(one.kind, one.label, still(found.scene), found.gain, found.size, found.numbers, words)


def _views(fitted: Fitted) -> list[str]:
    return [view.view.name for view in fitted.problem.views]


def _sensor_change(one: Hypothesis) -> SensorChange:
    return cast(SensorChange, get(one.kind))
