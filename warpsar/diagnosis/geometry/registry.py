"""The changes of geometry by name, and those that a scene has. A file in this folder is a change.

Each change of a scene has a name, such as "object_pose tower"; names of effects have no blank.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from warpsar.diagnosis.geometry.base.body import BodyChange
from warpsar.diagnosis.geometry.base.change import GeometryChange
from warpsar.diagnosis.geometry.base.sensor import SensorChange
from warpsar.diagnosis.models.change import composed, differences, removed_groups
from warpsar.diagnosis.models.names import kind_of, name_of, object_of
from warpsar.effects.registry import get as effect
from warpsar.parameters.at import at
from warpsar.runtime.plugins import names_in
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material


@cache
def names() -> tuple[str, ...]:
    """All changes by their `order`."""
    return tuple(sorted(names_in(__package__), key=lambda name: get(name).order))


@cache
def get(name: str) -> GeometryChange:
    """The change called `name`; each module `warpsar.diagnosis.geometry.<name>` holds it as `CHANGE`."""
    change: GeometryChange = import_module(f"warpsar.diagnosis.geometry.{name}").CHANGE
    return change


def of(name: str) -> GeometryChange:
    """The change that a name such as "object_pose tower" is of."""
    return get(kind_of(name))


def is_geometry(name: str) -> bool:
    """Whether a name is that of a change, and not of an effect."""
    return kind_of(name) in names()


def summary_of(name: str) -> str:
    """What the name of a change, or of an effect, means."""
    return of(name).summary if is_geometry(name) else effect(name).summary


def body_changes() -> list[BodyChange]:
    return [one for one in map(get, names()) if isinstance(one, BodyChange)]


def sensor_changes() -> list[SensorChange]:
    return [one for one in map(get, names()) if isinstance(one, SensorChange)]


def changes(declared: Scene, scene: Scene) -> list[str]:
    """The names of what `scene` has unlike `declared`: bodies elsewhere, absent, or missing there; its sensor."""
    found = []
    for difference in differences(declared, scene):
        kind = next(one for one in reversed(body_changes()) if one.is_of(difference))
        found.append(name_of(kind.name, difference.label))
    for each in sensor_changes():
        found += [name_of(each.name, label) for label in each.changed(declared, scene)]
    return list(dict.fromkeys(found))


def coordinates(declared: Scene, scene: Scene) -> list[str]:
    """The dotted names of all parameters that a fit frees of the scene's changes."""
    named = ((of(name), object_of(name)) for name in changes(declared, scene))
    return [each for change, label in named for each in change.coordinates(declared, scene, label)]


def without_change(declared: Scene, scene: Scene, name: str) -> Scene:
    """The scene with one of its changes taken back, all else as it is."""
    return of(name).taken_back(declared, scene, object_of(name))


def like_sensor(scene: Scene, other: Scene) -> Scene:
    """The scene with the sensor of another one of the same views."""
    for each in sensor_changes():
        scene = each.like(scene, other)
    return scene


def content(declared: Scene, scene: Scene) -> dict[str, Any] | None:
    """How the scene's sensor, objects and mesh differ, in JSON's types; None where they do not."""
    if not changes(declared, scene):
        return None
    new = {name: table for name, table in scene.materials.items() if name not in declared.materials}
    return {
        "sensor": {key: value for each in sensor_changes() for key, value in each.state(scene).items()},
        "objects": [_plain(one) for one in scene.objects],
        "removed": removed_groups(scene),
        "materials": {
            name: table.model_dump(mode="json", exclude_unset=True, warnings=False) for name, table in new.items()
        },
    }


def scene_with(declared: Scene, like: Scene, about: Mapping[str, Any] | None) -> Scene:
    """The scene of which `about` is the `content`, with the materials and effects of `like`."""
    if about is None:
        known = like_sensor(like, declared)
        return like if not changes(declared, like) else composed(declared, known, declared.objects, ())
    like = _with_sensor(like, about["sensor"])
    new = {name: Material(**table) for name, table in about["materials"].items()}
    return composed(declared, like, [Object(**table) for table in about["objects"]], about["removed"], new)


def _with_sensor(scene: Scene, state: Mapping[str, Any]) -> Scene:
    known = scene.parameters
    values = {known[name]: value for each in sensor_changes() for name, value in each.stated(state).items()}
    return at(scene, {one: np.array(value) for one, value in values.items() if one.value != value})


def _plain(one: Object) -> dict[str, Any]:
    return one.model_dump(mode="json", exclude_unset=True, exclude_none=True, warnings=False)
