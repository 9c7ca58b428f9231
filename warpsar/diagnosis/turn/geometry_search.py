"""Which changes of geometry may explain what is left: every body is screened at little cost, and the best are fitted.

The screening takes no fit. Images blurred to 3 m are differentiated by every body's pose at once; what surface and
effects can imitate is taken out; and the gain is foretold to second order. Without a body, the images tell by
themselves. A hundred bodies whose pixels do not meet so cost about what a few do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from warpsar.diagnosis.geometry.base.body import BodyChange, BodyScreening
from warpsar.diagnosis.geometry.base.change import GeometryCandidate, Hypothesis
from warpsar.diagnosis.geometry.registry import body_changes, content, get, names, scene_with
from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.effect_gain import FAR_BEHIND, EffectGain
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.movable import bodies, disjoint, freed
from warpsar.diagnosis.models.refit import BOUND, Fitted
from warpsar.diagnosis.proposals.places import covers
from warpsar.learning.geometry import still
from warpsar.learning.pose_search import SEARCH_BLUR_M
from warpsar.runtime import once
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Learnable, Object

TOGETHER = 16  # bodies of one screening problem: seven columns each, on all pixels
FITTED = 2  # of the screened poses and sizes, how many bodies are fitted
NEARLY = 0.8  # of what a new body gains that stands within another one, for the other's size to be the reading
FAR_BEHIND_OTHERS = 0.8  # of what the best search gains on blurred images: one that gains less is not fitted to its end


def screened_bodies(declared: Scene, setup: FitSetup, here: Fitted, *, alarm: bool = True) -> list[Hypothesis]:
    """`screening` of all bodies, as the first process finds it."""
    return once.find(lambda: screening(declared, Exact.of(setup, here), here, alarm=alarm))


def geometry_candidates(
    declared: Scene,
    setup: FitSetup,
    here: Fitted,
    screened: list[Hypothesis],
    price: float,
    effect_gain: EffectGain,
    sensor: Sequence[GeometryCandidate] = (),
) -> list[GeometryCandidate]:
    """Changes of geometry that are worth a comparison with the effects; `screened` are all bodies.

    A number that a change frees costs `price` of 2 ln L. `effect_gain`: of the best effect. `sensor`: what is offered
    already; what is far behind that, or behind what a moved body gains, is not proposed (`GeometryChange.proposed`).
    """

    def run() -> list[GeometryCandidate]:
        moved = body_candidates(declared, setup, here, screened, price, effect_gain)
        most = max([effect_gain.sharp, *(one.gain for one in [*sensor, *moved])])
        kinds = map(get, names())
        new = [one for kind in kinds for one in kind.proposed(setup, here, price, FAR_BEHIND * most)]
        return [*moved, *(_or_grown(declared, setup, here, one) for one in new)]

    return of_the_first(declared, here, once.agree(run))


def of_the_first(declared: Scene, here: Fitted, found: list[GeometryCandidate]) -> list[GeometryCandidate]:
    """The candidates that the first process found, for all."""
    first = once.find(lambda: [(content(declared, one.scene), replace(one, scene=cast(Scene, None))) for one in found])
    return [replace(one, scene=still(scene_with(declared, here.scene, scene))) for scene, one in first]


def body_candidates(
    declared: Scene, setup: FitSetup, here: Fitted, screened: list[Hypothesis], price: float, effect_gain: EffectGain
) -> list[GeometryCandidate]:
    """The bodies that stand elsewhere, are of another size, or are not there, most likely.

    One that is behind the best effect is not fitted; the next turn tries it again.
    """
    worth = worth_fits(screened, price, effect_gain)
    searches = {one: _body_change(one).search(declared, setup, here, one.label) for one in worth}
    least = FAR_BEHIND_OTHERS * max((one.gain for one in searches.values() if one is not None), default=0.0)
    found = []
    for label in dict.fromkeys(one.label for one in worth):
        of_body: list[GeometryCandidate] = []
        for one, search in searches.items():
            if one.label == label and (search is None or search.gain >= least):
                of_body += _body_change(one).candidates(declared, setup, here, label, search)
        for change in body_changes():
            of_body = change.one_reading(of_body)
        found += of_body
    return [one for one in found if 2.0 * one.gain > one.size * price]


def _or_grown(declared: Scene, setup: FitSetup, here: Fitted, one: GeometryCandidate) -> GeometryCandidate:
    """The candidate; of a body that is new and stands within one of the scene, that one in another size, if this
    explains nearly as much. Two bodies are at no one place, and a new one has numbers enough to take up what else is
    wrong."""
    known = {each.label for each in here.scene.objects}
    new = [each for each in one.scene.objects if each.label not in known]
    label = _around(here.scene, new[0]) if len(new) == 1 and new[0].group is None else None
    if label is None:
        return one
    for change in (each for each in body_changes() if each.grows_a_body):
        search = change.search(declared, setup, here, label)
        for other in change.candidates(declared, setup, here, label, search):
            if other.gain > NEARLY * one.gain:
                return other
    return one


def _around(scene: Scene, one: Object) -> str | None:
    """The smallest body of the scene that has a face above or below an object's middle; None where there is none.

    Faces count, and not the outline of all: the walls of a town are one group, and what lies between two houses is
    within neither of them.
    """
    found: list[tuple[float, str]] = []
    for label, faces in bodies(scene, scene).items():
        corners = scene.mesh.vertices[scene.mesh.faces[faces]]
        if covers(corners, one.position_m[:2]):
            found.append((float(np.ptp(corners[..., :2].reshape(-1, 2), axis=0).prod()), label))
    return min(found, default=(0.0, None))[1]


def worth_fits(screened: Sequence[Hypothesis], price: float, effect_gain: EffectGain) -> list[Hypothesis]:
    """Those that are fitted: of the likeliest `FITTED` bodies all that may have moved, and of what cannot be searched
    by steps, such as an absent body, the likeliest one. `price` and `effect_gain` as in `geometry_candidates`."""
    least = max(0.5 * price, effect_gain.least)
    moving = [one for one in screened if _body_change(one).by_steps]
    most: dict[str, float] = {}
    for one in moving:
        most[one.label] = max(one.foretold, most.get(one.label, one.foretold))
    likeliest = sorted(most, key=lambda label: -most[label])[:FITTED]
    found = [one for label in likeliest for one in moving if one.label == label and one.foretold > least]
    for change in (each for each in body_changes() if not each.by_steps):
        mine = [one for one in screened if one.kind == change.name]
        best = max(mine, key=lambda one: one.foretold, default=None)
        found += [best] if best is not None and best.foretold > least else []
    return found


def screening(declared: Scene, exact: Exact, here: Fitted, *, alarm: bool = True) -> list[Hypothesis]:
    """Every change of every body of the scene, with what it would gain at a blur of 3 m; without an `alarm` those that
    a quiet scene may have."""
    asked = [one for one in body_changes() if alarm or one.in_quiet_scenes]
    found = []
    for labels in disjoint(bodies(declared, here.scene), TOGETHER):
        free = freed(here.scene, labels, _screened_words)
        problem = exact.problem(free, blur_m=SEARCH_BLUR_M[0], bound=BOUND, on_ground=False, rough=True)
        blurred = BodyScreening(declared, exact, here, problem)
        for label in labels:
            gains = ((one, one.foretold(blurred, label)) for one in asked)
            found += [Hypothesis(one.name, label, gain, one.frees) for one, gain in gains if gain is not None]
    return found


def _screened_words(one: Object) -> tuple[Learnable, ...]:
    """All that may move of a body."""
    return tuple(word for change in body_changes() for word in change.screened_words(one))


def _body_change(one: Hypothesis) -> BodyChange:
    return cast(BodyChange, get(one.kind))
