"""A body is not there; its shadow and its layover are gone with it."""

from __future__ import annotations

import numpy as np

from warpsar.diagnosis.geometry.base.body import BodyChange, BodyScreening
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.change import BodyDifference, composed, removed_groups, without_object
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.movable import freed
from warpsar.diagnosis.models.refit import BOUND, Fitted
from warpsar.effects.registry import get
from warpsar.learning.geometry import still
from warpsar.learning.pose_search import SEARCH_BLUR_M, PoseSearch
from warpsar.scene.scene import Scene
from warpsar.world.objects.pose import foot
from warpsar.world.sound_objects import surfaces_at


class AbsentObject(BodyChange):
    """It frees nothing; which body is absent counts as one number."""

    name = "absent_object"
    order = 30
    summary = "an object of the scene is not there"
    frees = 1
    edges_doubt = False  # it is there or it is not: no remainder elsewhere puts that in doubt
    in_quiet_scenes = False  # it leaves a shadow that measures power, and edges: no quiet scene has one

    def is_of(self, difference: BodyDifference) -> bool:
        return difference.now is None

    def numbers(self, declared: Scene, scene: Scene, label: str) -> int:
        return self.frees

    def taken_back(self, declared: Scene, scene: Scene, label: str) -> Scene:
        was = [one for one in declared.objects if one.label == label]
        removed = [group for group in removed_groups(scene) if group != label]
        return composed(declared, scene, [*(one for one in scene.objects if one.label != label), *was], removed)

    def foretold(self, screening: BodyScreening, label: str) -> float | None:
        """The loss of blurred images less that without the body; no gain where an effect needs it, by its material."""
        scene = still(without_object(screening.declared, screening.here.scene, label))
        if any(get(name).check(scene, table) for name, table in scene.effects.items()):
            return -np.inf
        problem = screening.exact.problem(scene, blur_m=SEARCH_BLUR_M[0], bound=BOUND, rough=True)
        return screening.loss - problem.value(problem.x0)

    def candidates(
        self, declared: Scene, setup: FitSetup, here: Fitted, label: str, search: PoseSearch | None
    ) -> list[GeometryCandidate]:
        exact, without = Exact.of(setup, here), still(without_object(declared, here.scene, label))
        losses = [exact.settled(scene)[1].loss for scene in (still(here.scene), without)]
        standing = freed(here.scene, [label])
        assert standing.assembly is not None
        vertices = standing.assembly.vertices_of(next(one for one in standing.objects if one.label == label))
        at = foot(vertices)
        values = {"absent": True, "position_m": at.tolist(), "size_m": np.ptp(vertices, axis=0).tolist()}
        words = []
        if _hole(without, vertices, at):
            words.append(f"{label}: the mesh has no ground where it stood; power that is measured there has no model")
        return [GeometryCandidate(self.name, label, without, losses[0] - losses[1], self.frees, values, words)]


def _hole(scene: Scene, vertices: np.ndarray, at: np.ndarray) -> bool:
    """Whether nothing of the scene lies below or above some place of a body's foot: its middle, or one near the end of
    its extent."""
    reach = 0.45 * np.ptp(vertices, axis=0)[:2]
    places = [at[:2] + reach * way for way in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
    corners = scene.mesh.vertices[scene.mesh.faces]
    return any(not len(surfaces_at(corners, place)) for place in places)


CHANGE = AbsentObject()
