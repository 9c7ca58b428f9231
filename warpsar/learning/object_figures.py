"""Objects before and after a fit: their outlines in plan with intervals, and a small picture of them in space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from warpsar.io.figures import new
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BEFORE, AFTER = "0.45", "C3"  # colours: of what the scene file says, of what was found
AROUND = 0.6  # of the largest object's extent, that is shown about all of them
LARGEST_SD = 5.0  # in half extents: an interval that is wider is not drawn
MOST_FACES = 3000  # of a mesh that is drawn as it is: a sphere has 2000
LEGEND = (
    (BEFORE, "--", "scene file", 1.4),
    (AFTER, "-", "found", 1.4),
    (AFTER, "-", "ellipse: 95 % of its place", 0.8),
)


def figure_of_objects(before: Scene, after: Scene, by_object: Mapping[str, Mapping[str, Any]]) -> Figure | None:
    """Both pictures; None where no object differs or was learned.

    `by_object` is what JSON files say of the objects (`learning.pose_search.summary`). An object that one of the
    scenes does not have is drawn as the other has it.
    """
    named = _outlined(before, after, by_object)
    if not named:
        return None
    figure, (plan, space) = new(9.6, 4.6, ncols=2)
    subplot = space.get_subplotspec()
    space.remove()
    space = figure.add_subplot(subplot, projection="3d")
    low, high = _extent([mesh for pair in named.values() for mesh in pair if mesh is not None])
    _draw_plan(plan, named, by_object, before, low, high)
    _draw_space(space, named, low, high)
    return figure


Pair = tuple[Mesh | None, Mesh | None]


def _outlined(before: Scene, after: Scene, by_object: Mapping[str, Mapping[str, Any]]) -> dict[str, Pair]:
    """The meshes of every object that was learned or changed, before and after, by name."""
    names = dict.fromkeys([*by_object, *(one.label for one in (*before.objects, *after.objects))])
    found: dict[str, Pair] = {}
    for name in names:
        pair = (_mesh_of(before, name), _mesh_of(after, name))
        learned = any("_sd" in key for key in by_object.get(name, {}))
        if pair != (None, None) and (learned or not _same(*pair)):
            found[name] = pair
    return found


def _mesh_of(scene: Scene, name: str) -> Mesh | None:
    """An object, or a group of the scene's own mesh, where the scene has it."""
    one = next((one for one in scene.objects if one.label == name), None)
    if one is not None and one.group is None and scene.assembly is not None:
        placed = scene.assembly.placed(one)
        return _plain(placed.vertices, placed.faces)
    group = name if one is None else str(one.group)
    base = scene.mesh if scene.assembly is None else scene.assembly.mesh(scene.objects)
    if group in base.materials and group not in base.groups:
        faces = base.faces[base.face_material == base.materials.index(group)]
    else:
        faces = base.faces[base.groups.get(group, np.zeros(0, np.int32))]
    if not len(faces):
        return None
    used, corners = np.unique(faces, return_inverse=True)
    return _plain(base.vertices[used], corners.reshape(-1, 3))


