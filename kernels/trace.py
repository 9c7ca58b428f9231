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
from warpsar.kernels.wide import WARP, least_of_warp

NEAREST = wp.constant(0)
LINEAR = wp.constant(1)
FOOTPRINT = wp.constant(2)


# Threads of a CUDA block; eight blocks to a multiprocessor are asked for where threads mostly wait for memory: with all
# the registers that the compiler would take, fewer of them were on their way.
BLOCK = 128

# Rows of a table that are looked at for a free one: with half of them taken, one key in 1e11 needs more.
PROBES = wp.constant(128)


@wp.struct
class Records:
    """What rays leave: rows of (key + 1, weight, moments of the barycentric weights of vertices 1 and 2); free: 0.

    The key is pixel * 2^face_bits + face. Weights are counted in quanta, because a sum of integers is the same in any
    order: that of CUDA's threads, and that of the bands into which the rays are cut.
    """

    rows: wp.array2d(dtype=wp.int64)  # shape (capacity, 4): a row is one sector of CUDA's memory
    quanta: float  # per unit of weight, a power of two
    merge: int  # 1: a row for each key; 0: a row for each record
    count: wp.array(dtype=int)  # [0] records that found no row; [1] rows taken, where each record has its own


@wp.func
def row_of(rows: wp.array2d(dtype=wp.int64), key: wp.int64) -> int:
    """The key's row, taken now if it is new, by open addressing from murmur3's finaliser; -1 where none is free."""
    mixed = wp.uint64(key)
    mixed = (mixed ^ (mixed >> wp.uint64(33))) * wp.uint64(0xFF51AFD7ED558CCD)
    mixed = (mixed ^ (mixed >> wp.uint64(33))) * wp.uint64(0xC4CEB9FE1A85EC53)
    row = int(((mixed >> wp.uint64(32)) * wp.uint64(rows.shape[0])) >> wp.uint64(32))
    for _ in range(PROBES):
        owner = rows[row, 0]
        if owner == wp.int64(0):
            owner = wp.atomic_cas(rows, row, 0, wp.int64(0), key + wp.int64(1))
            if owner == wp.int64(0):
                return row
        if owner == key + wp.int64(1):
            return row
        row += 1
        if row == rows.shape[0]:
            row = 0
    return -1


@wp.func
def leave(records: Records, key: wp.int64, weight: float, moment: wp.vec2):
    quanta = wp.int64(weight * records.quanta)
    if quanta > wp.int64(0):
        row = int(-1)
        if records.merge != 0:
            row = row_of(records.rows, key)
        else:
            taken = wp.atomic_add(records.count, 1, 1)
            if taken < records.rows.shape[0]:
                row = taken
                records.rows[row, 0] = key + wp.int64(1)
        if row >= 0:
            wp.atomic_add(records.rows, row, 1, quanta)
            wp.atomic_add(records.rows, row, 2, wp.int64(moment[0] * records.quanta))
            wp.atomic_add(records.rows, row, 3, wp.int64(moment[1] * records.quanta))
        else:
            wp.atomic_add(records.count, 0, 1)


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


@wp.kernel(enable_backward=False, launch_bounds=(BLOCK, 8))
def query_kernel(
    # In:
    grid: RayGrid,
    mesh: wp.uint64,
    first_cell: int,
    end_cell: int,
    tile_width: int,
    tile_height: int,
    seed: int,
    # Out:
    face_out: wp.array(dtype=int),
):
    """The face that each ray of a band meets first, or -1: element (cell - first_cell) * elevation_cells + k.

    The third index counts the rays of a tile, so that the threads of a CUDA warp go the same way through the BVH.
    """
    i, j, lane = wp.tid()
    cell = first_cell + i * tile_width + lane % tile_width
    k = j * tile_height + lane // tile_width
    if cell < end_cell and k < grid.elevation_cells:
        jitter = jitter_of(grid, seed, cell, k)
        elevation = elevation_of(grid, k, jitter)
        origin = ray_origin(grid, azimuth_of(grid, cell, jitter), elevation)
        query = wp.mesh_query_ray(mesh, origin, ray_direction(grid, elevation), grid.reach)
        face_out[(cell - first_cell) * grid.elevation_cells + k] = wp.where(query.result, query.face, -1)


