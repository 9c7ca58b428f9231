"""Lines of light along the edges of roofs and walls."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import amount
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels import binning
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects import edge_diffraction as kernels
from warpsar.runtime.structs import fill
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target

_SHARP_DEG = 30.0  # faces that turn by less are a curved surface in facets
_ONE_PLACE_M = 1e-6
_PIECES_PER_BIN = 2


@dataclass(frozen=True)
class SharpEdges:
    """Sharp edges of a mesh from `start` to `end` [m]; arrays of shape (n, 3), float64.

    `outward` is the unit vector that halves the outer angle between the two faces.
    """

    start: np.ndarray
    end: np.ndarray
    outward: np.ndarray


class EdgeDiffraction(Effect):
    """Every visible piece dl of a sharp edge returns strength (lambda / 2 pi) sin^2(b) dl of radar cross-section,
    b between edge and ray.

    A straight edge of length L has L^2 / pi sinc^2(k L cos b) about the normal to it. Over a radian this averages to
    L lambda / (2 pi): the return of an edge that is not straight to a wavelength. A `strength` of 1 is that mean. HH
    and VV get the same; HV and VH get nothing. An edge lies between two faces that turn by 30 degrees or more. Open
    boundaries of the mesh are no edges. A piece is visible if nothing lies between the radar and a point just outside
    its wedge. This hides the feet of walls and inner corners.
    """

    name = "edge_diffraction"
    stage = "path"
    of_surfaces_with = "eps_r"
    order = 20
    needs_all_hits = True
    summary = "lines along sharp edges"
    term = "edges"
    in_place = "edges in radar.terms"
    example: ClassVar[dict[str, Any]] = {"strength": 3.0}
    rate_case: ClassVar[dict[str, Any]] = {"strength": 3.0}
    parameters = (
        amount(
            "strength",
            "1",
            1e6,
            1.0,
            (1e-6, 1e4),
            "Cross-section of an edge, in units of lambda / (2 pi) per metre.",
            unstated=1.0,
        ),
    )

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """All edges must show it."""
        return image.halves()

    def trials(self, context: Context) -> list[Trial]:
        size = 0.1
        return [Trial((ScoreStep("strength", size, {"strength": size}, one_sided=True),), ({"strength": size},))]

    def paths(self, render: Recorder, p: wp.array, image: wp.array, polarization: int) -> wp.array:
        if Polarization(polarization).crossed:
            return image
        program = render.program
        if self.name not in render.hits.derived:
            render.hits.derived[self.name] = visible_pieces(render)
        bins, weight, points = render.hits.derived[self.name]
        share = program.array(image.shape[0], sum_into=True)
        render.layers[f"beta0_edges_{Polarization(polarization).name}"] = share
        if bins.shape[0] == 0:
            return image
        sigma = program.array(bins.shape[0])
        program.launch(kernels.strength_kernel, bins.shape[0], [p], [sigma])
        render.collect(sigma, weight, points, bins, share)
        return program.mapped(binning.add_kernel, image, [image, share])


def sharp_edges(target: Target) -> SharpEdges:
    """Edges at which exactly two faces meet under an angle. Vertices at one place count as one.

    A face that is no wider than `_ONE_PLACE_M` is a line: it lies on no side of its edges.
    """
    _, index = np.unique(np.round(target.corners / _ONE_PLACE_M), axis=0, return_inverse=True)
    faces = index.reshape(-1)[target.faces.numpy()]
    place = np.zeros((index.max() + 1, 3))
    place[index.reshape(-1)] = target.corners
    a, b, c = (place[faces[:, i]] for i in range(3))
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > _ONE_PLACE_M * longest]
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    key, which, count = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    first = np.cumsum(count) - count
    two = count == 2
    start, end = place[key[two, 0]], place[key[two, 1]]
    direction = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    into = []
    for k in (0, 1):
        arm = place[opposite[order[first[two] + k]]] - start
        arm -= (arm * direction).sum(axis=1, keepdims=True) * direction
        into.append(arm / np.linalg.norm(arm, axis=1, keepdims=True))
    # faces that go on straight have opposite arms
    sharp = (into[0] * into[1]).sum(axis=1) > -np.cos(np.deg2rad(_SHARP_DEG))
    outward = -(into[0] + into[1])[sharp]
    length = np.linalg.norm(outward, axis=1, keepdims=True)
    keep = length[:, 0] > 1e-9  # the two sides of one sheet have no outside
    return SharpEdges(start[sharp][keep], end[sharp][keep], outward[keep] / length[keep])


def visible_pieces(render: Recorder) -> tuple[wp.array, wp.array, wp.array]:
    """Pieces of sharp edges that the radar sees, on the device: bin of the hits' grid, weight, place (vec3 [m])."""
    hits, target = render.hits, render.stage.target
    device = target.device
    edges = sharp_edges(target)
    span = np.linalg.norm(edges.end - edges.start, axis=1)
    pieces = np.maximum(1, np.ceil(span / min(hits.grid.spacing_m) * _PIECES_PER_BIN)).astype(int)
    edge = np.repeat(np.arange(span.size), pieces)
    number = np.arange(edge.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    t = ((number + 0.5) / pieces[edge])[:, None]
    place = edges.start[edge] * (1 - t) + edges.end[edge] * t
    along = ((edges.end - edges.start) / span[:, None])[edge]

    def upload(array: np.ndarray, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(array, np.float32), dtype=dtype, device=device)

    bins, weight = wp.empty(edge.size, dtype=int, device=device), wp.empty(edge.size, dtype=float, device=device)
    area = render.spacing_m[0] * render.spacing_m[1]
    size = float(np.linalg.norm(np.ptp(target.corners, axis=0)))
    wavelength = 2.0 * np.pi / hits.geometry.wavenumber
    rays = ray_grid(target, hits.geometry, hits.grid, hits.rays_per_m2, area)
    vectors = {"place": place, "along": along, "outward": edges.outward[edge]}
    found = fill(
        kernels.EdgePieces,
        **{name: upload(array, wp.vec3) for name, array in vectors.items()},
        length=upload((span / pieces)[edge], float),
    )
    inputs = [rays, hits.grid.spacing_m[1], target.bvh.id, size, wavelength, found]
    wp.launch(kernels.edge_kernel, edge.size, inputs=inputs, outputs=[bins, weight], device=device)
    seen = np.flatnonzero(bins.numpy() >= 0)
    return (
        wp.array(bins.numpy()[seen], dtype=int, device=device),
        upload(weight.numpy()[seen], float),
        upload(place[seen], wp.vec3),
    )


EFFECT = EdgeDiffraction()
