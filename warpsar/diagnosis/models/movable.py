"""Which bodies of a scene may be moved, and what a fit frees of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from warpsar.diagnosis.models.change import differences
from warpsar.effects.registry import sets_all_positions
from warpsar.learning.problem import FitProblem
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.groups import group_names, with_groups
from warpsar.world.objects.table import Learnable, Object

MOST_OF_THE_SCENE = 0.5  # share of the faces' area in plan, from which a body is the ground, or all there is
MOST_NUMBERS = 1000
"""Of surface and effects, beside which geometry is asked. Its derivatives are dense, numbers times pixels, and its
curvature takes their square in memory and their cube in time: a map of 64 x 64 texels of three parameters takes
gigabytes."""


def bodies(declared: Scene, scene: Scene) -> dict[str, np.ndarray]:
    """Names of objects and of groups that `declared` and `scene` have alike, with their faces' numbers, shape (n,).

    The ground, and whatever else takes up most of the scene in plan, is none of them: its shift is `registration`.
    Groups of the same faces are one. A group that shares a face with an object is none: one of them would move alone.
    Faces of objects are counted from the last one of the mesh backwards.
    """
    changed = {one.label for one in differences(declared, scene)}
    total = float(_plan_area(scene.mesh.vertices, scene.mesh.faces))
    found: dict[str, np.ndarray] = {}
    seen: set[bytes] = set()
    base = scene.mesh if scene.assembly is None else scene.assembly.base
    if base is not None:
        names = group_names(base, scene.mesh_path)
        named = with_groups(base, scene.mesh_path, names)
        taken = [base.groups[one.group] for one in scene.objects if one.group is not None]
        moved = np.concatenate([np.zeros(0, np.int32), *taken])
        for name in names:
            faces = named.groups.get(name, np.zeros(0, np.int32))
            if name in changed or np.isin(faces, moved).any() or not len(faces) or faces.tobytes() in seen:
                continue
            seen.add(faces.tobytes())
            if _plan_area(named.vertices, named.faces[faces]) < MOST_OF_THE_SCENE * total:
                found[name] = faces
    last = 0
    for one in scene.objects:
        if one.label in changed:
            continue
        assert scene.assembly is not None
        if one.group is not None:
            found[one.label] = scene.assembly.base.groups[one.group]  # type: ignore[union-attr]
            continue
        mesh = scene.assembly.placed(one)
        if _plan_area(mesh.vertices, mesh.faces) < MOST_OF_THE_SCENE * total:
            found[one.label] = -1 - np.arange(last, last + len(mesh.faces))
        last += len(mesh.faces)
    return found


def disjoint(found: dict[str, np.ndarray], most: int) -> Iterable[list[str]]:
    """The names in lists of at most `most` bodies that share no face."""
    lists: list[tuple[list[str], set[int]]] = []
    for name, faces in found.items():
        mine = set(faces.tolist())
        for names, taken in lists:
            if len(names) < most and not taken & mine:
                names.append(name)
                taken |= mine
                break
        else:
            lists.append(([name], mine))
    return [names for names, _ in lists]


POSE_WORDS: tuple[Learnable, ...] = ("position", "heading")


def words_of(one: Object) -> tuple[Learnable, ...]:
    """Place and heading; a body that looks the same under every heading has none."""
    return ("position",) if one.round else POSE_WORDS


def freed(scene: Scene, labels: Sequence[str], words: Callable[[Object], tuple[Learnable, ...]] = words_of) -> Scene:
    """The scene with what a fit may change of the objects or groups `labels`, and nothing of the others.

    `words` says what of each of them. Length, width and height of a mesh are freed each by itself.
    """
    objects = [
        _freed(one, words(one)) if one.label in labels else one.model_copy(update={"learn": ()})
        for one in scene.objects
    ]
    known = {one.label for one in objects}
    groups = (Object(group=name) for name in labels if name not in known)
    return with_objects(scene, [*objects, *(_freed(one, words(one)) for one in groups)])


def _freed(one: Object, learn: tuple[Learnable, ...]) -> Object:
    return one.model_copy(update={"learn": learn, **({"scale": one.scales} if "scale" in learn else {})})


def size_word(one: Object) -> Learnable:
    """What a fit of a body's length, width and height frees: those of a primitive, or factors on those of a mesh."""
    return "scale" if one.primitive is None else "size"


def standing(scene: Scene) -> list[str]:
    """Labels of the objects that stay on the ground: those whose size is fitted, with whose height that of the foot
    would trade."""
    return [one.label for one in scene.objects if "size" in one.learn]


def own_material(declared: Scene, scene: Scene, label: str) -> str | None:
    """The material of an object alone, which has its name; None where it is made of one of the declared scene's."""
    own = next((one.material for one in scene.objects if one.label == label), None)
    return own if own == label and own not in declared.materials else None


def placeable(declared: Scene, scene: Scene, labels: Iterable[str]) -> bool:
    """Whether the places of the bodies `labels` can be told: where the aim point of every view is free, only against
    another body, which has not moved."""
    return sets_all_positions(scene) is None or bool(set(bodies(declared, scene)) - set(labels))


def _plan_area(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Area of the faces as seen from above and from below [m2]."""
    a, b, c = (vertices[faces[:, k], :2] for k in range(3))
    u, v = b - a, c - a
    return float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2.0)


def may_move(problem: FitProblem) -> bool:
    """Whether geometry is asked beside what the problem learns."""
    return problem.x0.size <= MOST_NUMBERS