@wp.kernel(enable_backward=False, launch_bounds=(BLOCK, 8))
def record_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    first_cell: int,
    segment: int,
    seed: int,
    deposit: int,
    face_bits: int,
    # Out:
    records: Records,
):
    """One thread walks `segment` cells of one azimuth cell's column; what stays in one (pixel, face) is one record."""
    j, i = wp.tid()
    cell = first_cell + i
    column = cell // grid.cells_per_column

    run_key = wp.int64(-1)
    run_weight = float(0.0)
    run_moment = wp.vec2(0.0, 0.0)
    for k in range(j * segment, wp.min((j + 1) * segment, grid.elevation_cells)):
        f = face[i * grid.elevation_cells + k]
        if f >= 0:
            jitter = jitter_of(grid, seed, cell, k)
            elevation = elevation_of(grid, k, jitter)
            origin = ray_origin(grid, azimuth_of(grid, cell, jitter), elevation)
            direction = ray_direction(grid, elevation)
            p0 = vertices[faces[f, 0]]
            p1 = vertices[faces[f, 1]]
            p2 = vertices[faces[f, 2]]
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
                    middle = centre - per_u * jitter[0] - per_v * jitter[1]
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
                        key = (wp.int64(row * grid.cols + column) << wp.int64(face_bits)) + wp.int64(f)
                        if key != run_key or records.merge == 0:
                            if run_key >= wp.int64(0):
                                leave(records, run_key, run_weight, run_moment)
                            run_key = key
                            run_weight = 0.0
                            run_moment = wp.vec2(0.0, 0.0)
                        run_weight += share * weight
                        run_moment += share * weight * wp.vec2(hit.b1, hit.b2)
    if run_key >= wp.int64(0):
        leave(records, run_key, run_weight, run_moment)


@wp.kernel(enable_backward=False)
def hit_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    records: Records,
    key: wp.array(dtype=wp.int64),
    row: wp.array(dtype=int),
    face_bits: int,
    # Out:
    pixel_out: wp.array(dtype=int),
    face_out: wp.array(dtype=int),
    barycentric_out: wp.array(dtype=wp.vec2),
    weight_out: wp.array(dtype=float),
    point_out: wp.array(dtype=wp.vec3),
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
):
    """A row of the table becomes a hit: where it lies, and how its facet is turned to its own ray."""
    i = wp.tid()
    f = int(key[i] & ((wp.int64(1) << wp.int64(face_bits)) - wp.int64(1)))
    weight = wp.float64(records.rows[row[i], 1])
    b1 = float(wp.float64(records.rows[row[i], 2]) / weight)
    b2 = float(wp.float64(records.rows[row[i], 3]) / weight)
    p0 = vertices[faces[f, 0]]
    p1 = vertices[faces[f, 1]]
    p2 = vertices[faces[f, 2]]
    point = p0 + b1 * (p1 - p0) + b2 * (p2 - p0)
    normal = wp.normalize(wp.cross(p1 - p0, p2 - p0))
    direction = look_direction(grid, point)
    pixel_out[i] = int(key[i] >> wp.int64(face_bits))
    face_out[i] = f
    barycentric_out[i] = wp.vec2(b1, b2)
    weight_out[i] = float(weight / wp.float64(records.quanta))
    point_out[i] = point
    cos_incidence_out[i] = wp.min(wp.abs(wp.dot(normal, direction)), 1.0)
    cos_twist_out[i] = cos_twist_of(normal, direction, grid.u)
    cos2_azimuth_out[i] = cos2_azimuth_of(normal, direction)


@wp.kernel(enable_backward=False)
def extent_kernel(
    # In:
    vertices: wp.array(dtype=wp.vec3d),
    d: wp.vec3d,
    u: wp.vec3d,
    v: wp.vec3d,
    slant_range: wp.float64,
    threads: int,
    # Out:
    ends_out: wp.array2d(dtype=wp.float64),
):
    """Ends of the mesh, a row for each warp of CUDA's: along range and azimuth, in elevation (an angle about the track
    at `slant_range`, where that is not 0), and in distance from the track. The least, then the least of the negative.
    """
    t = wp.tid()
    low = wp.vec4d(wp.float64(1.0e300))
    high = -low
    for i in range(t, vertices.shape[0], threads):
        along = wp.dot(vertices[i], d)
        across = wp.dot(vertices[i], v)
        ends = wp.vec4d(along, wp.dot(vertices[i], u), across, wp.float64(0.0))
        if slant_range > wp.float64(0.0):
            r = slant_range + along
            ends = wp.vec4d(along, ends[1], wp.atan2(across, r), wp.sqrt(r * r + across * across))
        low = wp.min(low, ends)
        high = wp.max(high, ends)
    low = least_of_warp(low)
    high = least_of_warp(-high)
    if t % WARP == 0:
        for k in range(4):
            ends_out[t // WARP, k] = low[k]
            ends_out[t // WARP, 4 + k] = high[k]
