"""Which changes of geometry may explain what is left: every body is screened at little cost, and the best are fitted.

The screening takes no fit. Images blurred to 3 m are differentiated by every body's pose at once; what surface and
effects can imitate is taken out; and the gain is foretold to second order. Without a body, the images tell by
themselves. A hundred bodies whose pixels do not meet so cost about what a few do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from warpsar.diagnosis.models.all_pixels import Exact, still
from warpsar.diagnosis.models.bench import Bench
from warpsar.diagnosis.models.change import ABSENT, POSE, GeometryCandidate, heard, told, without_object
from warpsar.diagnosis.models.lead import Lead
from warpsar.diagnosis.models.movable import bodies, disjoint, freed, placeable
from warpsar.diagnosis.models.refit import BOUND, Fitted
from warpsar.diagnosis.proposals.search import missing_objects
from warpsar.effects.registry import get
from warpsar.learning.pose import PosedProblem
from warpsar.learning.pose_search import SEARCH_BLUR_M, find_poses
from warpsar.runtime.matmul import transposed_times
from warpsar.scene.scene import Scene
from warpsar.world.objects.pose import foot
from warpsar.world.sound_objects import misplaced, surfaces_at

TOGETHER = 16  # bodies of one screening problem: four columns each, on all pixels
FITTED = 2  # of the screened poses, how many are fitted

Source = Callable[[Scene, Bench, Fitted, float, Lead], list[GeometryCandidate]]


@dataclass(frozen=True)
class Screened:
    """What moving a body, or leaving it out, would gain of the log-likelihood of blurred images, foretold."""

    label: str
    moved: float
    absent: float


def geometry_candidates(
    declared: Scene, bench: Bench, here: Fitted, price: float, lead: Lead
) -> list[GeometryCandidate]:
    """Changes of geometry that are worth a comparison with the effects, as the first rank finds them.

    A number that a change frees costs `price` of 2 ln L. `lead`: of the best effect.
    """
    found = bench.ranks.agree(
        lambda: [
            *moved_or_absent(declared, bench, here, price, lead),
            *(one for source in SOURCES for one in source(declared, bench, here, price, lead)),
        ]
    )
    mine = [
        [one.kind, one.object, told(declared, one.scene), one.gain, one.size, one.values, one.words] for one in found
    ]
    return [
        GeometryCandidate(kind, label, still(heard(declared, here.scene, scene)), gain, size, values, words)
        for kind, label, scene, gain, size, values, words in bench.ranks.gather(mine)[0]
    ]


def moved_or_absent(declared: Scene, bench: Bench, here: Fitted, price: float, lead: Lead) -> list[GeometryCandidate]:
    """The bodies that stand elsewhere, or are not there, most likely.

    One that is behind the best effect is not fitted; the next turn tries it again.
    """
    exact = Exact.of(bench, here)
    screened = screening(declared, exact, here)
    least = max(0.5 * price, lead.least)
    found = []
    for one in sorted(screened, key=lambda one: -one.moved)[:FITTED]:
        if one.moved > least:
            found += _moved(declared, bench, here, one.label)
    absent = max(screened, key=lambda one: one.absent, default=None)
    if absent is not None and absent.absent > least:
        found.append(_absent(declared, exact, here, absent.label))
    return [one for one in found if 2.0 * one.gain > one.size * price]


def screening(declared: Scene, exact: Exact, here: Fitted) -> list[Screened]:
    """Every body of the scene, with what its move and its absence would gain at a blur of 3 m."""
    blur_m = SEARCH_BLUR_M[0]
    found = []
    for labels in disjoint(bodies(declared, here.scene), TOGETHER):
        problem = exact.problem(freed(here.scene, labels), blur_m=blur_m, bound=BOUND)
        loss = problem.value(problem.x0)
        moved = _foretold(problem)
        for label in labels:
            found.append(Screened(label, moved[label], loss - _without(declared, exact, here, label, blur_m)))
    return found


def _without(declared: Scene, exact: Exact, here: Fitted, label: str, blur_m: float) -> float:
    """The loss of blurred images without a body; infinite where an effect needs it, by its material."""
    scene = still(without_object(declared, here.scene, label))
    if any(get(name).check(scene, table) for name, table in scene.effects.items()):
        return np.inf
    problem = exact.problem(scene, blur_m=blur_m, bound=BOUND)
    return problem.value(problem.x0)


def _foretold(problem: PosedProblem) -> dict[str, float]:
    """By the object's label, the gain of the best step of its pose, with surface and effects moving along."""
    jacobians = problem.jacobian(problem.x0)
    inner, rest = problem.split(problem.x0)
    gradient, hessian = -problem.prior.gradient(problem.x0), problem.prior.information(problem.x0)
    for j, c in zip(jacobians, inner.curvatures(inner.modelled(rest)), strict=True):
        weighted = c.weight[:, None] * j
        gradient = gradient + weighted.T @ c.residual
        hessian = hessian + transposed_times(j, weighted)
    own, n = slice(0, problem.size), problem.size
    along = np.linalg.pinv(hessian[own, own], rcond=1e-9, hermitian=True) @ np.column_stack(
        [hessian[own, n:], gradient[own]]
    )
    left = hessian[n:, n:] - hessian[n:, own] @ along[:, :-1]
    slope = gradient[n:] - hessian[n:, own] @ along[:, -1]
    numbers: dict[str, list[int]] = {}
    for k, one in enumerate(problem.poses.coordinates):
        numbers.setdefault(problem.poses.objects[one.object].label, []).append(k)
    return {
        label: 0.5 * float(slope[at] @ np.linalg.pinv(left[np.ix_(at, at)], rcond=1e-9, hermitian=True) @ slope[at])
        for label, at in numbers.items()
    }


def _moved(declared: Scene, bench: Bench, here: Fitted, label: str) -> list[GeometryCandidate]:
    """The body at its likeliest pose; nothing where that is in the ground or outside the images."""
    free = freed(here.scene, [label])
    if not placeable(declared, here.scene, [label]):
        one = next(one for one in free.objects if one.label == label)
        if one.round:
            return []
        free = freed(here.scene, [label], ("heading",))
    found = find_poses(free, bench.device, views=_views(here), observations=bench.observations)
    scene = still(found.scene)
    if misplaced(scene):
        return []
    return [GeometryCandidate(POSE, label, scene, found.gain, found.size, found.objects[label], found.words)]


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
        words.append(f"{label}: the mesh has no ground where it stood; what measures power there has no model")
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
