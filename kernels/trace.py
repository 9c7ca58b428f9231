"""Rays through the BVH, binned into [range, azimuth] records of (pixel, face, weight)."""

import warp as wp

from warpsar.kernels.deposit import footprint_of, row_at, share_in
from warpsar.kernels.geometry import (
    Band,
    RayGrid,
    Triangles,
    azimuth_of,
    cos2_azimuth_of,
    cos_incidence_of,
    cos_twist_of,
    direction_of,
    elevation_of,
    elevation_step_at,
    intersect,
    jitter_of,
    look_direction,
    normal_of,
    origin_of,
    plane_ray,
    point_on,
    slant_range_of,
)
from warpsar.kernels.wide import WARP, least_of_warp

# Threads of a CUDA block; eight blocks to a multiprocessor are asked for where threads mostly wait for memory: with all
# the registers that the compiler would take, fewer of them were on their way.
BLOCK = 128

# Rows of a table that are looked at for a free one: with half of them taken, one key in 1e11 needs more.
PROBES = wp.constant(128)


@wp.struct
class Records:
    """What rays leave: rows of (key + 1, weight, moments of the barycentric weights of vertices 1 and 2); free: 0.

    The key is pixel * 2^face_bits + face; the lanes of a CPU add no 1 to it. Weights are counted in quanta, because a
    sum of integers is the same in any order: that of CUDA's threads, and that of the bands into which the rays are cut.
    """

    rows: wp.array2d(dtype=wp.int64)  # shape (capacity, 4): a row is one sector of CUDA's memory
    face_bits: int
    quanta: float  # per unit of weight, a power of two
    merge: int  # 1: a row for each key; 0: a row for each record
    count: wp.array(dtype=int)  # [0] records that found no row; [1] rows taken, where each record has its own


@wp.struct
class HitArrays:
    """The hits of a view, shape (n,) each; units and meaning are those of `warpsar.trace.hits.Hits`."""

    pixel: wp.array(dtype=int)
    face: wp.array(dtype=int)
    barycentric: wp.array(dtype=wp.vec2)
    weight: wp.array(dtype=float)
    point: wp.array(dtype=wp.vec3)
    cos_incidence: wp.array(dtype=float)
    cos_twist: wp.array(dtype=float)
    cos2_azimuth: wp.array(dtype=float)


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


@wp.kernel(enable_backward=False, launch_bounds=(BLOCK, 8))
def query_kernel(
    # In:
    grid: RayGrid,
    band: Band,
    tree: wp.uint64,
    tile_width: int,
    tile_height: int,
    # Out:
    face_out: wp.array(dtype=int),
):
    """The face that each ray of a band meets first, or -1: element (cell - band.first_cell) * elevation_cells + k.

    The third index counts the rays of a tile, so that the threads of a CUDA warp go the same way through the BVH.
    """
    i, j, lane = wp.tid()
    cell = band.first_cell + i * tile_width + lane % tile_width
    k = j * tile_height + lane // tile_width
    if cell < band.end_cell and k < grid.elevation_cells:
        jitter = jitter_of(grid, band.seed, cell, k)
        ray = plane_ray(grid, elevation_of(grid, k, jitter))
        origin = origin_of(grid, azimuth_of(grid, cell, jitter), ray)
        query = wp.mesh_query_ray(tree, origin, direction_of(grid, ray), grid.reach)
        face_out[(cell - band.first_cell) * grid.elevation_cells + k] = wp.where(query.result, query.face, -1)


@wp.kernel(enable_backward=False, launch_bounds=(BLOCK, 8))
def record_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    band: Band,
    face: wp.array(dtype=int),
    segment: int,
    deposit: int,
    # In and out:
    records: Records,
):
    """One thread walks `segment` cells of one azimuth cell's column; what stays in one (pixel, face) is one record."""
    j, i = wp.tid()
    cell = band.first_cell + i
    column = cell // grid.cells_per_column

    run_key = wp.int64(-1)
    run_weight = float(0.0)
    run_moment = wp.vec2(0.0, 0.0)
    for k in range(j * segment, wp.min((j + 1) * segment, grid.elevation_cells)):
        f = face[i * grid.elevation_cells + k]
        if f >= 0:
            jitter = jitter_of(grid, band.seed, cell, k)
            ray = plane_ray(grid, elevation_of(grid, k, jitter))
            origin = origin_of(grid, azimuth_of(grid, cell, jitter), ray)
            direction = direction_of(grid, ray)
            p0 = mesh.vertices[mesh.faces[f, 0]]
            p1 = mesh.vertices[mesh.faces[f, 1]]
            p2 = mesh.vertices[mesh.faces[f, 2]]
            hit = intersect(origin, direction, p0, p1, p2)
            cosine = wp.abs(wp.dot(hit.normal, direction))
            if cosine > 1.0e-6:
                centre = slant_range_of(grid, point_on(p0, p1, p2, hit.b1, hit.b2))
                weight = grid.azimuth_step * elevation_step_at(grid, centre) / (cosine * grid.pixel_area)
                footprint = footprint_of(grid, deposit, centre, hit.normal, direction, p0, p1, p2, jitter)
                first_row = wp.max(int(row_at(grid, footprint.low)), 0)
                last_row = wp.min(int(row_at(grid, footprint.high)), grid.rows - 1)
                for row in range(first_row, last_row + 1):
                    share = share_in(grid, footprint, float(row))
                    if share > 0.0:
                        key = (wp.int64(row * grid.cols + column) << wp.int64(records.face_bits)) + wp.int64(f)
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
    mesh: Triangles,
    records: Records,
    key: wp.array(dtype=wp.int64),
    row: wp.array(dtype=int),
    # Out:
    hits_out: HitArrays,
):
    """A row of the table becomes a hit: where it lies, and how its facet is turned to its own ray."""
    i = wp.tid()
    f = int(key[i] & ((wp.int64(1) << wp.int64(records.face_bits)) - wp.int64(1)))
    weight = wp.float64(records.rows[row[i], 1])
    b1 = float(wp.float64(records.rows[row[i], 2]) / weight)
    b2 = float(wp.float64(records.rows[row[i], 3]) / weight)
    p0 = mesh.vertices[mesh.faces[f, 0]]
    p1 = mesh.vertices[mesh.faces[f, 1]]
    p2 = mesh.vertices[mesh.faces[f, 2]]
    point = point_on(p0, p1, p2, b1, b2)
    normal = normal_of(p0, p1, p2)
    direction = look_direction(grid, point)
    hits_out.pixel[i] = int(key[i] >> wp.int64(records.face_bits))
    hits_out.face[i] = f
    hits_out.barycentric[i] = wp.vec2(b1, b2)
    hits_out.weight[i] = float(weight / wp.float64(records.quanta))
    hits_out.point[i] = point
    hits_out.cos_incidence[i] = cos_incidence_of(normal, direction)
    hits_out.cos_twist[i] = cos_twist_of(normal, direction, grid.u)
    hits_out.cos2_azimuth[i] = cos2_azimuth_of(normal, direction)


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
