"""How sums over an exact image change as the mesh's vertices move: silhouettes, shadows and ranges, in one sweep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from warpsar.kernels import coverage as kernels
from warpsar.kernels import coverage_adjoint as adjoint
from warpsar.runtime.structs import allocate, fill
from warpsar.trace.exact import ColumnSweep, ProjectedMesh
from warpsar.trace.hits import BinGrid
from warpsar.trace.target import Target
from warpsar.world.frame import ViewGeometry

HAIR = 1e-6  # [rad] by which a view is turned, so that no edge lies along elevation and no face stands edge-on


def turned(geometry: ViewGeometry, sign: float) -> ViewGeometry:
    """The view turned by a hair about all three of its axes, one way or the other."""
    axes = np.stack([geometry.d, geometry.u, geometry.v])
    a, b, c = sign * HAIR * np.array([1.0, 0.61, 0.37])
    turn = np.array([[1.0, b, c], [-b, 1.0, a], [-c, -a, 1.0]])  # orthogonal to HAIR squared
    d, u, v = turn @ axes
    return replace(geometry, s=-d, d=d, u=u, v=v)


def area_slopes(
    target: Target, geometry: ViewGeometry, grid: BinGrid, power: np.ndarray, image: np.ndarray
) -> np.ndarray:
    """d sum(image * power * visible area) / d vertices [1/m], shape (vertices, 3), of a view with a plane wave.

    The sum goes over k, over faces, and over pixels: `power` is what a square metre across the look direction returns,
    shape (k, faces), and `image` the weight of each pixel, shape (k, rows, cols). `power` is held.
    """
    seen = ProjectedMesh.of(target, geometry, grid)
    device = target.device
    sweep = ColumnSweep.of(seen, grid, (0, grid.shape[1]), device)
    pieces, count = _pieces(sweep)
    worth = fill(
        adjoint.Worth,
        image=wp.array(np.ascontiguousarray(image, np.float64), dtype=wp.float64, device=device),
        power=wp.array(np.ascontiguousarray(power[:, seen.parent], np.float64), dtype=wp.float64, device=device),
    )
    faces = len(seen.corners)
    slopes = fill(
        adjoint.CoverageSlopes,
        corners=wp.zeros((faces, 6), dtype=wp.float64, device=device),
        plane=wp.zeros((faces, 3), dtype=wp.float64, device=device),
    )
    corner_id = np.take_along_axis(seen.corners, sweep.order, axis=1)
    faces_seen, _, rows = sweep.inputs
    inputs = [faces_seen, wp.array(corner_id.astype(np.int32), dtype=int, device=device), pieces, worth, rows]
    wp.launch(adjoint.coverage_adjoint_kernel, count, inputs=inputs, outputs=[slopes], device=device)
    by_corner = _to_corners(seen, sweep.order, slopes)
    found = np.zeros_like(target.corners)
    np.add.at(found, seen.faces[seen.parent], by_corner)
    return found


def _pieces(sweep: ColumnSweep) -> tuple[kernels.Pieces, int]:
    """The visible pieces of a sweep, and how many there are: they are counted first."""
    device = sweep.device
    pieces = fill(kernels.Pieces, count=wp.zeros(sweep.columns, dtype=int, device=device))
    sweep.run(pieces)
    ends = np.cumsum(pieces.count.numpy())
    count = int(ends[-1])
    pieces = allocate(
        kernels.Pieces,
        count,
        device,
        first=wp.array(np.concatenate([[0], ends[:-1]]).astype(np.int32), dtype=int, device=device),
        count=pieces.count,
    )
    sweep.run(pieces)
    return pieces, count


def _to_corners(seen: ProjectedMesh, order: np.ndarray, slopes: adjoint.CoverageSlopes) -> np.ndarray:
    """Derivatives to the faces' corners in the world, (faces, 3 corners, 3)."""
    azimuth, elevation = seen.azimuth[seen.corners], seen.elevation[seen.corners]
    # a plane p goes through its corners: p0 + p1 a + p2 e = r
    through = np.stack([np.ones_like(azimuth), azimuth, elevation], axis=2)
    to_range = np.linalg.solve(through.transpose(0, 2, 1), slopes.plane.numpy()[..., None])[..., 0]
    found = np.zeros((len(order), 3, 2))
    np.put_along_axis(found, order[:, :, None], slopes.corners.numpy().reshape(-1, 3, 2), axis=1)
    to_azimuth = found[..., 0] - to_range * seen.plane[:, 1:2]
    to_elevation = found[..., 1] - to_range * seen.plane[:, 2:3]
    g = seen.geometry
    return to_azimuth[..., None] * g.u + to_elevation[..., None] * g.v + to_range[..., None] * g.d
