"""The gradient of a view's images to the mesh's vertices, silhouettes and shadows included."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.kernels.coverage import facet_kernel
from warpsar.render.render import ViewRender
from warpsar.surface.stage import Stage
from warpsar.trace.exact_adjoint import area_slopes, turned
from warpsar.trace.hits import BinGrid, Hits
from warpsar.trace.rays import ray_grid


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


# ---- what the facets of a mesh return, and how that changes as they turn


TURN = 2e-3  # [rad] of a difference: sigma0 bends over some 0.1 rad


@dataclass(frozen=True)
class Facets:
    """`power`, (polarizations, faces): sigma0 / cos(incidence) of every face. `slopes`, (polarizations, faces, 3): its
    derivative to the corners' normal, a unit vector, across that normal. `normals`, (faces, 3)."""

    power: np.ndarray
    slopes: np.ndarray
    normals: np.ndarray


def facets_of(render: ViewRender, effects: list[DeclaredEffect]) -> Facets:
    """The facets as a view sees them, with the nodes and effects of its `render`; for a plane wave and uniform layouts.

    `effects` are those before the image stage; each is `by_incidence`.
    """
    stage, hits = render.stage, render.hits
    corners = stage.target.corners[stage.target.faces.numpy()]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    normal = np.where(length[:, None] > 0.0, normal / np.maximum(length, 1e-300)[:, None], (0.0, 0.0, 1.0))
    alone = _Alone(stage, render, hits, corners.mean(axis=1), effects)
    first = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    power = alone.power(normal)
    slopes = np.zeros((*power.shape, 3))
    for tangent in (first, np.cross(normal, first)):
        up, down = (alone.power(normal + sign * TURN * tangent) for sign in (1.0, -1.0))
        slopes += ((up - down) / (2.0 * TURN))[..., None] * tangent
    return Facets(power, slopes, normal)


class _Alone:
    """A render with one hit of weight 1 for each face, in a pixel of its own."""

    def __init__(
        self, stage: Stage, like: ViewRender, hits: Hits, middle: np.ndarray, effects: list[DeclaredEffect]
    ) -> None:
        n, device = len(middle), stage.target.device
        grid = BinGrid((n, 1), (1.0, 1.0))
        self._rays = ray_grid(stage.target, hits.geometry, hits.grid, hits.rays_per_m2, hits.grid.pixel_area_m2)
        order = np.arange(n, dtype=np.int32)
        arrays: dict[str, Any] = {
            "pixel": wp.array(order, dtype=int, device=device),
            "face": wp.array(order, dtype=int, device=device),
            "barycentric": wp.array(np.full((n, 2), 1.0 / 3.0, np.float32), dtype=wp.vec2, device=device),
            "weight": wp.array(np.ones(n, np.float32), dtype=float, device=device),
            "point": wp.array(middle.astype(np.float32), dtype=wp.vec3, device=device),
        }
        arrays |= {
            name: wp.zeros(n, dtype=float, device=device) for name in ("cos_incidence", "cos_twist", "cos2_azimuth")
        }
        self._hits = Hits(grid, hits.geometry, rays_per_m2=hits.rays_per_m2, seed=0, rays=0, **arrays)
        self._render = ViewRender(stage, like.view, self._hits, grid.shape, tuple(like.images), effects)
        wp.copy(self._render.nodes, like.nodes)
        for name, values in self._render.effect_values.items():
            wp.copy(values, like.effect_values[name])

    def power(self, normal: np.ndarray) -> np.ndarray:
        """sigma0 / cos(incidence), (polarizations, faces), float64, for facets with these normals."""
        unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        given: wp.array = wp.array(unit.astype(np.float32), dtype=wp.vec3, device=self._hits.point.device)
        hits = self._hits.arrays
        wp.launch(facet_kernel, len(unit), inputs=[self._rays, given], outputs=[hits], device=given.device)
        cosine = np.maximum(hits.cos_incidence.numpy().astype(float), 1e-6)
        images = self._render.forward()
        return np.stack([image[:, 0].astype(float) / cosine for image in images.values()])
