"""Rays to records on the CPU, eight rays at once, one pixel column after the other.

The steps are those of kernels/trace.py, written out by kernels/lanes.py; loads, stores and loops are by hand. As
nothing else adds to a column of pixels, its records are found again through a table small enough for the nearest
cache: that of kernels/trace.py, for threads that share one, is another.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.deposit import footprint_of, row_at, share_in
from warpsar.kernels.geometry import (
    Band,
    RayGrid,
    Triangles,
    azimuth_of,
    direction_of,
    elevation_of,
    elevation_step_at,
    intersect,
    jitter_of,
    origin_of,
    plane_ray,
    point_on,
    slant_range_of,
)
from warpsar.kernels.trace import Records

# As in kernels/raster.py: no product is fused into a sum.
wp.set_module_options({"fuse_fp": False})

LANES = 8  # rays that are worked on at once


@wp.struct
class Jitters:
    """`geometry.jitter_of` every ray of a band, in the order of its faces."""

    across: wp.array(dtype=float)
    along: wp.array(dtype=float)


@wp.struct
class Chains:
    """A column's records by the hash of their keys: the first one of each slot, and the next one of each, or -1."""

    head: wp.array(dtype=int)  # of a power of two
    link: wp.array(dtype=int)


@wp.func_native(
    lanes.source(LANES, {jitter_of: None})
    + """
    const int first = i * grid.elevation_cells;
    for (int k = 0; k < grid.elevation_cells; ++k) {
        const wp::vec_t<2, wp::float32> jitter = Lanes::jitter_of(grid, band.seed, band.first_cell + i, k);
        jitters_out.across.data[first + k] = jitter.c[0];
        jitters_out.along.data[first + k] = jitter.c[1];
    }
"""
)
def jitter_cell(i: int, grid: RayGrid, band: Band, jitters_out: Jitters): ...


@wp.kernel(enable_backward=False)
def jitter_kernel(
    # In:
    grid: RayGrid,
    band: Band,
    # Out:
    jitters_out: Jitters,
):
    """The rays of one azimuth cell."""
    jitter_cell(wp.tid(), grid, band, jitters_out)


_GEOMETRY = lanes.source(
    LANES,
    {
        azimuth_of: ("grid", "cell"),
        elevation_of: ("grid",),
        plane_ray: ("grid",),
        origin_of: ("grid",),
        direction_of: ("grid",),
        intersect: (),
        point_on: (),
        slant_range_of: ("grid",),
        elevation_step_at: ("grid",),
        footprint_of: ("grid", "deposit"),
        row_at: ("grid",),
        share_in: ("grid",),
    },
)

