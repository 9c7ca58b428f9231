"""The scene's own mesh and its objects as one mesh, which is made again for every pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.world.mesh import Mesh
from warpsar.world.objects.pose import foot, in_object_frame, placed
from warpsar.world.objects.shapes import body
from warpsar.world.objects.table import UNITS, Object

Bodies = Mapping[Path, Mesh]
"""The meshes of files, as read: one for all objects that name it."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """What a scene's mesh is made of.

    `base` is the scene's own mesh with its groups, or None. `templates` are the meshes of objects in their own frame,
    one for all instances. `moved` holds, by the object's label, the vertices of `base` that belong to a group. `bodies`
    are the meshes as read.
    """

    base: Mesh | None
    templates: dict[tuple[object, ...], Mesh]
    moved: dict[str, NDArray[np.integer]]
    bodies: Bodies
    _wholes: dict[tuple[object, ...], Mesh] = field(default_factory=dict, repr=False)
    """By what the objects are, wherever they stand: a mesh whose arrays, but the vertices, serve every pose."""
    _counts: dict[tuple[object, ...], int] = field(default_factory=dict, repr=False)
    """By what an object is: how many vertices it has."""

    @classmethod
    def of(cls, base: Mesh | None, objects: Sequence[Object], bodies: Bodies) -> Assembly:
        """Raises InputError for a group that the mesh does not have, or that shares a face with another."""
        templates: dict[tuple[object, ...], Mesh] = {}
        for index, one in enumerate(objects):
            if one.mesh is not None and _key(one) not in templates:
                templates[_key(one)] = _template(bodies[one.mesh], one)
            if one.materials is not None:
                _refuse_names(one.materials, templates[_key(one)], f"objects[{index}] ({one.label}).materials")
        moved: dict[str, NDArray[np.integer]] = {}
        taken: dict[int, str] = {}
        for index, one in enumerate(objects):
            if one.group is None:
                continue
            faces = _group_faces(base, one.group, f"objects[{index}] ({one.label}).group")
            assert base is not None
            again = next((taken[face] for face in faces.tolist() if face in taken), None)
            if again is not None:
                raise InputError(
                    f"objects[{index}] ({one.label}): found faces that object {again} moves too; must be one"
                )
            taken |= dict.fromkeys(faces.tolist(), one.label)
            base, moved[one.label] = _cut_free(base, faces)
        return cls(base, templates, moved, bodies)

    def mesh(self, objects: Sequence[Object]) -> Mesh:
        """The one mesh with every object where its table puts it. Only vertices depend on the pose and size."""
        key = tuple(map(_kind, objects))
        if key not in self._wholes:
            parts = [] if self.base is None else [self._base(objects)]
            parts += [self.placed(one) for one in objects if one.group is None]
            self._wholes[key] = parts[0] if len(parts) == 1 else _joined(parts)
            return self._wholes[key]
        vertices = [] if self.base is None else [self._base(objects).vertices]
        vertices += [self.vertices_of(one) for one in objects if one.group is None]
        return replace(self._wholes[key], vertices=np.concatenate(vertices))

    def moved_mesh(self, mesh: Mesh, before: Sequence[Object], after: Sequence[Object]) -> Mesh:
        """`mesh`, which has the objects `before`, with those `after`: only what is another object is placed anew."""
        same = all(_kind(one) == _kind(other) for one, other in zip(before, after, strict=True) if one is not other)
        if self.moved or not same:
            return self.mesh(after)
        vertices, start = mesh.vertices.copy(), 0 if self.base is None else len(self.base.vertices)
        for old, new in zip(before, after, strict=True):
            count = self._vertex_count(new)
            if old is not new:
                vertices[start : start + count] = self.vertices_of(new)
            start += count
        return replace(mesh, vertices=vertices)

    def _vertex_count(self, one: Object) -> int:
        key = _kind(one)
        if key not in self._counts:
            self._counts[key] = len(self.vertices_of(one))
        return self._counts[key]

    def faces_of(self, objects: Sequence[Object]) -> dict[str, NDArray[np.integer]]:
        """Which faces of `mesh` are an object's, by its label."""
        found: dict[str, NDArray[np.integer]] = {}
        start = 0 if self.base is None else len(self.base.faces)
        for one in objects:
            if one.group is not None:
                found[one.label] = np.asarray(_group_faces(self.base, one.group, "objects"))
                continue
            count = len(self.templates[_key(one)].faces if one.primitive is None else body(one).faces)
            found[one.label] = np.arange(start, start + count)
            start += count
        return found

    def placed(self, one: Object) -> Mesh:
        """An object that is no group, where its table puts it."""
        if one.primitive is not None:
            made = body(one)
            template = Mesh(made.vertices, made.faces, np.zeros(len(made.faces), np.int32))
        else:
            template = self.templates[_key(one)]
        if one.material is not None:
            uniform = np.zeros(len(template.faces), np.int32)
            template = replace(template, materials=(one.material,), face_material=uniform)
        if one.materials is not None:
            named = [one.materials[name] for name in template.materials]
            names = tuple(dict.fromkeys(named))
            index = np.array([names.index(name) for name in named], np.int32)
            template = replace(template, materials=names, face_material=index[template.face_material])
        return replace(template, vertices=placed(template.vertices, one))

    def vertices_of(self, one: Object) -> NDArray[np.float64]:
        """An object's vertices in the world [m], shape (n, 3)."""
        if one.group is None:
            own = self.templates[_key(one)] if one.primitive is None else body(one)
            return placed(own.vertices, one)
        assert self.base is not None
        mine = self.base.vertices[self.moved[one.label]]
        return placed(mine, one, foot(mine))

    def _base(self, objects: Sequence[Object]) -> Mesh:
        assert self.base is not None
        if not self.moved:
            return self.base
        vertices = self.base.vertices.copy()
        for one in objects:
            if one.group is not None:
                vertices[self.moved[one.label]] = self.vertices_of(one)
        return replace(self.base, vertices=vertices)


