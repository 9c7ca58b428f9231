"""What `learn` finds of the geometry, before it turns to the surfaces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.learning.device_values import DeviceValues
from warpsar.learning.geometry import freed
from warpsar.learning.glints import with_glints
from warpsar.learning.identify import Identified
from warpsar.learning.pose_search import FoundPoses, search_poses
from warpsar.runtime import console
from warpsar.scene.scene import Scene


@dataclass(frozen=True)
class LearnedObjects:
    """Objects, angles and spacings at their likeliest values, and the scene with them: a start for the surfaces."""

    scene: Scene
    found: FoundPoses

    @property
    def words(self) -> list[str]:
        """A sentence for each object, and what cannot be entry apart."""
        objects = [_object_words(name, entry) for name, entry in self.found.objects.items() if _learned(entry)]
        return objects + [_number_words(name, entry) for name, entry in self.found.numbers.items()] + self.found.words

    def content(self) -> dict[str, Any]:
        """For learn.json, of the objects: values by name, with a standard deviation where one was learned."""
        words = self.found.words
        return {
            name: {**entry, "not_told_apart": [w for w in words if w.startswith(f"{name}.")]}
            for name, entry in self.found.objects.items()
        }

    def widened(self, identified: Identified) -> Identified:
        """The surfaces' intervals with those of the poses in mind: both were fitted to the same images."""
        size = len(identified.labels)
        covariance = self.found.identified.covariance[:size, :size]
        same = self.found.identified.labels[:size] == identified.labels
        return replace(identified, covariance=np.maximum(covariance, identified.covariance)) if same else identified


def learned_objects(
    scene: Scene, device: wp.Device, loss: str, values: DeviceValues | None = None
) -> LearnedObjects | None:
    """Fit what is to be learned of objects, views and image; None where there is nothing.

    Surfaces, effects and `values`, tables and learned terms, are fitted along. Raises InputError as `find_poses` does.
    """
    if next(freed(scene), None) is None:
        return None
    approaching = search_poses(scene, device, loss=loss, blurs_m=None, smooth=True, values=values)
    if any(one.glint for one in scene.objects):
        there, values = approaching.approached()
        with_points = with_glints(there, device, loss)
        console.say(f"glints: {len(with_points.objects) - len(scene.objects)} of {len(scene.objects)} bodies")
        # the points begin as bright as their bodies, and the bodies where they are near
        approaching = search_poses(with_points, device, loss=loss, blurs_m=(), smooth=True, values=values).shaded()
    found = approaching.finish()
    console.say(f"geometry: log-likelihood up by {found.gain:.4g}")
    return LearnedObjects(found.scene, found)


def _number_words(name: str, entry: dict[str, Any]) -> str:
    unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
    return f"{name}: {entry['value']:.6g} +- {entry['sd']:.2g}{unit}"


def _learned(entry: dict[str, Any]) -> bool:
    return any("_sd" in key for key in entry)


def _object_words(name: str, entry: dict[str, Any]) -> str:
    parts = []
    for key, value in entry.items():
        stem, _, unit = key.partition("_sd")
        if "_sd" not in key:
            continue
        values = entry[stem + unit]
        pairs = zip(*(each if isinstance(each, list) else [each] for each in (values, value)), strict=True)
        shown = ", ".join(f"{v:.4g} +- {sd:.2g}" for v, sd in pairs)
        parts.append(f"{stem} {shown} {unit.removeprefix('_')}".strip())
    return f"{name}: {'; '.join(parts)}"
