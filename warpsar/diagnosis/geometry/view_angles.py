"""Views were taken from other angles than the scene says: each by itself, or all turned by one number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from warpsar.diagnosis.geometry.base.change import Hypothesis
from warpsar.diagnosis.geometry.base.sensor import SensorChange
from warpsar.scene.scene import Scene

ALL = "all"  # the label of a change that turns every view by the same
KEYS: tuple[Literal["azimuth_deg"], Literal["incidence_deg"]] = ("azimuth_deg", "incidence_deg")
SAME_DEG = 1e-9  # angles that differ by less are the same: rounding


class ViewAngles(SensorChange):
    """Azimuth and incidence of a view, or of all of them: a turn of all azimuths is a turned scene."""

    name = "view_angles"
    order = 50
    summary = "views were taken from other angles than the scene says"

    def changed(self, declared: Scene, scene: Scene) -> dict[str, list[str]]:
        """Angles that differ by the same in all views are one change, of parameters "views.azimuth_deg" and so on."""
        by = {
            key: [getattr(now, key) - getattr(was, key) for now, was in zip(scene.views, declared.views, strict=True)]
            for key in KEYS
        }
        common = [
            key for key, moved in by.items() if len(moved) > 1 and moved[0] and max(moved) - min(moved) < SAME_DEG
        ]
        changed = {ALL: [f"views.{key}" for key in common]} if common else {}
        for number, view in enumerate(declared.views):
            own = [f"views.{view.name}.{key}" for key in KEYS if key not in common and by[key][number]]
            if own:
                changed[view.name] = own
        return changed

    def hypotheses(self, declared: Scene, scene: Scene, views: Sequence[str]) -> list[Hypothesis]:
        """Where all views were turned, the angle of one is not offered, nor the reverse: two such turns of one angle
        would not be told apart by the angles that they leave."""
        taken = [name for names in self.changed(declared, scene).values() for name in names]

        def mixed(label: str, key: str) -> bool:
            others = [name for name in taken if name.endswith(f".{key}")]
            return any((name == f"views.{key}") != (label == ALL) for name in others)

        asked = [(ALL, key, f"views.{key}") for key in KEYS if len(views) > 1]
        asked += [(view, key, f"views.{view}.{key}") for view in views for key in KEYS]
        return [Hypothesis(self.name, label, 0.0, 1, (name,)) for label, key, name in asked if not mixed(label, key)]

    def only_view(self, label: str) -> str | None:
        return None if label == ALL else label

    def reading(self, label: str) -> str:
        if label == ALL:
            return "the same as a scene that is turned as a whole"
        return f"the same as everything that {label} sees being turned for it alone"

    def state(self, scene: Scene) -> dict[str, Any]:
        return {"views": {view.name: [getattr(view, key) for key in KEYS] for view in scene.views}}

    def stated(self, state: Mapping[str, Any]) -> dict[str, Any]:
        return {
            f"views.{name}.{key}": value
            for name, values in state["views"].items()
            for key, value in zip(KEYS, values, strict=True)
        }

    def like(self, scene: Scene, other: Scene) -> Scene:
        keys = ("azimuth_deg", "stated_incidence_deg", "depression_deg", "grazing_deg")
        views = [
            now.model_copy(update={key: getattr(was, key) for key in keys})
            for now, was in zip(scene.views, other.views, strict=True)
        ]
        return replace(scene, views=views)

    def each(self, parameters: Sequence[str], views: Sequence[str]) -> list[str]:
        common = [name for name in parameters if name.count(".") == 1]
        own = [name for name in parameters if name not in common]
        return [*own, *(f"views.{view}.{name.rpartition('.')[2]}" for name in common for view in views)]

    def both(self, declared: Scene, scene: Scene, parameter: str) -> tuple[float, float]:
        """Of a turn of all views: 0, and how far they are turned."""
        if parameter.count(".") > 1:
            return super().both(declared, scene, parameter)
        key = parameter.rpartition(".")[2]
        return 0.0, float(getattr(scene.views[0], key) - getattr(declared.views[0], key))


CHANGE = ViewAngles()