def _kind(one: Object) -> tuple[object, ...]:
    """What of an object decides which triangles it has, and not where their corners lie."""
    sheet = None if one.size_m is None else tuple(size == 0.0 for size in one.size_m)
    return (*_key(one), one.primitive, sheet, one.group, one.material, tuple((one.materials or {}).items()))


def _key(one: Object) -> tuple[object, ...]:
    """What instances of one mesh have in common."""
    return (one.mesh, one.units, one.up, one.front)


def _template(read: Mesh, one: Object) -> Mesh:
    return replace(read, vertices=in_object_frame(read.vertices, one, UNITS[one.units]), warnings=())


def _refuse_names(given: Mapping[str, str], mesh: Mesh, where: str) -> None:
    if set(given) != set(mesh.materials):
        raise InputError(
            f"{where}: found {', '.join(given)}; must be the names of its mesh: {', '.join(mesh.materials)}"
        )


def _group_faces(base: Mesh | None, group: str, where: str) -> NDArray[np.int32]:
    groups = {} if base is None else base.groups
    if group not in groups:
        known = ", ".join(groups) or "none: groups are the names of an OBJ or a glTF"
        raise InputError(f"{where}: found {group!r}; must be a group of the scene's mesh ({known})")
    return groups[group]


def _cut_free(mesh: Mesh, faces: NDArray[np.int32]) -> tuple[Mesh, NDArray[np.integer]]:
    """The mesh with vertices of the `faces`' own, and their indices."""
    mine = np.zeros(len(mesh.faces), bool)
    mine[faces] = True
    own = np.unique(mesh.faces[mine])
    shared = np.intersect1d(own, mesh.faces[~mine])
    if not len(shared):
        return mesh, own
    copy = np.arange(len(mesh.vertices))
    copy[shared] = len(mesh.vertices) + np.arange(len(shared))
    changed = mesh.faces.copy()
    changed[mine] = copy[changed[mine]]
    order = np.concatenate([np.arange(len(mesh.vertices)), shared])
    scalars = {name: values[order] for name, values in mesh.vertex_scalars.items()}
    uv = None if mesh.uv is None else mesh.uv[order]
    found = replace(mesh, vertices=mesh.vertices[order], faces=changed, uv=uv, vertex_scalars=scalars)
    return found, np.unique(changed[mine])


def _joined(parts: Sequence[Mesh]) -> Mesh:
    """Several meshes as one; what only some have (UV, scalars) is NaN elsewhere."""
    names = tuple(dict.fromkeys(name for part in parts for name in part.materials))
    counts = [len(part.vertices) for part in parts]
    starts = np.cumsum([0, *counts[:-1]]).astype(np.int32)
    faces = [part.faces + start for part, start in zip(parts, starts, strict=True)]
    material = [np.array([names.index(n) for n in part.materials], np.int32)[part.face_material] for part in parts]
    uv = None
    if any(part.uv is not None for part in parts):
        nowhere = [np.full((count, 2), np.nan) for count in counts]
        uv = np.concatenate([n if part.uv is None else part.uv for part, n in zip(parts, nowhere, strict=True)])
    keys = dict.fromkeys(key for part in parts for key in part.vertex_scalars)
    scalars = {
        key: np.concatenate([part.vertex_scalars.get(key, np.full(len(part.vertices), np.nan)) for part in parts])
        for key in keys
    }
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(faces),
        np.concatenate(material),
        names,
        uv,
        scalars,
        tuple(warning for part in parts for warning in part.warnings),
        parts[0].groups,
    )