_RECORD = """
    typedef Lanes::V V;
    const auto& vertices = mesh.vertices;
    const auto& faces = mesh.faces;
    const auto& rows = records_out.rows;
    const auto& head = chains_out.head;
    const auto& link = chains_out.link;
    const int first_cell = band.first_cell, face_bits = records_out.face_bits;
    const float quanta = records_out.quanta;
    const int column = first_cell / grid.cells_per_column + i;
    const wp::int64 capacity = rows.shape[0];
    const wp::uint32 mask = head.shape[0] - 1;
    for (wp::uint32 slot = 0; slot <= mask; ++slot)
        head.data[slot] = -1;

    const auto leave = [&](int row, int f, float weight, float moment1, float moment2) {
        const wp::int64 counted = wp::int64(weight * quanta);
        if (counted <= 0)
            return;
        const wp::int64 key = (wp::int64(row * grid.cols + column) << face_bits) + f;
        wp::uint32 slot = wp::uint32(row) * 0x9E3779B1u + wp::uint32(f) * 0x85EBCA77u;
        slot = (slot ^ (slot >> 15)) & mask;
        int at = head.data[slot];
        while (at >= 0 && rows.data[4 * wp::int64(at)] != key)
            at = link.data[at];
        if (at < 0) {
            at = records_out.count.data[1]++;
            if (at >= capacity)  // the host begins again with room for as many
                return;
            rows.data[4 * wp::int64(at)] = key;
            for (int j = 1; j < 4; ++j)
                rows.data[4 * wp::int64(at) + j] = 0;
            link.data[at] = head.data[slot];
            head.data[slot] = at;
        }
        rows.data[4 * wp::int64(at) + 1] += counted;
        rows.data[4 * wp::int64(at) + 2] += wp::int64(moment1 * quanta);
        rows.data[4 * wp::int64(at) + 3] += wp::int64(moment2 * quanta);
    };

    const int first = first_cell + i * grid.cells_per_column;
    for (int cell = first; cell < first + grid.cells_per_column; ++cell) {
        const int before = (cell - first_cell) * grid.elevation_cells;
        int run_row = -1, run_face = -1;
        float run_weight = 0.0f, run_moment1 = 0.0f, run_moment2 = 0.0f;
        const auto add = [&](int row, int f, float part, float b1, float b2) {
            if (row != run_row || f != run_face) {
                if (run_row >= 0)
                    leave(run_row, run_face, run_weight, run_moment1, run_moment2);
                run_row = row;
                run_face = f;
                run_weight = run_moment1 = run_moment2 = 0.0f;
            }
            run_weight += part;
            run_moment1 += part * b1;
            run_moment2 += part * b2;
        };
        // the next rays that meet something, side by side
        int count = 0, met[8];
        struct { Lanes::V2 jitter; Lanes::V3 corner[3]; Lanes::I number; } ray;
        float* lanes = reinterpret_cast<float*>(&ray);
        for (int k = 0; k < grid.elevation_cells; ++k) {
            const int f = face.data[before + k];
            const int next = face.data[before + wp::min(k + 8, grid.elevation_cells - 1)];
            const int later = face.data[before + wp::min(k + 16, grid.elevation_cells - 1)];
            if (later >= 0)
                __builtin_prefetch(faces.data + 3 * later);
            if (next >= 0)
                for (int j = 0; j < 3; ++j)
                    __builtin_prefetch(vertices.data + faces.data[3 * next + j]);
            if (f >= 0) {
                met[count] = f;
                lanes[count] = jitters.across.data[before + k];
                lanes[8 + count] = jitters.along.data[before + k];
                ray.number[count] = k;
                for (int j = 0; j < 3; ++j)
                    for (int axis = 0; axis < 3; ++axis)
                        lanes[16 + 24 * j + 8 * axis + count] = vertices.data[faces.data[3 * f + j]].c[axis];
                ++count;
            }
            if (!count || (count < 8 && k + 1 < grid.elevation_cells))
                continue;
            const V azimuth = Lanes::azimuth_of(grid, cell, ray.jitter);
            const Lanes::PlaneRays start = Lanes::plane_ray(grid, Lanes::elevation_of(grid, ray.number, ray.jitter));
            const Lanes::V3 origin = Lanes::origin_of(grid, azimuth, start);
            const Lanes::V3 direction = Lanes::direction_of(grid, start);
            const Lanes::V3 p0 = ray.corner[0], p1 = ray.corner[1], p2 = ray.corner[2];
            const Lanes::RayHits hit = Lanes::intersect(origin, direction, p0, p1, p2);
            const V b1 = hit.b1, b2 = hit.b2, cosine = Lanes::abs(Lanes::dot(hit.normal, direction));
            const V centre = Lanes::slant_range_of(grid, Lanes::point_on(p0, p1, p2, b1, b2));
            const V weight = grid.azimuth_step * Lanes::elevation_step_at(grid, centre) / (cosine * grid.pixel_area);
            const Lanes::Footprints footprint =
                Lanes::footprint_of(grid, deposit, centre, hit.normal, direction, p0, p1, p2, ray.jitter);
            // the rows that are met, and what falls into the first two
            const V lowest = Lanes::row_at(grid, footprint.low), highest = Lanes::row_at(grid, footprint.high);
            const V shares[2] = {
                Lanes::share_in(grid, footprint, lowest), Lanes::share_in(grid, footprint, lowest + 1.0f)};
            for (int lane = 0; lane < count; ++lane) {
                if (!(cosine[lane] > 1.0e-6f))
                    continue;
                const int first_row = wp::int32(lowest[lane]);
                const int last_row = wp::min(wp::int32(highest[lane]), grid.rows - 1);
                for (int row = wp::max(first_row, 0); row <= last_row; ++row) {
                    const int turn = row - first_row;
                    const float share = turn < 2 ? shares[turn][lane]
                                                 : Lanes::share_in(grid, footprint, V(wp::float32(row)))[lane];
                    if (share > 0.0f)
                        add(row, met[lane], share * weight[lane], b1[lane], b2[lane]);
                }
            }
            count = 0;
        }
        if (run_row >= 0)
            leave(run_row, run_face, run_weight, run_moment1, run_moment2);
    }
"""


@wp.func_native(_GEOMETRY + _RECORD)
def record_column(
    i: int,
    grid: RayGrid,
    mesh: Triangles,
    band: Band,
    face: wp.array(dtype=int),
    jitters: Jitters,
    deposit: int,
    chains_out: Chains,
    records_out: Records,
): ...


@wp.kernel(enable_backward=False)
def record_kernel(
    # In:
    grid: RayGrid,
    mesh: Triangles,
    band: Band,
    face: wp.array(dtype=int),
    jitters: Jitters,
    deposit: int,
    # Room, the next column's after this one's:
    chains: Chains,
    # In and out:
    records: Records,
):
    """One column of pixels. `records.count[1]` rows are taken, or so many as are sure to have room."""
    record_column(wp.tid(), grid, mesh, band, face, jitters, deposit, chains, records)
