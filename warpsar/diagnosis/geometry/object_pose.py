"""A body stands elsewhere, or is turned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from warpsar.diagnosis.geometry.base.body import MovedBody
from warpsar.diagnosis.models.change import BodyDifference
from warpsar.diagnosis.models.movable import freed, placeable, words_of
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Learnable, Object


class ObjectPose(MovedBody):
    """Place and heading; the heading alone where nothing else can be placed."""

    name = "object_pose"
    order = 10
    summary = "an object of the scene stands elsewhere"
    frees = 4
    keys: ClassVar[frozenset[str]] = frozenset({"position_m", "heading_deg"})
    commented = ("position_m", "heading_deg")

    def is_of(self, difference: BodyDifference) -> bool:
        """What a body has unlike the declared one, and no other change has as its own."""
        return difference.was is not None and difference.now is not None

    def words(self, one: Object) -> tuple[Learnable, ...]:
        return words_of(one)

    def freed(self, declared: Scene, scene: Scene, label: str) -> Scene | None:
        """None where the body cannot be placed and looks the same under every heading."""
        free = freed(scene, [label])
        if placeable(declared, scene, [label]):
            return free
        if any(one.label == label and one.round for one in free.objects):
            return None
        return freed(scene, [label], lambda _: ("heading",))

    def reading(self, values: Mapping[str, Any]) -> str:
        east, north, up = values["position_m"]
        return (
            f"a body of the declared size that stands {east:+.2f} m east, {north:+.2f} m north and {up:+.2f} m up of "
            f"where it is declared; a survey of its height would decide"
        )


CHANGE = ObjectPose()
