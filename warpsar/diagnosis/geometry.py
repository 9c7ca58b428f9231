"""A change of geometry that may explain what is left: an object elsewhere, not there, or not in the scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from warpsar.scene.scene import Scene


@dataclass(frozen=True)
class GeometryCandidate:
    """One object as it may be, and how well it explains the images.

    kind: "object_pose", "absent_object" or "missing_object". object: name, or group of the mesh. scene: the scene with
    the object so. gain: log-likelihood that it adds, on all usable pixels above a common floor, surface and effects at
    their best with and without. size: numbers that it frees. values: pose, sizes and standard deviations, as
    `diagnosis.json` has them under `objects`. words: what is said beside it.
    """

    kind: str
    object: str
    scene: Scene
    gain: float
    size: int
    values: dict[str, Any] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)