def _plain(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh as it is drawn: its convex hull where it has very many faces."""
    if len(faces) > MOST_FACES:
        used, corners = np.unique(ConvexHull(vertices).simplices, return_inverse=True)
        vertices, faces = vertices[used], corners.reshape(-1, 3)
    return Mesh(vertices, faces.astype(np.int32), np.zeros(len(faces), np.int32))


def _same(one: Mesh | None, other: Mesh | None) -> bool:
    if one is None or other is None:
        return False
    return one.vertices.shape == other.vertices.shape and np.allclose(one.vertices, other.vertices)


def _extent(meshes: Sequence[Mesh]) -> tuple[np.ndarray, np.ndarray]:
    low = np.min([mesh.vertices.min(axis=0) for mesh in meshes], axis=0)
    high = np.max([mesh.vertices.max(axis=0) for mesh in meshes], axis=0)
    around = AROUND * max(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in meshes)
    return low - around, high + around


def _draw_plan(
    axis: Axes,
    named: Mapping[str, Pair],
    by_object: Mapping[str, Mapping[str, Any]],
    scene: Scene,
    low: np.ndarray,
    high: np.ndarray,
) -> None:
    """Outlines from above, 95 % ellipses of the places, and where the radar stood."""
    from matplotlib.patches import Ellipse

    for name, pair in named.items():
        for mesh, colour, style in zip(pair, (BEFORE, AFTER), ("--", "-"), strict=True):
            if mesh is not None:
                outline = _hull(mesh.vertices[:, :2])
                axis.plot(*outline.T, style, color=colour, lw=1.4)
        last = pair[1] if pair[1] is not None else pair[0]
        assert last is not None
        middle = (last.vertices[:, :2].min(axis=0) + last.vertices[:, :2].max(axis=0)) / 2.0
        top = (middle[0], last.vertices[:, 1].max())
        axis.annotate(name, top, (0, 3), textcoords="offset points", ha="center", va="bottom", fontsize=8)
        sd = np.asarray(by_object.get(name, {}).get("position_sd_m", (0.0, 0.0, 0.0)), float)[:2]
        if (sd > 0).any() and (sd < LARGEST_SD * np.ptp(last.vertices[:, :2], axis=0)).all():
            width, height = 2.0 * 2.448 * sd  # 95 % of a Gaussian of two numbers lie within 2.448 sd
            axis.add_patch(Ellipse(tuple(middle), width, height, fill=False, edgecolor=AFTER, lw=0.8))
    reach = (high[:2] - low[:2]) / 2.0
    centre = (high[:2] + low[:2]) / 2.0
    for view in scene.views:
        if view.images:
            turned = np.deg2rad(view.azimuth_deg)
            way = np.array([np.sin(turned), np.cos(turned)])
            edge = centre + way * np.min(reach / np.maximum(np.abs(way), 1e-9))
            axis.annotate(
                "",
                edge - 0.16 * reach.min() * way,
                edge,
                arrowprops={"arrowstyle": "->", "color": "C0", "alpha": 1.0 if view.role == "train" else 0.4},
            )
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_aspect("equal")
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.set_title("from above; arrows: looks of the radar (pale: test)", fontsize=9)
    axis.grid(alpha=0.3, lw=0.4)
    for colour, style, text, width in LEGEND:
        axis.plot([], [], style, color=colour, label=text, lw=width)
    axis.figure.legend(*axis.get_legend_handles_labels(), frameon=False, fontsize=8, loc="outside lower left", ncols=3)


def _hull(points: np.ndarray) -> np.ndarray:
    """The closed convex outline of points, (n, 2); of a sheet on edge its line."""
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:
        along = np.argmax(np.ptp(points, axis=0))
        corners = points[[points[:, along].argmin(), points[:, along].argmax()]]
    return np.concatenate([corners, corners[:1]])


def _draw_space(axis: Any, named: Mapping[str, Pair], low: np.ndarray, high: np.ndarray) -> None:
    """The objects in space: as lines before, as faces after."""
    for before, found in named.values():
        if before is not None:
            _draw_ridges(axis, before, "--", BEFORE)
        if found is not None:
            axis.plot_trisurf(*found.vertices.T, triangles=found.faces, color=AFTER, alpha=0.35, shade=False)
            _draw_ridges(axis, found, "-", AFTER)
    floor = min(float(mesh.vertices[:, 2].min()) for pair in named.values() for mesh in pair if mesh is not None)
    top = max(float(mesh.vertices[:, 2].max()) for pair in named.values() for mesh in pair if mesh is not None)
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_zlim(floor, top)
    axis.set_box_aspect((*(high[:2] - low[:2]), max(top - floor, 1e-3)), zoom=0.85)
    axis.locator_params(axis="z", nbins=4)
    axis.set_xlabel("east [m]")
    axis.set_ylabel("north [m]")
    axis.set_zlabel("up [m]")
    axis.tick_params(labelsize=7)
    axis.view_init(elev=28.0, azim=-60.0)


def _draw_ridges(axis: Any, mesh: Mesh, style: str, colour: str) -> None:
    for ends in _ridges(mesh):
        axis.plot(*ends.T, style, color=colour, lw=0.9)


def _ridges(mesh: Mesh) -> np.ndarray:
    """Edges where a mesh bends by more than 20 degrees, or ends, (n, 2, 3)."""
    points, corners = np.unique(np.round(mesh.vertices, 6), axis=0, return_inverse=True)
    faces = corners.ravel()[mesh.faces]
    p = points[faces]
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    unique, index, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(index.ravel(), kind="stable")
    first = np.cumsum(count) - count
    one, last = owner[order[first]], owner[order[first + count - 1]]
    bend = np.abs((normals[one] * normals[last]).sum(axis=1))
    return np.asarray(points[unique[(count == 1) | (bend < np.cos(np.deg2rad(20.0)))]])
