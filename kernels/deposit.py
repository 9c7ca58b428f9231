"""Where the power of one ray falls in range."""

import warp as wp

from warpsar.kernels.codes import Deposit
from warpsar.kernels.geometry import RayGrid, elevation_step_at, slant_range_of


@wp.struct
class Footprint:
    """A ray's power in range [m]: boxes `wide` and `narrow`, convolved about `middle` and cut to [low, high], hold
    `total` of it; all falls into one bin where low is high."""

    middle: float
    wide: float
    narrow: float
    low: float
    high: float
    total: float


@wp.func
def share_before(offset: float, wide: float, narrow: float) -> float:
    """Share of a cell's power at ranges below `offset` from its middle: boxes `wide` and `narrow` convolved.

    That is how a parallelogram on a plane lies in range, so the cells of a plane add up to a flat image.
    """
    distance = wp.abs(offset)
    beyond = float(0.0)
    if distance <= 0.5 * (wide - narrow):
        beyond = 0.5 - distance / wp.max(wide, 1.0e-30)
    elif distance < 0.5 * (wide + narrow):
        rest = 0.5 * (wide + narrow) - distance
        beyond = 0.5 * rest * rest / wp.max(wide * narrow, 1.0e-30)
    if offset < 0.0:
        return beyond
    return 1.0 - beyond


@wp.func
def footprint_of(
    grid: RayGrid,
    deposit: int,
    centre: float,
    normal: wp.vec3,
    direction: wp.vec3,
    p0: wp.vec3,
    p1: wp.vec3,
    p2: wp.vec3,
    jitter: wp.vec2,
) -> Footprint:
    """The footprint of a ray that meets the triangle at the slant range `centre`."""
    middle = centre
    wide = float(0.0)
    narrow = float(0.0)
    low = float(-1.0e30)
    high = float(1.0e30)
    if deposit == Deposit.LINEAR:
        wide = grid.range_spacing
    if deposit == Deposit.FOOTPRINT:
        # The cell's own extent in range on the facet's plane: the sample's jitter drops out of it.
        slope = wp.dot(normal, direction)
        per_u = -wp.dot(normal, grid.u) / slope * grid.azimuth_step
        per_v = -wp.dot(normal, wp.cross(grid.u, direction)) / slope * elevation_step_at(grid, centre)
        r0 = slant_range_of(grid, p0)
        r1 = slant_range_of(grid, p1)
        r2 = slant_range_of(grid, p2)
        middle = centre - per_u * jitter[0] - per_v * jitter[1]
        wide = wp.max(wp.abs(per_u), wp.abs(per_v))
        narrow = wp.min(wp.abs(per_u), wp.abs(per_v))
        low = wp.min(wp.min(r0, centre), wp.min(r1, r2))
        high = wp.max(wp.max(r0, centre), wp.max(r1, r2))
    half = 0.5 * (wide + narrow)
    low = wp.max(low, middle - half)
    high = wp.min(high, middle + half)
    below = share_before(low - middle, wide, narrow)
    total = share_before(high - middle, wide, narrow) - below
    if wide < 1.0e-5 * grid.range_spacing or total < 1.0e-4:
        low = centre
        high = centre
    footprint = Footprint()
    footprint.middle = middle
    footprint.wide = wide
    footprint.narrow = narrow
    footprint.low = low
    footprint.high = high
    footprint.total = total
    return footprint


@wp.func
def row_at(grid: RayGrid, slant_range: float) -> float:
    return wp.floor((slant_range - grid.range_start) / grid.range_spacing)


@wp.func
def share_in(grid: RayGrid, footprint: Footprint, row: float) -> float:
    """Share of the power that falls into a row which the footprint reaches."""
    share = float(1.0)
    if footprint.high > footprint.low:
        edge = grid.range_start + row * grid.range_spacing
        middle = footprint.middle
        end = wp.min(footprint.high, edge + grid.range_spacing)
        upper = share_before(end - middle, footprint.wide, footprint.narrow)
        lower = share_before(wp.max(footprint.low, edge) - middle, footprint.wide, footprint.narrow)
        share = (upper - lower) / footprint.total
    return share
