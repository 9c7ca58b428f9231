"""Which changes of geometry may explain what is left: every body is screened at little cost, and the best are fitted.

The screening takes no fit. Images blurred to 3 m are differentiated by every body's pose at once; what surface and
effects can imitate is taken out; and the gain is foretold to second order. Without a body, the images tell by
themselves. A hundred bodies whose pixels do not meet so cost about what a few do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.change import (
    ABSENT,
    POSE,
    SIZE,
    SIZES,
    GeometryCandidate,
    Kind,
    content,
    scene_with,
    without_object,
)
from warpsar.diagnosis.models.effect_gain import FAR_BEHIND, EffectGain
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.movable import POSE_WORDS, bodies, disjoint, freed, placeable, sized
from warpsar.diagnosis.models.refit import BOUND, Fitted
from warpsar.diagnosis.proposals.search import missing_objects
from warpsar.effects.registry import get
from warpsar.learning.geometry import still
from warpsar.learning.pose import PosedProblem, foretold_gain, without_shading
from warpsar.learning.pose_search import SEARCH_BLUR_M, FoundPoses, PoseSearch, search_poses
from warpsar.runtime import once
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.pose import foot
from warpsar.world.objects.table import Learnable
from warpsar.world.sound_objects import misplaced, surfaces_at

TOGETHER = 16  # bodies of one screening problem: seven columns each, on all pixels
FITTED = 2  # of the screened poses and sizes, how many bodies are fitted
FAR_BEHIND_OTHERS = 0.8  # of what the best search gains on blurred images: one that gains less is not fitted to its end
SAME_IMAGES = 3.0  # of ln L: two readings of one body that differ by less explain the images alike

Source = Callable[[FitSetup, Fitted, float, float], list[GeometryCandidate]]
"""Further changes of geometry, each by itself: of a model, by the price of a number and the least of ln L that is worth
a fit."""


@dataclass(frozen=True)
class Screened:
    """What moving a body, another size about its foot, or leaving it out would gain of the log-likelihood of blurred
    images, foretold."""

    label: str
    moved: float
    resized: float
    absent: float

    @property
    def most(self) -> float:
        return max(self.moved, self.resized, self.absent)


def screened_bodies(declared: Scene, setup: FitSetup, here: Fitted, *, absent: bool = True) -> list[Screened]:
    """`screening` of all bodies, as the first process finds it."""
    return once.find(lambda: screening(declared, Exact.of(setup, here), here, absent=absent))


def geometry_candidates(
    declared: Scene,
    setup: FitSetup,
    here: Fitted,
    screened: list[Screened],
    price: float,
    effect_gain: EffectGain,
    sensor: Sequence[GeometryCandidate] = (),
) -> list[GeometryCandidate]:
    """Changes of geometry that are worth a comparison with the effects; `screened` are all bodies.

    A number that a change frees costs `price` of 2 ln L. `effect_gain`: of the best effect. `sensor`: what is offered
    already; what is far behind that, or behind what a moved body gains, is not looked for by `SOURCES`.
    """

    def run() -> list[GeometryCandidate]:
        moved = moved_or_absent(declared, setup, here, screened, price, effect_gain)
        most = max([effect_gain.sharp, *(one.gain for one in [*sensor, *moved])])
        return [*moved, *(one for source in SOURCES for one in source(setup, here, price, FAR_BEHIND * most))]

    return of_the_first(declared, here, once.agree(run))


def of_the_first(declared: Scene, here: Fitted, found: list[GeometryCandidate]) -> list[GeometryCandidate]:
    """The candidates that the first process found, for all."""
    first = once.find(lambda: [(content(declared, one.scene), replace(one, scene=cast(Scene, None))) for one in found])
    return [replace(one, scene=still(scene_with(declared, here.scene, scene))) for scene, one in first]


def moved_or_absent(
    declared: Scene, setup: FitSetup, here: Fitted, screened: list[Screened], price: float, effect_gain: EffectGain
) -> list[GeometryCandidate]:
    """The bodies that stand elsewhere, are of another size, or are not there, most likely.

    One that is behind the best effect is not fitted; the next turn tries it again.
    """
    worth = worth_fits(screened, price, effect_gain)
    searches = {one: _searched(declared, setup, here, *one) for one in worth if one[0] != ABSENT}
    least = FAR_BEHIND_OTHERS * max((one.gain for one in searches.values() if one is not None), default=0.0)
    found = []
    for label in dict.fromkeys(label for _, label in worth):
        asked = [(kind, searches.get((kind, label))) for kind in (POSE, SIZE)]
        fitted = [(kind, one.finish()) for kind, one in asked if one is not None and one.gain >= least]
        found += _one_reading([one for kind, each in fitted for one in _candidate(kind, label, each)])
        found += [_absent(declared, Exact.of(setup, here), here, label)] if (ABSENT, label) in worth else []
    return [one for one in found if 2.0 * one.gain > one.size * price]


def worth_fits(screened: Sequence[Screened], price: float, effect_gain: EffectGain) -> list[tuple[Kind, str]]:
    """Which changes of which bodies are fitted: those of the likeliest `FITTED` in pose or size, and the likeliest
    absent one. `price` and `effect_gain` as in `geometry_candidates`."""
    least = max(0.5 * price, effect_gain.least)
    found: list[tuple[Kind, str]] = []
    for one in sorted(screened, key=lambda one: -max(one.moved, one.resized))[:FITTED]:
        found += [(POSE, one.label)] if one.moved > least else []
        found += [(SIZE, one.label)] if one.resized > least else []
    absent = max(screened, key=lambda one: one.absent, default=None)
    return [*found, (ABSENT, absent.label)] if absent is not None and absent.absent > least else found


def screening(declared: Scene, exact: Exact, here: Fitted, *, absent: bool = True) -> list[Screened]:
    """Every body of the scene, with what its move and, where that is asked, its being `absent` would gain at a blur of
    3 m."""
    blur_m = SEARCH_BLUR_M[0]
    found = []
    for labels in disjoint(bodies(declared, here.scene), TOGETHER):
        free = _of_any_size(freed(here.scene, labels), labels)
        problem = exact.problem(free, blur_m=blur_m, bound=BOUND, on_ground=False, rough=True)
        loss = problem.value(problem.x0)
        foretold = _foretold(problem)
        for label in labels:
            gone = loss - _without(declared, exact, here, label, blur_m) if absent else 0.0
            found.append(Screened(label, *foretold[label], gone))
    return found


def _of_any_size(scene: Scene, labels: Sequence[str]) -> Scene:
    """The scene whose bodies `labels` are free in size, too."""
    by = {one.label: one for one in scene.objects}
    return with_objects(scene, [sized(one) if label in labels else one for label, one in by.items()])


def _without(declared: Scene, exact: Exact, here: Fitted, label: str, blur_m: float) -> float:
    """The loss of blurred images without a body; infinite where an effect needs it, by its material."""
    scene = still(without_object(declared, here.scene, label))
    if any(get(name).check(scene, table) for name, table in scene.effects.items()):
        return np.inf
    problem = exact.problem(scene, blur_m=blur_m, bound=BOUND, rough=True)
    return problem.value(problem.x0)


def _foretold(problem: PosedProblem) -> dict[str, tuple[float, float]]:
    """By the object's label, the gain of the best step of its pose, and of its size, surface and effects moving
    along."""
    left, slope = without_shading(problem)
    numbers: dict[str, tuple[list[int], list[int]]] = {}
    for k, one in enumerate(problem.geometry.coordinates):
        if one.body is not None:
            numbers.setdefault(one.body, ([], []))[one.parameter.key in SIZES].append(k)

    def gain(at: list[int]) -> float:
        return foretold_gain(left[np.ix_(at, at)], slope[at]) if at else 0.0

    return {label: (gain(pose), gain(size)) for label, (pose, size) in numbers.items()}


def _searched(declared: Scene, setup: FitSetup, here: Fitted, kind: Kind, label: str) -> PoseSearch | None:
    """A search of the body's size about its foot, or of its pose: of its heading alone where nothing else can be
    placed, and none where that looks the same."""
    words: Sequence[Learnable] = ("scale",) if kind == SIZE else POSE_WORDS
    if kind == POSE and not placeable(declared, here.scene, [label]):
        if any(one.label == label and one.round for one in freed(here.scene, [label]).objects):
            return None
        words = ("heading",)
    free = freed(here.scene, [label]) if words is POSE_WORDS else freed(here.scene, [label], tuple(words))
    return search_poses(free, setup.device, views=_views(here), observations=setup.observations)


def _candidate(kind: Kind, label: str, found: FoundPoses) -> list[GeometryCandidate]:
    """The body at its likeliest pose or size; nothing where that is in the ground or outside the images."""
    scene = still(found.scene)
    if misplaced(scene):
        return []
    return [GeometryCandidate(kind, label, scene, found.gain, found.size, found.objects[label], found.words)]


def _one_reading(found: list[GeometryCandidate]) -> list[GeometryCandidate]:
    """A body elsewhere and the same body of another size. A body that is sunk looks as one that is lower: where both
    explain the images alike they are one hypothesis, which has the name of its size and says the other reading."""
    if len(found) < 2 or abs(found[0].gain - found[1].gain) > SAME_IMAGES:
        return found
    other, one = found
    east, north, up = other.values["position_m"]
    words = (
        f"{one.object}: the same images come from a body of the declared size that stands {east:+.2f} m east, "
        f"{north:+.2f} m north and {up:+.2f} m up of where it is declared; a survey of its height would decide"
    )
    return [replace(one, words=[*one.words, words])]


def _absent(declared: Scene, exact: Exact, here: Fitted, label: str) -> GeometryCandidate:
    """The scene without the body. Which one is absent counts as one number."""
    without = still(without_object(declared, here.scene, label))
    losses = [exact.settled(scene)[1].loss for scene in (still(here.scene), without)]
    standing = freed(here.scene, [label])
    assert standing.assembly is not None
    one = next(one for one in standing.objects if one.label == label)
    vertices = standing.assembly.vertices_of(one)
    at = foot(vertices)
    values = {"absent": True, "position_m": at.tolist(), "size_m": np.ptp(vertices, axis=0).tolist()}
    words = []
    if _hole(without, vertices, at):
        words.append(f"{label}: the mesh has no ground where it stood; power that is measured there has no model")
    return GeometryCandidate(ABSENT, label, without, losses[0] - losses[1], 1, values, words)


def _hole(scene: Scene, vertices: np.ndarray, at: np.ndarray) -> bool:
    """Whether nothing of the scene lies below or above some place of a body's foot: its middle, or one near the end of
    its extent."""
    reach = 0.45 * np.ptp(vertices, axis=0)[:2]
    places = [at[:2] + reach * way for way in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
    corners = scene.mesh.vertices[scene.mesh.faces]
    return any(not len(surfaces_at(corners, place)) for place in places)


def _views(fitted: Fitted) -> list[str]:
    return [view.view.name for view in fitted.problem.views]


SOURCES: tuple[Source, ...] = (missing_objects,)
"""What else finds changes of geometry, each by itself."""
