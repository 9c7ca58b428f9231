"""Rays and what they hit, evaluated from the vertices, so that everything here is differentiable to them."""

import warp as wp


@wp.struct
class RayGrid:
    """Where the rays of one view start and which bins they fall into.

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
class Band:
    """Azimuth cells of a view's rays, from `first_cell` to the one before `end_cell`; `seed` places rays in cells."""

    first_cell: int
    end_cell: int
    seed: int


@wp.struct
class Triangles:
    """A mesh: `vertices` [m], and the three of each face, shape (faces, 3)."""

    vertices: wp.array(dtype=wp.vec3)
    faces: wp.array2d(dtype=int)


@wp.struct
class RayHit:
    distance: float
    b1: float
    b2: float
    normal: wp.vec3


@wp.struct
class PlaneRay:
    """A ray in the plane of d and v: where it starts along both [m], cosine and sine of its direction's angle to d."""

    along: float
    across: float
    cosine: float
    sine: float


@wp.func
def jitter_of(grid: RayGrid, seed: int, cell: int, k: int) -> wp.vec2:
    """Where in its cell a ray starts, (azimuth, elevation) from -0.5 to 0.5: a matter of the cell alone."""
    random = wp.rand_init(seed, cell * grid.elevation_cells + k)
    across = wp.randf(random) - 0.5
    return wp.vec2(across, wp.randf(random) - 0.5)


@wp.func
def azimuth_of(grid: RayGrid, cell: int, jitter: wp.vec2) -> float:
    return grid.azimuth_start + (float(cell) + 0.5) * grid.azimuth_step + jitter[0] * grid.azimuth_step


@wp.func
def elevation_of(grid: RayGrid, k: int, jitter: wp.vec2) -> float:
    return grid.elevation_start + (float(k) + 0.5 + jitter[1]) * grid.elevation_step


@wp.func
def plane_ray(grid: RayGrid, elevation: float) -> PlaneRay:
    ray = PlaneRay()
    ray.along = -grid.standoff
    ray.across = elevation
    ray.cosine = 1.0
    ray.sine = 0.0
    if grid.slant_range > 0.0:
        # Not on the track, where a distance of 10 km and more would leave no millimetres in float32. 1 - cos, too,
        # is written without its cancellation.
        half = wp.sin(0.5 * elevation)
        ray.cosine = wp.cos(elevation)
        ray.sine = wp.sin(elevation)
        ray.along = -2.0 * half * half * grid.slant_range - grid.standoff * ray.cosine
        ray.across = (grid.slant_range - grid.standoff) * ray.sine
    return ray


@wp.func
def direction_of(grid: RayGrid, ray: PlaneRay) -> wp.vec3:
    if grid.slant_range > 0.0:
        return ray.cosine * grid.d + ray.sine * grid.v
    return grid.d


@wp.func
def origin_of(grid: RayGrid, azimuth: float, ray: PlaneRay) -> wp.vec3:
    if grid.slant_range > 0.0:
        return azimuth * grid.u + ray.along * grid.d + ray.across * grid.v
    return azimuth * grid.u + ray.across * grid.v + ray.along * grid.d


@wp.func
def ray_direction(grid: RayGrid, elevation: float) -> wp.vec3:
    return direction_of(grid, plane_ray(grid, elevation))


@wp.func
def ray_origin(grid: RayGrid, azimuth: float, elevation: float) -> wp.vec3:
    return origin_of(grid, azimuth, plane_ray(grid, elevation))


@wp.func
def point_on(p0: wp.vec3, p1: wp.vec3, p2: wp.vec3, b1: float, b2: float) -> wp.vec3:
    """The point of a triangle with the barycentric weights `b1` and `b2` of its second and third corner."""
    return p0 + b1 * (p1 - p0) + b2 * (p2 - p0)


@wp.func
def normal_of(p0: wp.vec3, p1: wp.vec3, p2: wp.vec3) -> wp.vec3:
    return wp.normalize(wp.cross(p1 - p0, p2 - p0))


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
    hit.normal = normal_of(p0, p1, p2)
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
def elevation_step_at(grid: RayGrid, slant_range: float) -> float:
    """Length [m] of a cell in elevation, at a slant range about the reference point."""
    if grid.slant_range > 0.0:
        return (slant_range + grid.slant_range) * grid.elevation_step
    return grid.elevation_step


@wp.func
def look_direction(grid: RayGrid, point: wp.vec3) -> wp.vec3:
    """Direction of travel of the ray that reaches `point`."""
    if grid.slant_range > 0.0:
        return wp.normalize((grid.slant_range + wp.dot(point, grid.d)) * grid.d + wp.dot(point, grid.v) * grid.v)
    return grid.d


@wp.func
def cos_incidence_of(normal: wp.vec3, direction: wp.vec3) -> float:
    return wp.min(wp.abs(wp.dot(normal, direction)), 1.0)


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
    x = wp.vec3(-normal[1], normal[0], 0.0)  # the vertical x the normal
    if wp.length(x) < 1.0e-6:
        x = wp.vec3(1.0, 0.0, 0.0)
    along = direction - wp.dot(direction, normal) * normal
    if wp.length(along) < 1.0e-6:
        return 1.0
    c = wp.dot(wp.normalize(along), wp.normalize(x))
    return c * c
