"""A body of a mesh as a box of its size: what a rival knows that has no mesh.

Effects such as `unresolved_detail` predict much of a vehicle from its size alone, better than pictures of other views
do. A mesh that predicts no better than a box has told nothing of the body.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.pose import rotation
from warpsar.world.objects.table import Object

KNOWN = "10 %"  # of a box's sizes


def as_box(scene: Scene, labels: Collection[str]) -> Scene:
    """The scene with some objects as boxes about them, in their poses; their sizes are known to `KNOWN`."""
    return with_objects(scene, [_box(scene, one) if one.label in labels else one for one in scene.objects])


def ends_m(scene: Scene, one: Object) -> tuple[np.ndarray, np.ndarray]:
    """Where an object ends across, along and up, in its own frame [m], shapes (3,): the low and the high ends."""
    assert scene.assembly is not None
    upright = {"position_m": (0.0, 0.0, 0.0), "heading_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    own = scene.assembly.vertices_of(one.model_copy(update=upright))
    return own.min(axis=0), own.max(axis=0)


def _box(scene: Scene, one: Object) -> Object:
    low, high = ends_m(scene, one)
    across, along, up = (high - low).tolist()
    foot = np.array([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, low[2]])
    moved = np.array(one.position_m) + rotation(one.heading_deg, one.pitch_deg, one.roll_deg) @ foot
    return Object(
        name=one.label,
        primitive="box",
        size_m=(along, across, up),
        position_m=tuple(moved.tolist()),
        heading_deg=one.heading_deg,
        pitch_deg=one.pitch_deg,
        roll_deg=one.roll_deg,
        material=_material(scene, one),
        learn=("size",),
        tolerance={"size_m": KNOWN},
    )


def _material(scene: Scene, one: Object) -> str:
    """The object's, or that of most of its surface."""
    if one.material is not None:
        return one.material
    assert scene.assembly is not None
    mesh = scene.assembly.placed(one)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return mesh.materials[int(np.bincount(mesh.face_material, area, len(mesh.materials)).argmax())]
