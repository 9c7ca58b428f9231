"""Scenes of a search in JSON's types, for its checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from warpsar.diagnosis.models.change import content, scene_with
from warpsar.diagnosis.models.refit import surface_content, with_surface
from warpsar.scene.scene import Scene


def scene_content(declared: Scene, scene: Scene) -> dict[str, Any]:
    """What a search may change of a scene: surface, effects, geometry, and the seed of its rays."""
    return {
        "materials": surface_content(scene),
        "effects": scene.effects,
        "geometry": content(declared, scene),
        "seed": scene.sampling.seed,
    }


def scene_of(declared: Scene, about: Mapping[str, Any]) -> Scene:
    """The scene that `scene_content` gave."""
    placed = scene_with(declared, replace(declared, effects=about["effects"]), about["geometry"])
    sampling = placed.sampling.model_copy(update={"seed": about["seed"]})
    return with_surface(replace(placed, sampling=sampling), about["materials"])
