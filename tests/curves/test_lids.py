"""Flat parts that an opening may lie behind."""

from __future__ import annotations

import numpy as np
import trimesh

import warpsar
from warpsar.diagnosis.curve_materials import lids

AROUND = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.linspace(0.0, np.pi, 19)])


def test_a_box_has_the_sides_that_the_radar_sees() -> None:
    """Half a turn from +x by +y to -x: not -y, and neither top nor bottom, which are seen along their planes."""
    made = trimesh.creation.box((0.3, 0.2, 0.1))
    mesh = warpsar.Mesh.of(made.vertices, made.faces)
    middles = [mesh.vertices[mesh.faces[some]].mean(axis=(0, 1)) for some in lids(mesh, AROUND, 0.0)]
    found = {tuple(np.sign(np.round(one, 3)).astype(int)) for one in middles}
    assert found == {(1, 0, 0), (-1, 0, 0), (0, 1, 0)}
    assert len(lids(mesh, AROUND, 0.025)) == 1  # +y has 0.03 m2, the ends 0.02 m2


def test_mirror_images_are_one_and_a_smooth_body_has_none() -> None:
    ball = trimesh.creation.icosphere(3, radius=0.1)
    assert not lids(warpsar.Mesh.of(ball.vertices, ball.faces), AROUND, 0.0)
    boxes = [trimesh.creation.box((0.1, 0.05, 0.05)) for _ in range(2)]
    for one, y in zip(boxes, (-0.2, 0.2), strict=True):
        one.apply_translation((0.0, y, 0.0))
    both = trimesh.util.concatenate(boxes)
    mesh = warpsar.Mesh.of(both.vertices, both.faces)
    assert sorted(len(some) for some in lids(mesh, AROUND, 0.0)) == [4, 4, 4]
