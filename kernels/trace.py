"""Rays through the BVH, binned into [range, azimuth] records of (pixel, face, weight)."""

import warp as wp

from warpsar.kernels.geometry import (
    RayGrid,
    cos2_azimuth_of,
    cos_twist_of,
    intersect,
    look_direction,
    ray_direction,
    ray_origin,
    slant_range_of,
)

NEAREST = wp.constant(0)
LINEAR = wp.constant(1)
FOOTPRINT = wp.constant(2)


@wp.struct
class Records:
    """What the rays of a band leave: appended in any order, `count` may exceed the arrays' length (then: again)."""

    key: wp.array(dtype=wp.int64)  # pixel * 2^face_bits + face
    weight: wp.array(dtype=float)  # dA_perp / cos(theta) / pixel area
    moment: wp.array(dtype=wp.vec2)  # weight * barycentric weights of vertices 1 and 2
    count: wp.array(dtype=int)


@wp.func
def append(records: Records, key: wp.int64, weight: float, moment: wp.vec2):
    slot = wp.atomic_add(records.count, 0, 1)
    if slot < records.key.shape[0]:
        records.key[slot] = key
        records.weight[slot] = weight
        records.moment[slot] = moment


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


@wp.kernel(enable_backward=False)
def trace_kernel(
    # In:
    grid: RayGrid,
    mesh: wp.uint64,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    first_cell: int,
    segment: int,
    seed: int,
    deposit: int,
    face_bits: int,
    merge: int,
    # Out:
    records: Records,
):
    """One thread walks `segment` cells of one azimuth cell's column; what stays in one (pixel, face) is one record."""
    i, j = wp.tid()
    cell = first_cell + i
    column = cell // grid.cells_per_column
    centre_u = grid.azimuth_start + (float(cell) + 0.5) * grid.azimuth_step

    run_key = wp.int64(-1)
    run_weight = float(0.0)
    run_moment = wp.vec2(0.0, 0.0)
    last = wp.min((j + 1) * segment, grid.elevation_cells)
    for k in range(j * segment, last):
        random = wp.rand_init(seed, cell * grid.elevation_cells + k)
        jitter_u = wp.randf(random) - 0.5
        jitter_v = wp.randf(random) - 0.5
        azimuth = centre_u + jitter_u * grid.azimuth_step
        elevation = grid.elevation_start + (float(k) + 0.5 + jitter_v) * grid.elevation_step
        origin = ray_origin(grid, azimuth, elevation)
        direction = ray_direction(grid, elevation)
        query = wp.mesh_query_ray(mesh, origin, direction, grid.reach)
        if query.result:
            p0 = vertices[faces[query.face, 0]]
            p1 = vertices[faces[query.face, 1]]
            p2 = vertices[faces[query.face, 2]]
            hit = intersect(origin, direction, p0, p1, p2)
            slope = wp.dot(hit.normal, direction)
            cosine = wp.abs(slope)
            if cosine > 1.0e-6:
                point = p0 + hit.b1 * (p1 - p0) + hit.b2 * (p2 - p0)
                centre = slant_range_of(grid, point)
                across = grid.elevation_step
                if grid.slant_range > 0.0:
                    across = (centre + grid.slant_range) * grid.elevation_step
                weight = grid.azimuth_step * across / (cosine * grid.pixel_area)
                # where the ray's power falls in range: two boxes convolved, cut to [low, high]
                middle = centre
                wide = float(0.0)
                narrow = float(0.0)
                low = float(-1.0e30)
                high = float(1.0e30)
                if deposit == LINEAR:
                    wide = grid.range_spacing
                if deposit == FOOTPRINT:
                    # The cell's own extent in range on the facet's plane: the sample's jitter drops out of it.
                    per_u = -wp.dot(hit.normal, grid.u) / slope * grid.azimuth_step
                    per_v = -wp.dot(hit.normal, wp.cross(grid.u, direction)) / slope * across
                    r0 = slant_range_of(grid, p0)
                    r1 = slant_range_of(grid, p1)
                    r2 = slant_range_of(grid, p2)
                    middle = centre - per_u * jitter_u - per_v * jitter_v
                    wide = wp.max(wp.abs(per_u), wp.abs(per_v))
                    narrow = wp.min(wp.abs(per_u), wp.abs(per_v))
                    low = wp.min(wp.min(r0, centre), wp.min(r1, r2))
                    high = wp.max(wp.max(r0, centre), wp.max(r1, r2))
                half = 0.5 * (wide + narrow)
                low = wp.max(low, middle - half)
                high = wp.min(high, middle + half)
                share_low = share_before(low - middle, wide, narrow)
                total = share_before(high - middle, wide, narrow) - share_low
                if wide < 1.0e-5 * grid.range_spacing or total < 1.0e-4:
                    low = centre
                    high = centre
                # rows the interval covers, and the share of each
                first_row = wp.max(int(wp.floor((low - grid.range_start) / grid.range_spacing)), 0)
                last_row = wp.min(int(wp.floor((high - grid.range_start) / grid.range_spacing)), grid.rows - 1)
                for row in range(first_row, last_row + 1):
                    share = float(1.0)
                    if high > low:
                        edge = grid.range_start + float(row) * grid.range_spacing
                        upper = share_before(wp.min(high, edge + grid.range_spacing) - middle, wide, narrow)
                        lower = share_before(wp.max(low, edge) - middle, wide, narrow)
                        share = (upper - lower) / total
                    if share > 0.0:
                        key = (wp.int64(row * grid.cols + column) << wp.int64(face_bits)) + wp.int64(query.face)
                        if key != run_key or merge == 0:
                            if run_key >= wp.int64(0):
                                append(records, run_key, run_weight, run_moment)
                            run_key = key
                            run_weight = 0.0
                            run_moment = wp.vec2(0.0, 0.0)
                        run_weight += share * weight
                        run_moment += share * weight * wp.vec2(hit.b1, hit.b2)
    if run_key >= wp.int64(0):
        append(records, run_key, run_weight, run_moment)


@wp.kernel(enable_backward=False)
def hit_geometry_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec2),
    # Out:
    point_out: wp.array(dtype=wp.vec3),
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
):
    """Where a (merged) hit lies and how its facet is turned to its own ray."""
    i = wp.tid()
    f = face[i]
    p0 = vertices[faces[f, 0]]
    p1 = vertices[faces[f, 1]]
    p2 = vertices[faces[f, 2]]
    b = barycentric[i]
    point = p0 + b[0] * (p1 - p0) + b[1] * (p2 - p0)
    normal = wp.normalize(wp.cross(p1 - p0, p2 - p0))
    direction = look_direction(grid, point)
    point_out[i] = point
    cos_incidence_out[i] = wp.min(wp.abs(wp.dot(normal, direction)), 1.0)
    cos_twist_out[i] = cos_twist_of(normal, direction, grid.u)
    cos2_azimuth_out[i] = cos2_azimuth_of(normal, direction)
