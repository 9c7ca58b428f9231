"""A view without rays: the area of every visible face in every pixel, exact to rounding.

Rays sample where a silhouette or a shadow's edge lies, so that an image jumps as an edge crosses them. The exact areas
are smooth in the vertices, and differences of such images are their derivatives (docs/learn-method.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpsar.kernels import coverage as kernels
from warpsar.kernels.trace import HitArrays
from warpsar.runtime.structs import allocate, fill
from warpsar.trace.hits import ARRAYS, BinGrid, Hits
from warpsar.trace.rays import ray_grid
from warpsar.trace.target import Target
from warpsar.world.frame import ViewGeometry

CANDIDATES = (
    48  # faces in a band of a column, about: its work grows with their square, and that of bands with their number
)
SLABS = 4  # of a column, at least: lines where faces run through one another are no events
FAR = 1e300  # [m]: beyond every elevation
EDGE_ON = 1e-9  # of a face's longest edge squared: a smaller area across the look direction cannot be seen
BOW = 4e-3  # of a pixel in range: how far a face about a track may bend away from its plane over (azimuth, elevation)


def exact_hits(
    target: Target,
    geometry: ViewGeometry,
    grid: BinGrid,
    rays_per_m2: float,
    *,
    seed: int = 0,
    pixel_area_m2: float | None = None,
    only_columns: tuple[int, int] | None = None,
    only_faces: np.ndarray | None = None,
) -> Hits:
    """The hits of one view as `trace` gives them, without sampling noise.

    `rays_per_m2` and `seed` are those of effects that send rays of their own. About a track, faces are cut until they
    are flat over (azimuth, elevation) to `BOW` pixels. `only_faces`, shape (faces,): the faces that are there; no other
    is seen, and none hides anything.
    """
    device, pixel_area = target.device, pixel_area_m2 or grid.pixel_area_m2
    seen = ProjectedMesh.of(target, geometry, grid, only_faces)
    pixel, face, area, points = _merged_hits(
        seen, _covered(seen, grid, only_columns or (0, grid.shape[1]), device), grid
    )
    rays = ray_grid(target, geometry, grid, rays_per_m2, pixel_area)
    barycentric = _barycentric(target.corners.T, target.corner_numbers.T, face, points)
    n = len(pixel)
    hits = allocate(
        HitArrays,
        n,
        device,
        pixel=wp.array(pixel.astype(np.int32), dtype=int, device=device),
        face=wp.array(face.astype(np.int32), dtype=int, device=device),
        barycentric=wp.array(barycentric.T.astype(np.float32, order="C"), dtype=wp.vec2, device=device),
    )
    wp.launch(kernels.lit_point_kernel, n, inputs=[rays, target.triangles], outputs=[hits], device=device)
    cosine = np.maximum(hits.cos_incidence.numpy().astype(float), 1e-6)
    hits.weight.assign((area / (cosine * pixel_area)).astype(np.float32))
    arrays = {name: getattr(hits, name) for name in ARRAYS}
    return Hits(grid, geometry, rays_per_m2=rays_per_m2, seed=seed, rays=0, **arrays)


def _merged_hits(seen: ProjectedMesh, cells: _Covered, grid: BinGrid) -> tuple[np.ndarray, ...]:
    """Pixel, face, area across the look direction [m^2] and mean point (3, n) [m], one for each face in a pixel."""
    pixel = cells.row * grid.shape[1] + cells.column
    key = pixel * len(seen.faces) + seen.parent[cells.face]
    order = np.argsort(key, kind="stable")
    key, area, face = key[order], cells.area[order], cells.face[order]
    points = seen.points(face, cells.azimuth[order] / area, cells.elevation[order] / area)
    area = area * seen.stretch(points)
    start = np.flatnonzero(np.diff(key, prepend=-1))
    pixel, parent = np.divmod(key[start], len(seen.faces))
    if len(start) == len(key):  # mostly
        return pixel, parent, area, points
    total = np.add.reduceat(area, start)
    # along the rows of an array the sum goes from one to the next
    sums = np.add.reduceat(np.ascontiguousarray((points * area).T), start).T
    return pixel, parent, total, sums / total


def _barycentric(vertices: np.ndarray, corners: np.ndarray, face: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights of the second and third corner, (2, n), of points (3, n) on the triangles numbered `face`, shape (n,);
    `corners`, (3, faces), are those of each triangle by their numbers among the `vertices` (3, m)."""
    first, second, third = (np.stack([axis[at] for axis in vertices]) for at in corners)
    e1, e2 = second - first, third - first
    normal = _cross(e1, e2)
    with np.errstate(divide="ignore", invalid="ignore"):  # of triangles without an area, which no point lies on
        slopes = np.stack([_cross(e2, normal), _cross(normal, e1)]) / _dot(normal, normal)
    from_first = points - first.take(face, axis=1)
    return np.stack([_dot(from_first, slope.take(face, axis=1)) for slope in slopes])


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products of vectors, shape (3, n)."""
    return np.stack([a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)])


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products of vectors (3, n), shape (n,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass
class ProjectedMesh:
    """A mesh across the look direction of a view.

    `azimuth`, `elevation` and `range` [m] of every corner, shape (vertices,); about a track the elevation is the angle
    times the track's range R0. `corners`, (faces, 3), are the faces that can be seen, cut where they bend; `parent`,
    (faces,), is the face of the mesh that each belongs to.
    """

    geometry: ViewGeometry
    azimuth: np.ndarray
    elevation: np.ndarray
    range: np.ndarray
    corners: np.ndarray
    parent: np.ndarray
    faces: np.ndarray
    plane: np.ndarray

    @classmethod
    def of(
        cls, target: Target, geometry: ViewGeometry, grid: BinGrid, only_faces: np.ndarray | None = None
    ) -> ProjectedMesh:
        faces = target.corner_numbers
        if only_faces is None:
            parent, (points, corners) = np.arange(len(faces)), target.places_once
        else:
            parent = np.flatnonzero(only_faces)
            points, corners = target.places_of(faces[parent])
        along, across = points @ geometry.d, points @ geometry.v
        if geometry.slant_range_m is not None:
            points, corners, cut = _cut(points, corners, geometry, BOW * grid.spacing_m[0])
            parent = parent[cut]
            r0 = geometry.slant_range_m
            along, across = points @ geometry.d, points @ geometry.v
            angle = np.arctan2(across, r0 + along)
            along, across = np.hypot(r0 + along, across) - r0, r0 * angle
        azimuth = points @ geometry.u
        plane, area = _planes(azimuth[corners], across[corners], along[corners])
        p = points[corners]
        longest = np.max([((p[:, k] - p[:, k - 1]) ** 2).sum(axis=1) for k in range(3)], axis=0)
        lit = area > EDGE_ON * longest
        return cls(geometry, azimuth, across, along, corners[lit], parent[lit], faces, plane[lit])

    def points(self, face: np.ndarray, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
        """World points about the reference point, (3, n) [m], at places on faces."""
        plane, g = self.plane[face], self.geometry
        along, across = plane[:, 0] + plane[:, 1] * azimuth + plane[:, 2] * elevation, elevation
        if g.slant_range_m is not None:
            distance, angle = g.slant_range_m + along, elevation / g.slant_range_m
            along, across = distance * np.cos(angle) - g.slant_range_m, distance * np.sin(angle)
        return np.stack([azimuth * u + along * d + across * v for u, d, v in zip(g.u, g.d, g.v, strict=True)])

    def stretch(self, points: np.ndarray) -> np.ndarray | float:
        """Area across the look direction over that in (azimuth, elevation), (n,): about a track a fan opens."""
        r0, g = self.geometry.slant_range_m, self.geometry
        if r0 is None:
            return 1.0
        points = np.ascontiguousarray(points.T)
        return np.hypot(r0 + points @ g.d, points @ g.v) / r0


def _planes(a: np.ndarray, e: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`plane` of `kernels.coverage.Faces`, (n, 3), and twice the area over (a, e), (n,); a, e, r have shape (n, 3)."""
    da, de, dr = (x[:, 1:] - x[:, :1] for x in (a, e, r))
    det = da[:, 0] * de[:, 1] - da[:, 1] * de[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        per_a = (dr[:, 0] * de[:, 1] - dr[:, 1] * de[:, 0]) / det
        per_e = (da[:, 0] * dr[:, 1] - da[:, 1] * dr[:, 0]) / det
        plane = np.stack([r[:, 0] - per_a * a[:, 0] - per_e * e[:, 0], per_a, per_e], axis=1)
    return plane, np.abs(det)


def _cut(
    points: np.ndarray, corners: np.ndarray, geometry: ViewGeometry, bow_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces halved at their longest edge until none bends by more than `bow_m`; and the face that each came from."""
    assert geometry.slant_range_m is not None
    longest = math.sqrt(8.0 * bow_m * geometry.slant_range_m)
    parent = np.arange(len(corners))
    while True:
        plane = np.stack([points @ geometry.d, points @ geometry.v], axis=1)[corners]
        length = np.stack([np.linalg.norm(plane[:, (k + 1) % 3] - plane[:, k], axis=1) for k in range(3)], axis=1)
        split = length.max(axis=1) > longest
        if not split.any():
            return points, corners, parent
        side = length[split].argmax(axis=1)[:, None] + np.arange(3)
        p, q, r = np.take_along_axis(corners[split], side % 3, axis=1).T
        # neighbours halve a common edge at the same place
        ends = np.sort(np.stack([p, q], axis=1), axis=1)
        unique, index = np.unique(ends, axis=0, return_inverse=True)
        middle = len(points) + index.ravel()
        points = np.concatenate([points, points[unique].mean(axis=1)])
        halves = [np.stack([p, middle, r], axis=1), np.stack([middle, q, r], axis=1)]
        corners = np.concatenate([corners[~split], *halves])
        parent = np.concatenate([parent[~split], parent[split], parent[split]])


@dataclass
class _Covered:
    """Pixels and the faces that cover them, shape (n,) each; `azimuth` and `elevation` are moments of the area."""

    area: np.ndarray
    azimuth: np.ndarray
    elevation: np.ndarray
    column: np.ndarray
    row: np.ndarray
    face: np.ndarray


@dataclass
class ColumnSweep:
    """What one sweep over the columns of a view takes, on the device.

    Every column has the same bands of elevation, as `kernels.coverage.Columns` numbers them: `columns` counts them all.
    `face` are the candidates' faces and `first` where each column's candidates begin; `low` is the first row of each
    candidate's cells, and `start` where its cells begin. `order`, (faces, 3), says which corner of a face comes first,
    second and third by azimuth.
    """

    device: wp.Device
    columns: int
    inputs: list[Any]
    room: kernels.Stretches
    cells: kernels.CandidateCells
    face: np.ndarray
    first: np.ndarray
    low: np.ndarray
    start: np.ndarray
    order: np.ndarray

    @classmethod
    def of(
        cls,
        seen: ProjectedMesh,
        grid: BinGrid,
        columns: tuple[int, int],
        device: wp.Device,
        limits: np.ndarray | None = None,
    ) -> ColumnSweep:
        """`limits` [m] between bands of elevation, ascending; without them a column is one band."""
        rows = grid.shape[0]
        border = grid.start_m[1] + grid.spacing_m[1] * np.arange(columns[0], columns[1] + 1)
        limits = np.zeros(0) if limits is None else limits
        azimuth, elevation = seen.azimuth[seen.corners], seen.elevation[seen.corners]
        first, face = _in_columns(azimuth, elevation, border, limits, elevation.min(axis=1))
        events, first_event = _events(seen, border, limits, device)
        place = (seen.range[seen.corners] - grid.start_m[0]) / grid.spacing_m[0]
        low = np.clip(np.floor(place.min(axis=1)).astype(np.int64) - 1, 0, rows)[face]
        high = np.clip(np.floor(place.max(axis=1)).astype(np.int64) + 2, 0, rows)[face]
        start = np.concatenate([[0], np.cumsum(np.maximum(high - low, 1))])
        sums = {
            name: wp.zeros(int(start[-1]), dtype=wp.float64, device=device) for name in ("area", "azimuth", "elevation")
        }
        cells = fill(
            kernels.CandidateCells, first_row=_put(low, int, device), start=_put(start[:-1], int, device), **sums
        )
        order = np.argsort(seen.azimuth[seen.corners], axis=1, kind="stable")
        corners = np.take_along_axis(seen.corners, order, axis=1)
        faces = fill(
            kernels.Faces,
            azimuth=_put(seen.azimuth[corners], wp.float64, device),
            elevation=_put(seen.elevation[corners], wp.float64, device),
            plane=_put(seen.plane, wp.float64, device),
        )
        within = fill(
            kernels.Columns,
            candidates=_put(face, int, device),
            first_candidate=_put(first, int, device),
            events=_put(events, wp.float64, device),
            first_event=_put(first_event, int, device),
            limits=_put(np.concatenate([[-FAR], limits, [FAR]]), wp.float64, device),
        )
        lines = fill(kernels.Rows, count=rows, start=grid.start_m[0], spacing=grid.spacing_m[0])
        room = allocate(kernels.Stretches, len(face), device)
        return cls(device, len(first) - 1, [faces, within, lines], room, cells, face, first, low, start, order)

    def run(self, pieces: kernels.Pieces) -> None:
        """Add up the areas in `cells`, and keep the visible `pieces` where they have room."""
        outputs = [self.room, self.cells, pieces]
        wp.launch(kernels.coverage_kernel, self.columns, inputs=self.inputs, outputs=outputs, device=self.device)


def _covered(seen: ProjectedMesh, grid: BinGrid, columns: tuple[int, int], device: wp.Device) -> _Covered:
    limits = _limits(seen, grid, columns)
    sweep = ColumnSweep.of(seen, grid, columns, device, limits)
    sweep.run(kernels.Pieces())
    cells, first, low, start = sweep.cells, sweep.first, sweep.low, sweep.start
    area = cells.area.numpy()
    lit = np.flatnonzero(area > 0.0)
    candidate = np.searchsorted(start, lit, side="right") - 1
    column = (np.searchsorted(first, candidate, side="right") - 1) // (len(limits) + 1) + columns[0]
    row = low[candidate] + lit - start[candidate]
    moments = (cells.azimuth.numpy()[lit], cells.elevation.numpy()[lit])
    return _Covered(area[lit], *moments, column, row, sweep.face[candidate])


def _put(values: np.ndarray, kind: type, device: wp.Device) -> wp.array:
    values = np.ascontiguousarray(values, np.int32 if kind is int else np.float64)
    return wp.array(values, dtype=kind, device=device, copy=False)


def _limits(seen: ProjectedMesh, grid: BinGrid, columns: tuple[int, int]) -> np.ndarray:
    """Elevations [m] that part the columns into bands, each with as many corners as the others, and between corners."""
    azimuth = seen.azimuth[seen.corners]
    border = grid.start_m[1] + grid.spacing_m[1] * np.arange(columns[0], columns[1] + 1)
    first, last = _span(azimuth, border)
    bands = int(np.maximum(last - first + 1, 0).sum() / (len(border) - 1) / CANDIDATES) + 1
    reached = seen.corners[last >= first]
    values = np.unique(seen.elevation[np.unique(reached)])
    at = np.unique(len(values) * np.arange(1, bands) // bands) if len(values) > bands else np.zeros(0, int)
    return 0.5 * (values[at - 1] + values[at])


def _span(azimuth: np.ndarray, border: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first and the last column that elements reach into, whose corners have the azimuths (n, k)."""
    columns, spacing = len(border) - 1, border[1] - border[0]
    first = np.clip(np.floor((azimuth.min(axis=1) - border[0]) / spacing).astype(np.int64), 0, columns)
    last = np.clip(np.floor((azimuth.max(axis=1) - border[0]) / spacing).astype(np.int64), -1, columns - 1)
    return first, last


def _in_columns(
    azimuth: np.ndarray,
    elevation: np.ndarray,
    border: np.ndarray,
    limits: np.ndarray,
    within: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Which of the elements, whose corners have the azimuths and elevations (n, k), reach into each band of a column;
    `within` sorts them there.

    Where each band's list begins, (columns * bands + 1,), and the lists one after the other.
    """
    bands = len(limits) + 1
    first, last = _span(azimuth, border)
    low, high = (np.searchsorted(limits, ends) for ends in (elevation.min(axis=1), elevation.max(axis=1)))
    across = high - low + 1
    counts = np.maximum(last - first + 1, 0) * across
    element = np.repeat(np.arange(len(azimuth)), counts)
    number = np.arange(len(element)) - np.repeat(np.cumsum(counts) - counts, counts)
    column = (first[element] + number // across[element]) * bands + low[element] + number % across[element]
    order = np.argsort(column, kind="stable") if within is None else np.lexsort((within[element], column))
    return np.searchsorted(column[order], np.arange((len(border) - 1) * bands + 1)), element[order]


def _events(
    seen: ProjectedMesh, border: np.ndarray, limits: np.ndarray, device: wp.Device
) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths between which the order of edges stays, by band of a column: the borders, vertices, and crossings of
    edges with each other and with the bands' limits."""
    bands, spacing = len(limits) + 1, border[1] - border[0]
    columns = (len(border) - 1) * bands
    edges, outline = _edges(seen)
    azimuth, elevation = seen.azimuth[edges], seen.elevation[edges]
    first, element = _in_columns(azimuth, elevation, border, limits)
    own = np.flatnonzero(outline)
    first_own, own_element = _in_columns(azimuth[own], elevation[own], border, limits)
    order = np.take_along_axis(edges, np.argsort(azimuth, axis=1, kind="stable"), axis=1)
    ends = np.stack([seen.azimuth[order], seen.elevation[order], seen.range[order]], axis=-1)
    known = [
        fill(
            kernels.CoverageEdges, start=_put(ends[:, 0], wp.float64, device), end=_put(ends[:, 1], wp.float64, device)
        ),
        fill(
            kernels.EdgesInColumns,
            outlines=_put(own[own_element], int, device),
            first_outline=_put(first_own, int, device),
            others=_put(element, int, device),
            first_other=_put(first, int, device),
            border=_put(border, wp.float64, device),
            bands=bands,
        ),
    ]
    counts = wp.zeros(columns, dtype=int, device=device)
    nowhere, none = wp.zeros(columns, dtype=int, device=device), wp.zeros(0, dtype=wp.float64, device=device)
    wp.launch(kernels.crossing_kernel, columns, inputs=[*known, nowhere], outputs=[counts, none], device=device)
    number = counts.numpy()
    crossings = wp.zeros(int(number.sum()), dtype=wp.float64, device=device)
    if crossings.shape[0]:
        begin = _put(np.cumsum(number) - number, int, device)
        wp.launch(kernels.crossing_kernel, columns, inputs=[*known, begin], outputs=[counts, crossings], device=device)
    places, in_band = (
        np.concatenate(each) for each in zip(_corners(seen, limits), _passes(seen, edges, limits), strict=True)
    )
    inside = (places > border[0]) & (places < border[-1])
    places, in_band = places[inside], in_band[inside]
    cuts = np.repeat(border[:-1, None] + spacing * np.arange(SLABS) / SLABS, bands, axis=0)
    every = np.concatenate([cuts.ravel(), np.repeat(border[1:], bands), places, crossings.numpy()])
    where = np.concatenate(
        [
            np.repeat(np.arange(columns), SLABS),
            np.arange(columns),
            np.floor((places - border[0]) / spacing).astype(np.int64) * bands + in_band,
            np.repeat(np.arange(columns), number),
        ]
    )
    sort = np.lexsort((every, where))
    return every[sort], np.searchsorted(where[sort], np.arange(columns + 1))


def _corners(seen: ProjectedMesh, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths of corners, and bands that their faces reach into: there a face's side bends, or its end begins."""
    elevation = seen.elevation[seen.corners]
    low, high = (np.searchsorted(limits, ends) for ends in (elevation.min(axis=1), elevation.max(axis=1)))
    face, band = _each(low, high + 1)
    bands = len(limits) + 1
    corner, band = np.divmod(np.unique(seen.corners[face] * bands + band[:, None]), bands)
    return seen.azimuth[corner], band


def _passes(seen: ProjectedMesh, edges: np.ndarray, limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Azimuths at which edges (n, 2) pass limits between bands, and the band on either side."""
    a, e = seen.azimuth[edges], seen.elevation[edges]
    edge, at = _each(np.searchsorted(limits, e.min(axis=1), "right"), np.searchsorted(limits, e.max(axis=1)))
    share = (limits[at] - e[edge, 0]) / (e[edge, 1] - e[edge, 0])
    azimuth = a[edge, 0] + share * (a[edge, 1] - a[edge, 0])
    return np.tile(azimuth, 2), np.concatenate([at, at + 1])


def _each(first: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every number from `first` to before `end` of each element, shape (n,), and the element that it belongs to."""
    counts = np.maximum(end - first, 0)
    element = np.repeat(np.arange(len(first)), counts)
    return element, first[element] + np.arange(len(element)) - np.repeat(np.cumsum(counts) - counts, counts)


def _edges(seen: ProjectedMesh) -> tuple[np.ndarray, np.ndarray]:
    """Edges as pairs of vertices, (n, 2), and which of them are outlines, (n,) bool.

    Two faces on either side of an edge, as the radar sees them, hide alike what lies behind it. All other edges are
    outlines.
    """
    corners, count = seen.corners, len(seen.azimuth)
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    opposite = np.concatenate([corners[:, 2], corners[:, 0], corners[:, 1]])
    sides.sort(axis=1)
    key = sides[:, 0] * count + sides[:, 1]
    unique, first, index, number = np.unique(key, return_index=True, return_inverse=True, return_counts=True)
    p, q = sides[:, 0], sides[:, 1]
    a, e = seen.azimuth, seen.elevation
    turn = (a[q] - a[p]) * (e[opposite] - e[p]) - (a[opposite] - a[p]) * (e[q] - e[p])
    left = np.bincount(index.ravel(), turn > 0, len(unique))
    return sides[first], ~((number == 2) & (left == 1))
