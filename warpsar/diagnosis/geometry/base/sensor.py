"""A change of how the radar looks: parameters of views or of the image that the scene states wrongly.

Images cannot tell it from a change of the whole scene; `reading` says of which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

from warpsar.diagnosis.geometry.base.change import GeometryChange, Hypothesis, Section
from warpsar.learning.pose_search import FoundPoses
from warpsar.parameters.at import at
from warpsar.scene.scene import Scene


class SensorChange(GeometryChange):
    """What is asked of such a change beside what is asked of all."""

    section: ClassVar[Section] = "sensor"
    structure_doubts: ClassVar[Literal["nowhere", "on it", "anywhere"]] = "anywhere"

    def changed(self, declared: Scene, scene: Scene) -> dict[str, list[str]]:
        """What `scene` has unlike `declared`: dotted names of parameters, by the label of the change."""
        raise NotImplementedError

    def hypotheses(self, declared: Scene, scene: Scene, views: Sequence[str]) -> list[Hypothesis]:
        """All that may be tried beside what `scene` has, of these `views`; nothing is foretold yet."""
        raise NotImplementedError

    def reading(self, label: str) -> str:
        """What it cannot be told from, in words."""
        raise NotImplementedError

    def state(self, scene: Scene) -> dict[str, Any]:
        """The parameters that it may change, in JSON's types."""
        raise NotImplementedError

    def stated(self, state: Mapping[str, Any]) -> dict[str, Any]:
        """The values that `state` gave, by dotted name."""
        raise NotImplementedError

    def like(self, scene: Scene, other: Scene) -> Scene:
        """The scene with these parameters of another one of the same views."""
        raise NotImplementedError

    def each(self, parameters: Sequence[str], views: Sequence[str]) -> list[str]:
        """The parameters that move with `parameters`: of each of the `views`, where one number moves all."""
        return list(parameters)

    def both(self, declared: Scene, scene: Scene, parameter: str) -> tuple[float, float]:
        """What a parameter is declared as, and what it is."""
        was, now = (float(one.parameters[parameter].value) for one in (declared, scene))
        return was, now

    def coordinates(self, declared: Scene, scene: Scene, label: str) -> list[str]:
        return self.changed(declared, scene)[label]

    def taken_back(self, declared: Scene, scene: Scene, label: str) -> Scene:
        changed = self.changed(declared, scene).get(label, [])
        names = self.each(changed, [view.name for view in scene.views])
        return at(scene, {scene.parameters[name]: declared.parameters[name].value for name in names})

    def values(
        self, declared: Scene, scene: Scene, label: str, first: Mapping[str, Any], posed: FoundPoses | None
    ) -> dict[str, Any]:
        """Values found and declared, and how well known, by key."""
        numbers = {} if posed is None else posed.numbers
        values = {}
        for name in self.changed(declared, scene)[label]:
            was, now = self.both(declared, scene, name)
            values[name.rpartition(".")[2]] = {"found": now, "sd": numbers.get(name, {}).get("sd"), "declared": was}
        return values
