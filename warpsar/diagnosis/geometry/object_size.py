"""A body has another length, width or height, about its foot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from warpsar.diagnosis.geometry.base.body import MovedBody
from warpsar.diagnosis.geometry.base.change import GeometryCandidate
from warpsar.diagnosis.models.change import BodyDifference
from warpsar.diagnosis.models.movable import size_word
from warpsar.learning.pose_search import FoundPoses
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Learnable, Object

SAME_IMAGES = 3.0  # of ln L: two readings of one body that differ by less explain the images alike


class ObjectSize(MovedBody):
    """Sizes of a primitive, or factors on those of a mesh. A body of another size may stand elsewhere, too."""

    name = "object_size"
    order = 20
    summary = "an object of the scene is of another size"
    frees = 3
    grows_a_body = True
    keys: ClassVar[frozenset[str]] = frozenset({"scale", "size_m"})
    commented = ("size_m",)

    def is_of(self, difference: BodyDifference) -> bool:
        return bool(difference.keys & self.keys)

    def words(self, one: Object) -> tuple[Learnable, ...]:
        return (size_word(one),)

    def values(
        self, declared: Scene, scene: Scene, label: str, first: Mapping[str, Any], posed: FoundPoses | None
    ) -> dict[str, Any]:
        """Factors on a mesh say little of a building: its height [m] stands beside them, and the declared one."""
        found = super().values(declared, scene, label, first, posed)
        height = _mesh_height_m(scene, label)
        if "scale" not in found or height is None:
            return found
        up = [next((one.scales[2] for one in each.objects if one.label == label), 1.0) for each in (scene, declared)]
        return {**found, "height_m": height * up[0], "declared_height_m": height * up[1]}

    def one_reading(self, found: list[GeometryCandidate]) -> list[GeometryCandidate]:
        """A body that is sunk looks as one that is lower. Where both explain the images alike they are one hypothesis,
        which has the name of its size and says the other reading."""
        mine = next((one for one in found if one.kind == self.name), None)

        def alike(one: GeometryCandidate) -> bool:
            return mine is not None and bool(one.reading) and abs(one.gain - mine.gain) <= SAME_IMAGES

        if mine is None or not any(map(alike, found)):
            return found
        words = [f"{mine.object}: the same images come from {one.reading}" for one in found if alike(one)]
        with_readings = replace(mine, words=[*mine.words, *words])
        return [with_readings if one is mine else one for one in found if not alike(one)]


def _mesh_height_m(scene: Scene, label: str) -> float | None:
    """From the foot to the top of a group of the scene's mesh, as the file has it; None for other bodies."""
    group = next((one.group for one in scene.objects if one.label == label), None)
    base = None if scene.assembly is None else scene.assembly.base
    if base is None or group is None:
        return None
    return float(np.ptp(base.vertices[base.faces[base.groups[group]]][..., 2]))


CHANGE = ObjectSize()
