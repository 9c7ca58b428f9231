"""How the sensor may be declared wrongly: views taken from other angles, pixels of another size.

A turn of all azimuths is a turned scene, a common scale of the pixels a scaled mesh, and one view's angle a turn of all
that it sees: images cannot tell them apart, and `reading` says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from warpsar.diagnosis.models.names import kind_of, name_of, object_of
from warpsar.learning.geometry import still
from warpsar.parameters.at import at
from warpsar.scene.scene import Scene

ANGLES = "view_angles"
SPACING = "pixel_spacing"
ALL = "all"  # what a change of angles is called that turns every view by the same
SPACINGS = {"range": "range_spacing_m", "azimuth": "azimuth_spacing_m"}
ANGLE_KEYS: tuple[Literal["azimuth_deg"], Literal["incidence_deg"]] = ("azimuth_deg", "incidence_deg")
SAME_DEG = 1e-9  # angles that differ by less are the same: rounding


def is_sensor(name: str) -> bool:
    """Whether a name is that of a change of angles or spacings, which is of no object."""
    return kind_of(name) in (ANGLES, SPACING)


def is_own_angle(name: str) -> bool:
    """Whether a change is of a single view's angles, which no other view tells."""
    return kind_of(name) == ANGLES and object_of(name) != ALL


def sensor_changes(declared: Scene, scene: Scene) -> dict[str, list[str]]:
    """The angles and spacings that `scene` has unlike `declared`: the change's name, and the parameters' dotted names.

    Angles that differ by the same in all views are one change, whose parameters are "views.azimuth_deg" and so on.
    """
    by = {
        key: [getattr(now, key) - getattr(was, key) for now, was in zip(scene.views, declared.views, strict=True)]
        for key in ANGLE_KEYS
    }
    common = [key for key, found in by.items() if len(found) > 1 and found[0] and max(found) - min(found) < SAME_DEG]
    changed: dict[str, list[str]] = {}
    if common:
        changed[name_of(ANGLES, ALL)] = [f"views.{key}" for key in common]
    for number, view in enumerate(declared.views):
        own = [f"views.{view.name}.{key}" for key in ANGLE_KEYS if key not in common and by[key][number]]
        if own:
            changed[name_of(ANGLES, view.name)] = own
    for label, key in SPACINGS.items():
        if getattr(scene.grid, key) != getattr(declared.grid, key):
            changed[name_of(SPACING, label)] = [f"image.{key}"]
    return changed


def like_sensor(scene: Scene, other: Scene) -> Scene:
    """The scene with the angles and spacings of another one of the same views."""
    angles = ("azimuth_deg", "stated_incidence_deg", "depression_deg", "grazing_deg")
    views = [
        now.model_copy(update={key: getattr(was, key) for key in angles})
        for now, was in zip(scene.views, other.views, strict=True)
    ]
    return replace(scene, views=views, grid=scene.grid.model_copy(update={"spacing_m": other.grid.spacing_m}))


def sensor_freed(scene: Scene, parameters: Sequence[str]) -> Scene:
    """The scene with nothing but these angles and spacings to learn, by their dotted names."""
    scene = still(scene)
    of = {name: name.split(".") for name in parameters}
    common = tuple(parts[-1] for parts in of.values() if parts[0] == "views" and len(parts) == 2)
    views = [
        view.model_copy(update={"learn": tuple(key for key in ANGLE_KEYS if f"views.{view.name}.{key}" in of)})
        for view in scene.views
    ]
    spacings = tuple(parts[-1] for parts in of.values() if parts[0] == "image")
    return replace(
        scene,
        views=views,
        radar=scene.radar.model_copy(update={"learn": common}),
        grid=scene.grid.model_copy(update={"learn": spacings}),
    )


def reading(kind: str, label: str) -> str:
    """What a change of the sensor cannot be told from, in words."""
    if kind == SPACING:
        return f"the same as a scene whose size in {label} is another, in all views"
    if label == ALL:
        return "the same as a scene that is turned as a whole"
    return f"the same as everything that {label} sees being turned for it alone"


def found_sensor(declared: Scene, scene: Scene, numbers: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """What became of each change of the sensor, by what it is of: values found and declared, and how well known."""
    found: dict[str, dict[str, Any]] = {}
    for name, parameters in sensor_changes(declared, scene).items():
        entry = found.setdefault(object_of(name), {})
        for one in parameters:
            key, common = one.rpartition(".")[2], kind_of(name) == ANGLES and one.count(".") == 1
            if common:  # a turn from what is declared
                was, now = 0.0, getattr(scene.views[0], key) - getattr(declared.views[0], key)
            else:
                was, now = (float(each.parameters[one].value) for each in (declared, scene))
            entry[key] = {"found": float(now), "sd": numbers.get(one, {}).get("sd"), "declared": was}
    return found


def without_sensor(declared: Scene, scene: Scene, name: str) -> Scene:
    """The scene with one change of its sensor taken back."""
    label, known = object_of(name), declared.parameters
    if kind_of(name) == SPACING:
        taken = [f"image.{SPACINGS[label]}"]
    else:
        views = [view.name for view in scene.views] if label == ALL else [label]
        keys = [one.rpartition(".")[2] for one in sensor_changes(declared, scene).get(name, [])]
        taken = [f"views.{view}.{key}" for view in views for key in keys]
    return at(scene, {scene.parameters[one]: known[one].value for one in taken})


def sensor_content(scene: Scene) -> dict[str, Any]:
    """Angles and spacings in JSON's types."""
    views = {view.name: [getattr(view, key) for key in ANGLE_KEYS] for view in scene.views}
    return {"views": views, "spacing_m": list(scene.grid.spacing_m)}


def with_sensor(scene: Scene, about: Mapping[str, Any]) -> Scene:
    """The scene with the angles and spacings that `sensor_content` gave."""
    values = {
        f"views.{name}.{key}": value
        for name, both in about["views"].items()
        for key, value in zip(ANGLE_KEYS, both, strict=True)
    }
    values |= {f"image.{key}": value for key, value in zip(SPACINGS.values(), about["spacing_m"], strict=True)}
    known = scene.parameters
    return at(scene, {known[one]: np.array(value) for one, value in values.items() if known[one].value != value})
