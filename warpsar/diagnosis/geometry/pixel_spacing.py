"""Pixels are of another size than the scene says, in all views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from warpsar.diagnosis.geometry.base.change import Hypothesis
from warpsar.diagnosis.geometry.base.sensor import SensorChange
from warpsar.scene.scene import Scene

KEYS = {"range": "range_spacing_m", "azimuth": "azimuth_spacing_m"}


class PixelSpacing(SensorChange):
    """The spacing in range or azimuth: a common factor on both is a scaled scene."""

    name = "pixel_spacing"
    order = 60
    summary = "pixels are of another size than the scene says"

    def changed(self, declared: Scene, scene: Scene) -> dict[str, list[str]]:
        differing = {
            label: key for label, key in KEYS.items() if getattr(scene.grid, key) != getattr(declared.grid, key)
        }
        return {label: [f"image.{key}"] for label, key in differing.items()}

    def hypotheses(self, declared: Scene, scene: Scene, views: Sequence[str]) -> list[Hypothesis]:
        return [Hypothesis(self.name, label, 0.0, 1, (f"image.{key}",)) for label, key in KEYS.items()]

    def reading(self, label: str) -> str:
        return f"the same as a scene whose size in {label} is another, in all views"

    def state(self, scene: Scene) -> dict[str, Any]:
        return {"spacing_m": list(scene.grid.spacing_m)}

    def stated(self, state: Mapping[str, Any]) -> dict[str, Any]:
        return {f"image.{key}": value for key, value in zip(KEYS.values(), state["spacing_m"], strict=True)}

    def like(self, scene: Scene, other: Scene) -> Scene:
        return replace(scene, grid=scene.grid.model_copy(update={"spacing_m": other.grid.spacing_m}))


CHANGE = PixelSpacing()
