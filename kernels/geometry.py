"""Rays and what they hit, evaluated from the vertices, so that everything here is differentiable to them."""

import warp as wp


@wp.struct
class RayGrid:
    """Where the rays of one view start and which bins they fall into (scene-format.md).

    Rays are cells of a regular (azimuth, elevation) grid, one jittered sample in each. In a plane wave the
    elevation coordinate is X . v [m]; in strip-map it is the angle about the track [rad].
    """

    d: wp.vec3
    u: wp.vec3
    v: wp.vec3
    slant_range: float  # R0 [m]; 0 for a plane wave
    standoff: float  # rays start this far [m] before the plane, or the arc about the track, of the reference point
    reach: float  # largest distance along a ray [m]
    azimuth_start: float  # [m], left edge of column 0
    azimuth_step: float  # [m]
    cells_per_column: int
    first_cell: int  # azimuth cells, in whole columns of the image, that can meet the mesh
    end_cell: int
    elevation_start: float
    elevation_step: float
    elevation_cells: int
    range_start: float  # [m] about the reference point, upper edge of row 0
    range_spacing: float  # [m]
    rows: int
    cols: int
    pixel_area: float  # [m2]


@wp.struct
class RayHit:
    distance: float
    b1: float
    b2: float
    normal: wp.vec3


@wp.func
def ray_direction(grid: RayGrid, elevation: float) -> wp.vec3:
    if grid.slant_range > 0.0:
        return wp.cos(elevation) * grid.d + wp.sin(elevation) * grid.v
    return grid.d


@wp.func
def ray_origin(grid: RayGrid, azimuth: float, elevation: float) -> wp.vec3:
    if grid.slant_range > 0.0:
        # Not on the track, where a distance of 10 km and more would leave no millimetres in float32. 1 - cos, too,
        # is written without its cancellation.
        s = wp.sin(0.5 * elevation)
        nearer = -2.0 * s * s * grid.slant_range - grid.standoff * wp.cos(elevation)
        higher = (grid.slant_range - grid.standoff) * wp.sin(elevation)
        return azimuth * grid.u + nearer * grid.d + higher * grid.v
    return azimuth * grid.u + elevation * grid.v - grid.standoff * grid.d


@wp.func
def intersect(origin: wp.vec3, direction: wp.vec3, p0: wp.vec3, p1: wp.vec3, p2: wp.vec3) -> RayHit:
    """Moeller-Trumbore (equations 20 to 22), for a triangle the BVH has already named."""
    e1 = p1 - p0
    e2 = p2 - p0
    q = wp.cross(direction, e2)
    inverse = 1.0 / wp.dot(e1, q)
    o = origin - p0
    w = wp.cross(o, e1)
    hit = RayHit()
    hit.b1 = wp.dot(o, q) * inverse
    hit.b2 = wp.dot(direction, w) * inverse
    hit.distance = wp.dot(e2, w) * inverse
    hit.normal = wp.normalize(wp.cross(e1, e2))
    return hit


@wp.func
def slant_range_of(grid: RayGrid, point: wp.vec3) -> float:
    """Slant range of a point about the reference point: X . d, or its distance from the track less R0."""
    along = wp.dot(point, grid.d)
    if grid.slant_range > 0.0:
        # R - R0 written without the difference of two large numbers
        across = wp.dot(point, grid.v)
        r = wp.sqrt((grid.slant_range + along) * (grid.slant_range + along) + across * across)
        return (2.0 * grid.slant_range * along + along * along + across * across) / (r + grid.slant_range)
    return along


@wp.func
def look_direction(grid: RayGrid, point: wp.vec3) -> wp.vec3:
    """Direction of travel of the ray that reaches `point`."""
    if grid.slant_range > 0.0:
        return wp.normalize((grid.slant_range + wp.dot(point, grid.d)) * grid.d + wp.dot(point, grid.v) * grid.v)
    return grid.d


@wp.func
def cos_twist_of(normal: wp.vec3, direction: wp.vec3, u: wp.vec3) -> float:
    """|cos psi| of the facet's horizontal about the line of sight: |u . (n x d)| / |n x d|; 1 at normal incidence."""
    across = wp.cross(normal, direction)
    length = wp.length(across)
    if length < 1.0e-6:
        return 1.0
    return wp.min(wp.abs(wp.dot(u, across)) / length, 1.0)


@wp.func
def cos2_azimuth_of(normal: wp.vec3, direction: wp.vec3) -> float:
    """Squared cosine between the look direction on the facet and the facet's x axis: horizontal, east on the flat."""
    x = wp.cross(wp.vec3(0.0, 0.0, 1.0), normal)
    if wp.length(x) < 1.0e-6:
        x = wp.vec3(1.0, 0.0, 0.0)
    along = direction - wp.dot(direction, normal) * normal
    if wp.length(along) < 1.0e-6:
        return 1.0
    c = wp.dot(wp.normalize(along), wp.normalize(x))
    return c * c
