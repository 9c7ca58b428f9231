"""How the bodies of a scene differ from the declared ones, and scenes of other bodies.

A scene holds its own changes: they are what its objects and its mesh have unlike the declared scene. So a model needs
no list of them beside its scene.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.groups import with_groups, without_group
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

STAYING = {"name", "learn", "tolerance"}  # keys of an object that do not say where it stands


@dataclass(frozen=True)
class BodyDifference:
    """A body that two scenes have unlike each other.

    `was`, `now`: its table in the declared scene and in the other one; None where that has none of such a name. What
    `now` says of a group of the mesh is compared with where the mesh has it. `keys` of the two tables differ.
    """

    label: str
    was: Object | None
    now: Object | None
    keys: frozenset[str] = frozenset()


def differences(declared: Scene, scene: Scene) -> list[BodyDifference]:
    """The bodies that `scene` has unlike `declared`: first those that it does not have, then in the order of its
    objects."""
    before = {one.label: one for one in declared.objects}
    now = {one.label: one for one in scene.objects}
    gone = [*removed_groups(scene), *(label for label in before if label not in now)]
    found = [BodyDifference(label, before.get(label), None) for label in dict.fromkeys(gone)]
    for label, one in now.items():
        was = before.get(label, None if one.group is None else Object(group=one.group))
        keys = frozenset() if was is None else _differing(was, one)
        if keys or label not in before:
            found.append(BodyDifference(label, was, one, keys))
    return found


def _differing(was: Object, now: Object) -> frozenset[str]:
    """Keys in which a body stands otherwise, or is of another kind."""
    return frozenset(
        key
        for key in {*Object.model_fields} - STAYING
        if (was.scales != now.scales if key == "scale" else getattr(was, key) != getattr(now, key))
    )


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


def without_object(declared: Scene, scene: Scene, label: str) -> Scene:
    """The scene without an object, or without a group of its mesh."""
    objects = [one for one in scene.objects if one.label != label]
    group = next((one.group for one in scene.objects if one.label == label), label)
    removed = [*removed_groups(scene), *([] if group is None else [group])]
    return composed(declared, scene, objects, removed)


def removed_groups(scene: Scene) -> list[str]:
    """The groups of the scene's own mesh that have no face left."""
    base = scene.mesh if scene.assembly is None else scene.assembly.base
    return [] if base is None else [name for name, faces in base.groups.items() if not len(faces)]
