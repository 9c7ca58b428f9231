"""A change of geometry that may explain what is left: an object elsewhere, of another size, not there, or not in the
scene; a view from elsewhere, a pixel of another size.

A scene holds its own changes: they are what its objects and its mesh have unlike the declared scene. So a model needs
no list of them beside its scene. Each change has a name, such as "object_pose tower"; names of effects have no blank.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from warpsar.diagnosis.models.names import kind_of, name_of, object_of
from warpsar.diagnosis.models.sensor import (
    ANGLES,
    SPACING,
    is_sensor,
    like_sensor,
    sensor_changes,
    sensor_content,
    with_sensor,
    without_sensor,
)
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.groups import with_groups, without_group
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

Kind = Literal["object_pose", "object_size", "absent_object", "missing_object"]
POSE: Kind = "object_pose"
SIZE: Kind = "object_size"
ABSENT: Kind = "absent_object"
MISSING: Kind = "missing_object"
NUMBERS: dict[Kind, int] = {POSE: 4, SIZE: 3, ABSENT: 1}  # that it moves
SUMMARIES = {
    POSE: "an object of the scene stands elsewhere",
    SIZE: "an object of the scene is of another size",
    ABSENT: "an object of the scene is not there",
    MISSING: "an object is there that the scene does not have",
    ANGLES: "views were taken from other angles than the scene says",
    SPACING: "pixels are of another size than the scene says",
}
STAYING = {"name", "learn", "tolerance"}  # keys of an object that do not say where it stands
SIZES = {"scale", "size_m"}  # those that say how large it is


@dataclass(frozen=True)
class GeometryCandidate:
    """One object as it may be, and how well it explains the images.

    kind: "object_pose", "object_size", "absent_object" or "missing_object". object: name, or group of the mesh. scene:
    the scene with the object so. gain: log-likelihood that it adds, on all usable pixels above a common floor, surface
    and effects at their best with and without. size: numbers that it frees. values: pose, sizes and standard
    deviations, as `diagnosis.json` has them under `objects`. words: what is said beside it.
    """

    kind: str
    object: str
    scene: Scene
    gain: float
    size: int
    values: dict[str, Any] = field(default_factory=dict)
    words: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        return name_of(self.kind, self.object)


def is_geometry(name: str) -> bool:
    """Whether a name is that of a change, and not of an effect."""
    return kind_of(name) in SUMMARIES


def changes(declared: Scene, scene: Scene) -> list[str]:
    """The names of what `scene` has unlike `declared`: objects elsewhere, absent, or missing there; its sensor."""
    before = {one.label: one for one in declared.objects}
    now = {one.label: one for one in scene.objects}
    found = [name_of(ABSENT, label) for label in [*_removed(scene), *(set(before) - set(now))]]
    for label, one in now.items():
        if label not in before and one.group is None:
            found.append(name_of(MISSING, label))
        elif (kind := _kind(before.get(label, Object(group=one.group) if one.group else one), one)) is not None:
            found.append(name_of(kind, label))
        elif label not in before:
            found.append(name_of(POSE, label))
    return list(dict.fromkeys([*found, *sensor_changes(declared, scene)]))


def _kind(was: Object, now: Object) -> Kind | None:
    """What became of an object that stands in both scenes; None where it stands as it did. A body of another size may
    stand elsewhere, too."""
    differing = {
        key
        for key in {*Object.model_fields} - STAYING
        if (was.scales != now.scales if key == "scale" else getattr(was, key) != getattr(now, key))
    }
    if not differing:
        return None
    return SIZE if differing & SIZES else POSE


def composed(
    declared: Scene,
    like: Scene,
    objects: Sequence[Object],
    removed: Sequence[str],
    materials: Mapping[str, Material] | None = None,
) -> Scene:
    """`declared` with these objects and without the groups `removed`; materials and effects as `like` has them.

    `materials` are further ones, of objects that neither has. Where nothing differs, it has the very mesh of
    `declared`.
    """
    known = {**declared.materials, **(materials or {}), **like.materials}
    mesh, path, assembly, standing = declared.mesh, declared.mesh_path, declared.assembly, declared.objects
    if removed:
        base = mesh if assembly is None else assembly.base
        assert base is not None
        mesh = with_groups(base, path, removed)
        for group in removed:
            mesh = without_group(mesh, group)
        path, assembly, standing = None, None, ()
    used = {name: known[name] for name in mesh.materials}
    start = replace(like, mesh=mesh, mesh_path=path, assembly=assembly, objects=standing, materials=used)
    return start if list(objects) == list(standing) else with_objects(start, objects, known)


def as_declared(declared: Scene, scene: Scene) -> Scene:
    """The scene with the materials that `declared` has, where it has them."""
    return replace(scene, materials={name: declared.materials.get(name, one) for name, one in scene.materials.items()})


def without_change(declared: Scene, scene: Scene, name: str) -> Scene:
    """The scene with one of its changes taken back, all else as it is."""
    label, kind = object_of(name), kind_of(name)
    if is_sensor(name):
        return without_sensor(declared, scene, name)
    before = {one.label: one for one in declared.objects}
    objects = [one for one in scene.objects if one.label != label]
    if label in before:
        objects = [one if one.label != label else before[label] for one in scene.objects]
        if kind == ABSENT:
            objects.append(before[label])
    removed = [group for group in _removed(scene) if not (kind == ABSENT and group == label)]
    return composed(declared, scene, objects, removed)


def without_object(declared: Scene, scene: Scene, label: str) -> Scene:
    """The scene without an object, or without a group of its mesh."""
    objects = [one for one in scene.objects if one.label != label]
    group = next((one.group for one in scene.objects if one.label == label), label)
    removed = [*_removed(scene), *([] if group is None else [group])]
    return composed(declared, scene, objects, removed)


def content(declared: Scene, scene: Scene) -> dict[str, Any] | None:
    """How the scene's objects and mesh differ, in JSON's types; None where they do not."""
    if not changes(declared, scene):
        return None
    new = {name: table for name, table in scene.materials.items() if name not in declared.materials}
    return {
        "sensor": sensor_content(scene),
        "objects": [_plain(one) for one in scene.objects],
        "removed": _removed(scene),
        "materials": {
            name: table.model_dump(mode="json", exclude_unset=True, warnings=False) for name, table in new.items()
        },
    }


def scene_with(declared: Scene, like: Scene, about: Mapping[str, Any] | None) -> Scene:
    """The scene of which `about` is the `content`, with the materials and effects of `like`."""
    if about is None:
        known = like_sensor(like, declared)
        return like if not changes(declared, like) else composed(declared, known, declared.objects, ())
    like = with_sensor(like, about["sensor"])
    new = {name: Material(**table) for name, table in about["materials"].items()}
    return composed(declared, like, [Object(**table) for table in about["objects"]], about["removed"], new)


def _removed(scene: Scene) -> list[str]:
    """The groups of the scene's own mesh that have no face left."""
    base = scene.mesh if scene.assembly is None else scene.assembly.base
    return [] if base is None else [name for name, faces in base.groups.items() if not len(faces)]


def _plain(one: Object) -> dict[str, Any]:
    return one.model_dump(mode="json", exclude_unset=True, exclude_none=True, warnings=False)
