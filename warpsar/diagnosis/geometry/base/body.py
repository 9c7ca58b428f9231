"""A change of one body: an object of the scene, or a group of its mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from warpsar.diagnosis.geometry.base.change import GeometryCandidate, GeometryChange, Section
from warpsar.diagnosis.models.all_pixels import Exact
from warpsar.diagnosis.models.change import BodyDifference, composed, differences, removed_groups
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.movable import freed, placeable
from warpsar.diagnosis.models.refit import Fitted
from warpsar.learning.geometry import still
from warpsar.learning.pose import PosedProblem, foretold_gain, without_shading
from warpsar.learning.pose_search import FoundPoses, PoseSearch, search_poses
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import KEYS, Learnable, Object
from warpsar.world.sound_objects import misplaced


@dataclass(frozen=True)
class BodyScreening:
    """What blurred images say of some bodies of the model `here` at once: `problem` frees all that may move of them."""

    declared: Scene
    exact: Exact
    here: Fitted
    problem: PosedProblem

    @cached_property
    def loss(self) -> float:
        """Of the bodies where they stand."""
        return self.problem.value(self.problem.x0)

    @cached_property
    def _curvature(self) -> tuple[np.ndarray, np.ndarray]:
        return without_shading(self.problem)

    def foretold(self, label: str, keys: frozenset[str]) -> float:
        """The gain of the best step of a body's numbers of these keys, surface and effects moving along."""
        coordinates = self.problem.geometry.coordinates
        at = [k for k, one in enumerate(coordinates) if one.body == label and one.parameter.key in keys]
        left, slope = self._curvature
        return foretold_gain(left[np.ix_(at, at)], slope[at]) if at else 0.0


class BodyChange(GeometryChange):
    """What is asked of a body's change beside what is asked of all."""

    section: ClassVar[Section] = "objects"
    frees: ClassVar[int]  # numbers of a body that the screening counts
    by_steps: ClassVar[bool] = False  # whether a search goes there step by step from where the body stands
    grows_a_body: ClassVar[bool] = False  # whether a body that is new within another one may be this change of that
    in_quiet_scenes: ClassVar[bool] = True  # whether it is looked for where nothing else raises an alarm
    commented: ClassVar[tuple[str, ...]] = ()
    """Keys of `[[objects]]` beside whose values the written scene has standard deviations, as comments."""

    def is_of(self, difference: BodyDifference) -> bool:
        """Whether a difference of two scenes is this change. Of several that could be, the last one in `order` is."""
        raise NotImplementedError

    def words(self, one: Object) -> tuple[Learnable, ...]:
        """What a fit frees of an object that stands in the scene."""
        return ()

    def coordinates(self, declared: Scene, scene: Scene, label: str) -> list[str]:
        """None where nothing can be placed: a free aim point of every view takes all positions."""
        words = next((self.words(one) for one in scene.objects if one.label == label), ())
        if not placeable(declared, scene, {one.label for one in differences(declared, scene)}):
            words = tuple(word for word in words if word != "position")
        return [f"objects.{label}.{KEYS[word]}" for word in words]

    def taken_back(self, declared: Scene, scene: Scene, label: str) -> Scene:
        was = [one for one in declared.objects if one.label == label]
        objects = [each for one in scene.objects for each in (was if one.label == label else [one])]
        return composed(declared, scene, objects, removed_groups(scene))

    def values(
        self, declared: Scene, scene: Scene, label: str, first: Mapping[str, Any], posed: FoundPoses | None
    ) -> dict[str, Any]:
        objects, words = ({}, []) if posed is None else (posed.objects, posed.words)
        unclear = [sentence for sentence in words if sentence.startswith(f"{label}.")]
        return {**first, **objects.get(label, {}), "not_told_apart": unclear}

    # ---- how it is searched, where a screening of all bodies finds it ----

    def screened_words(self, one: Object) -> tuple[Learnable, ...]:
        """What the screening frees of every body for it."""
        return ()

    def foretold(self, screening: BodyScreening, label: str) -> float | None:
        """Log-likelihood of blurred images that it would gain; None where no screening tells."""
        return None

    def search(self, declared: Scene, setup: FitSetup, here: Fitted, label: str) -> PoseSearch | None:
        """Its search on blurred images, by which the changes of several bodies are compared; None where there is
        nothing to be compared."""
        return None

    def candidates(
        self, declared: Scene, setup: FitSetup, here: Fitted, label: str, search: PoseSearch | None
    ) -> list[GeometryCandidate]:
        """The body's change as it is likeliest, from where its `search` ended; none where that is no sound scene."""
        return []

    def one_reading(self, found: list[GeometryCandidate]) -> list[GeometryCandidate]:
        """Candidates of one body, less those that are only another reading of this change."""
        return found


class MovedBody(BodyChange):
    """A change that moves numbers of a body, by `keys` of its table, each a little at first: its Jacobian tells."""

    by_steps = True
    structure_doubts: ClassVar[Literal["nowhere", "on it", "anywhere"]] = "on it"
    keys: ClassVar[frozenset[str]]

    def screened_words(self, one: Object) -> tuple[Learnable, ...]:
        return self.words(one)

    def foretold(self, screening: BodyScreening, label: str) -> float | None:
        return screening.foretold(label, self.keys)

    def freed(self, declared: Scene, scene: Scene, label: str) -> Scene | None:
        """The scene with what a search frees of the body; None where it has nothing to move."""
        return freed(scene, [label], self.words)

    def reading(self, values: Mapping[str, Any]) -> str:
        """`GeometryCandidate.reading` of what was found."""
        return ""

    def search(self, declared: Scene, setup: FitSetup, here: Fitted, label: str) -> PoseSearch | None:
        free = self.freed(declared, here.scene, label)
        if free is None:
            return None
        views = [view.view.name for view in here.problem.views]
        return search_poses(free, setup.device, views=views, observations=setup.observations)

    def candidates(
        self, declared: Scene, setup: FitSetup, here: Fitted, label: str, search: PoseSearch | None
    ) -> list[GeometryCandidate]:
        """Nothing where it is in the ground or outside the images."""
        if search is None:
            return []
        poses = search.finish()
        scene, values = still(poses.scene), poses.objects[label]
        if misplaced(scene):
            return []
        reading = self.reading(values)
        return [GeometryCandidate(self.name, label, scene, poses.gain, poses.size, values, poses.words, reading)]
