"""The rays of a view: a regular grid across the look direction."""

from __future__ import annotations

import math

import warp as wp

from warpsar.errors import InputError
from warpsar.kernels.geometry import RayGrid
from warpsar.trace.hits import BinGrid
from warpsar.trace.target import Target
from warpsar.world.frame import ViewGeometry


def ray_count(target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float) -> int:
    """Rays that `trace` will send: what a progress bar counts to."""
    rays = ray_grid(target, geometry, grid, rays_per_m2, grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    return (last - first) * rays.elevation_cells


def ray_grid(
    target: Target, geometry: ViewGeometry, grid: BinGrid, rays_per_m2: float, pixel_area_m2: float
) -> RayGrid:
    """The cells of a view's rays: about square, and a whole number of them across each column of `grid`.

    `rays_per_m2` [1/m^2] counts over the plane across the look direction; `pixel_area_m2` [m^2] divides the rays'
    weights. Raises InputError where the mesh reaches the track of a strip-map.
    """
    low, high = target.ends(geometry)
    spacing = grid.spacing_m[1]
    per_column = max(1, round(spacing * math.sqrt(rays_per_m2)))
    step = spacing / per_column
    across_step = 1.0 / (rays_per_m2 * step)
    rays = RayGrid()
    rays.d, rays.u, rays.v = (wp.vec3(*axis) for axis in (geometry.d, geometry.u, geometry.v))
    margin = 1e-3 * max(1.0, high[0] - low[0])
    rays.standoff = float(margin - low[0])
    if geometry.slant_range_m is None:
        rays.slant_range = 0.0
        rays.reach = float(high[0] - low[0] + 3 * margin)
    else:
        r0 = geometry.slant_range_m
        if low[0] <= -r0:
            raise InputError(
                f"[radar] slant_range_m: found {r0:g}, and the mesh reaches {-low[0]:g} m toward the radar; "
                f"allowed is a track in front of the whole mesh"
            )
        rays.slant_range = r0
        rays.standoff = min(rays.standoff, r0)
        rays.reach = float(high[3] - r0 + rays.standoff + 3 * margin)
        across_step /= r0
    rays.azimuth_start = grid.start_m[1]
    rays.azimuth_step = step
    rays.cells_per_column = per_column
    rays.elevation_cells = max(1, math.ceil((high[2] - low[2]) / across_step * (1 - 1e-9)))
    rays.elevation_step = across_step
    # centred, so that a mesh seen from the opposite side meets the same strata
    rays.elevation_start = float((low[2] + high[2]) / 2 - rays.elevation_cells * across_step / 2)
    rays.range_start = grid.start_m[0]
    rays.range_spacing = grid.spacing_m[0]
    rays.rows, rays.cols = grid.shape
    rays.pixel_area = pixel_area_m2
    width = rays.azimuth_step * per_column
    first = max(0, math.floor((low[1] - rays.azimuth_start) / width))
    end = min(rays.cols, math.ceil((high[1] - rays.azimuth_start) / width))
    rays.first_cell, rays.end_cell = first * per_column, max(first, end) * per_column
    return rays
