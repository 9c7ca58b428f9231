"""The gradient of a view's images to the mesh's vertices, silhouettes and shadows included."""

from __future__ import annotations

import numpy as np

from warpsar.differentiable.facets import facets_of
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.render.render import ViewRender
from warpsar.trace.exact_adjoint import area_slopes, turned


def vertex_slopes(render: ViewRender, effects: list[DeclaredEffect]) -> np.ndarray:
    """What the render's last backward pass carries on to the vertices [1/m], shape (vertices, 3).

    Two things change as a vertex moves: the areas that are seen (`trace.exact_adjoint`), and how facets are turned to
    the radar. The view is turned by a hair to either side: where a face stands edge-on, or an edge on a surface, the
    slopes to both sides differ, and this is their mean, as that of a central difference.
    """
    target, hits = render.stage.target, render.hits
    weights = np.stack([render.light_gradient(name) for name in render.images])
    facets = facets_of(render, [one for one in effects if one.effect.stage != "image"])
    per_area = facets.power / hits.grid.pixel_area_m2
    found = np.mean(
        [area_slopes(target, turned(hits.geometry, sign), hits.grid, per_area, weights) for sign in (1.0, -1.0)], axis=0
    )
    face, pixel = hits.face.numpy(), hits.pixel.numpy()
    share = hits.weight.numpy().astype(float) * hits.cos_incidence.numpy().astype(float)
    seen = np.stack([np.bincount(face, w.ravel()[pixel] * share, len(facets.normals)) for w in weights])
    to_normal = np.einsum("kf,kfj->fj", seen, facets.slopes)
    faces = target.faces.numpy()
    np.add.at(found, faces, _to_corners(target.corners[faces], to_normal))
    return found


def _to_corners(corners: np.ndarray, to_normal: np.ndarray) -> np.ndarray:
    """From derivatives to unit normals, (faces, 3), which lie across them, to those of the corners, (faces, 3, 3)."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(np.cross(e1, e2), axis=1, keepdims=True)
    g = np.divide(to_normal, length, out=np.zeros_like(to_normal), where=length > 0.0)
    second, third = np.cross(e2, g), np.cross(g, e1)
    return np.stack([-second - third, second, third], axis=1)
