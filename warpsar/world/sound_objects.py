"""Objects that cannot be meant: two at one place, in the ground, or outside every image. A line for each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from warpsar.world.mesh import Mesh
from warpsar.world.objects.assembly import Assembly
from warpsar.world.objects.table import Object
from warpsar.world.world import World, geometry_of


def doubled(objects: Sequence[Object]) -> list[str]:
    """Names that stand twice, and objects that are the same twice."""
    names: dict[str, int] = {}
    bodies: dict[str, int] = {}
    problems = []
    for index, one in enumerate(objects):
        key = f"objects[{index}] ({one.label})"
        if one.poses is not None:
            problems.append(f"{key}.poses: found {str(one.poses)!r} in memory; objects.poses.posed gives its bodies")
            continue
        if one.own_material:
            problems.append(f"{key}.own_material: found true in memory; a scene file alone makes the material")
            continue
        first = names.setdefault(one.label, index)
        if first != index:
            problems.append(f"{key}.name: found {one.label!r} again; must differ from objects[{first}]'s")
            continue
        same = bodies.setdefault(one.model_dump_json(exclude={"name", "learn", "tolerance"}), index)
        if same != index:
            problems.append(f"{key}: found the body of objects[{same}] at the same place again; must stand elsewhere")
    return problems


def misplaced(world: World) -> list[str]:
    """Objects more than half in the ground, or outside the image in every view."""
    problems: list[str] = []
    assembly = world.assembly
    if assembly is None:
        return problems
    floor = _floor(assembly, world.objects) if assembly.base is None else None
    for index, one in enumerate(world.objects):
        key = f"objects[{index}] ({one.label}).position_m"
        vertices = assembly.vertices_of(one)
        if not any(_in_image(world, view, vertices) for view in world.views):
            problems.append(f"{key}: found {list(one.position_m)}, outside the image in every view; must be inside")
            continue
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        ground = _ground(assembly, floor, one, middle)
        if middle[2] < ground:
            problems.append(
                f"{key}: found {list(one.position_m)}, more than half of it in the ground, which is at {ground:g} m; "
                f"must stand on it"
            )
    return problems


def _in_image(world: World, view: object, vertices: np.ndarray) -> bool:
    """Whether the box about the object in range and azimuth meets the image."""
    geometry = geometry_of(world, view)  # type: ignore[arg-type]
    places = geometry.range_and_azimuth_m(vertices - np.asarray(world.reference_point_m))
    halves = [n * step / 2.0 for n, step in zip(world.grid.shape, world.grid.spacing_m, strict=True)]
    return all(values.max() > -half and values.min() < half for values, half in zip(places, halves, strict=True))


def _ground(assembly: Assembly, floor: Object | None, one: Object, point: np.ndarray) -> float:
    """The lowest of the scene's own surfaces above or below a point; -infinity where there is none. In a scene without
    a mesh of its own, that is the object `floor`."""
    base = assembly.base
    if base is None:
        if floor is None or floor is one:
            return -np.inf
        mesh = assembly.placed(floor)
        found = surfaces_at(mesh.vertices[mesh.faces], point)
    else:
        faces = base.faces if one.group is None else _others(base, assembly.moved[one.label])
        found = surfaces_at(base.vertices[faces], point)
    return float(found.min()) if len(found) else -np.inf


def _floor(assembly: Assembly, objects: Sequence[Object]) -> Object | None:
    """The lying plate that takes up more than all other objects together, as seen from above."""
    areas = [float(np.prod(np.ptp(assembly.vertices_of(one), axis=0)[:2])) for one in objects]
    widest = int(np.argmax(areas))
    one = objects[widest]
    lies = one.primitive == "plate" and one.size_m is not None and one.size_m[2] == 0
    return one if lies and areas[widest] > 0.5 * sum(areas) else None


def surfaces_at(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Heights [m] of all faces above or below a point, (n,); `corners` [m], shape (faces, 3, 3)."""
    a, b, c = (corners[:, k, :2] - point[:2] for k in range(3))
    u, v, w = (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0] for p, q in ((b, c), (c, a), (a, b)))
    total = u + v + w
    with np.errstate(divide="ignore", invalid="ignore"):
        heights = (u * corners[:, 0, 2] + v * corners[:, 1, 2] + w * corners[:, 2, 2]) / total
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    return np.asarray(heights[inside & (np.abs(total) > 1e-12)])


def _others(base: Mesh, moved: np.ndarray) -> np.ndarray:
    """The faces that do not move with the group."""
    return np.asarray(base.faces[~np.isin(base.faces[:, 0], moved)])
