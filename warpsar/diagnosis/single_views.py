"""Whether a test view was taken from another angle than the scene says. No other view can tell that.

A view's own number is a fault of its metadata, and none of the model. So where test views alone are wrong, each is
asked by itself, as it is for its own gain (`Judge.with_own_numbers`). One angle is little beside a view's pixels: what
is left of them still tests everything else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np

from warpsar.compare.comparison import Comparison, granted_px
from warpsar.compare.judgement import Judgement
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.geometry.registry import of, sensor_changes
from warpsar.diagnosis.models.judge import under
from warpsar.diagnosis.models.names import object_of
from warpsar.diagnosis.models.projection import pixel_of
from warpsar.learning.geometry import with_free
from warpsar.learning.pose_search import FoundPoses, find_poses
from warpsar.parameters.at import at
from warpsar.scene.scene import Scene

GEOMETRY = {"edges", "structure"}  # what a wrong angle leaves


def may_be_angles(verdicts: Mapping[str, Judgement]) -> bool:
    """Whether test views alone are wrong, by what a wrong angle does to images."""
    return "test" in verdicts and not verdicts["train"].wrong and bool(GEOMETRY & set(verdicts["test"].findings))


def with_own_angles(diagnosis: Diagnosis, stated: Scene) -> Diagnosis:
    """The diagnosis whose final scene has the angle of each test view that explains it, where one does.

    `stated`: the scene whose looks and texture the judgement takes. A view whose angle leaves anything stays as it is.
    """
    scene, sensor, names = diagnosis.final.scene, dict(diagnosis.sensor), list[str]()
    images = under(diagnosis.judge(scene, "test"), stated)
    for view, some in groupby(images, lambda image: image.view.name):
        if not GEOMETRY & set(_judgement(diagnosis, list(some)).findings):
            continue
        found = _turned(diagnosis, scene, stated, view)
        if found is not None:
            scene, name, values = found
            sensor.setdefault(object_of(name), {}).update(values)
            names.append(name)
    if not names:
        return diagnosis
    return replace(diagnosis, final=replace(diagnosis.final, scene=scene), sensor=sensor, of_test_views=names)


def _turned(
    diagnosis: Diagnosis, scene: Scene, stated: Scene, view: str
) -> tuple[Scene, str, dict[str, dict[str, Any]]] | None:
    """The scene with the number of the view alone that explains it best, its name and values; None where none does.

    An angle that moves outlines by less than is granted them explains nothing: it follows what a surface lacks.
    """
    asked = [
        one
        for change in sensor_changes()
        for one in change.hypotheses(diagnosis.scene, scene, [view])
        if change.only_view(one.label) == view
    ]
    seen = [image.seen for image in diagnosis.judge(scene, "test") if image.view.name == view]
    alone = [one.model_copy(update={"role": "train"}) for one in scene.views if one.name == view]
    best: FoundPoses | None = None
    for each in asked:
        free = with_free(replace(scene, views=alone), each.parameters)
        found = find_poses(free, diagnosis.setup.device, observations={view: seen}, held=True)
        if best is None or found.loss < best.loss:
            best, chosen = found, each
    if best is None:
        return None
    turned = at(scene, {scene.parameters[one]: best.scene.parameters[one].value for one in chosen.parameters})
    if np.all(_moved_px(scene, turned, view) < granted_px(scene)):
        return None
    images = [one for one in under(diagnosis.judge(turned, "test"), stated) if one.view.name == view]
    if _judgement(diagnosis, images).wrong:
        return None
    return turned, chosen.name, of(chosen.name).values(diagnosis.scene, turned, chosen.label, {}, best)


def _moved_px(scene: Scene, turned: Scene, view: str) -> np.ndarray:
    """Rows and columns by which the mesh's corners within the view's image move at most, shape (2,)."""
    points = np.unique(scene.mesh.vertices[scene.mesh.faces.ravel()], axis=0) - scene.reference_point_m
    before, after = (
        np.array(pixel_of(one, next(each for each in one.views if each.name == view), points))
        for one in (scene, turned)
    )
    inside = np.all((before >= 0) & (before < np.array(scene.grid.shape)[:, None]), axis=0)
    return np.abs(after - before)[:, inside].max(axis=1, initial=0.0)


def _judgement(diagnosis: Diagnosis, images: list[Comparison]) -> Judgement:
    return diagnosis.judge.judgement(images)
