"""Records to hits on the CPU, eight at once.

The steps are those of `trace.hit_kernel`, written out by kernels/lanes.py; only loads and stores are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.geometry import (
    RayGrid,
    Triangles,
    cos2_azimuth_of,
    cos_incidence_of,
    cos_twist_of,
    look_direction,
    normal_of,
    point_on,
)
from warpsar.kernels.trace import HitArrays, Records

# As in kernels/raster.py: no product is fused into a sum.
wp.set_module_options({"fuse_fp": False})

LANES = 8  # hits that are worked on at once

_GEOMETRY = lanes.source(
    LANES,
    {
        point_on: (),
        normal_of: (),
        look_direction: ("grid",),
        cos_incidence_of: (),
        cos_twist_of: ("u",),
        cos2_azimuth_of: (),
    },
)

_HITS = """
    typedef Lanes::V V;
    typedef double D __attribute__((ext_vector_type(8)));
    const auto& vertices = mesh.vertices;
    const auto& faces = mesh.faces;
    const auto& rows = records.rows;
    const int face_bits = records.face_bits;
    const int n = key.shape[0], begin = 8 * block, count = wp::min(n - begin, 8);
    const wp::int64 mask = (wp::int64(1) << face_bits) - 1;
    int met[8];
    D sums[3];
    Lanes::V3 corner[3];
    float* lanes = reinterpret_cast<float*>(corner);
    for (int lane = 0; lane < 8; ++lane) {
        const int i = begin + wp::min(lane, count - 1), next = wp::min(i + 16, n - 1), later = wp::min(i + 32, n - 1);
        __builtin_prefetch(rows.data + 4 * wp::int64(row.data[later]));
        __builtin_prefetch(faces.data + 3 * (key.data[later] & mask));
        for (int j = 0; j < 3; ++j)
            __builtin_prefetch(vertices.data + faces.data[3 * (key.data[next] & mask) + j]);
        met[lane] = wp::int32(key.data[i] & mask);
        for (int j = 0; j < 3; ++j) {
            sums[j][lane] = wp::float64(rows.data[4 * wp::int64(row.data[i]) + 1 + j]);
            for (int axis = 0; axis < 3; ++axis)
                lanes[24 * j + 8 * axis + lane] = vertices.data[faces.data[3 * met[lane] + j]].c[axis];
        }
    }
    const V b1 = __builtin_convertvector(sums[1] / sums[0], V), b2 = __builtin_convertvector(sums[2] / sums[0], V);
    const V weight = __builtin_convertvector(sums[0] / wp::float64(records.quanta), V);
    const Lanes::V3 p0 = corner[0], p1 = corner[1], p2 = corner[2];
    const Lanes::V3 point = Lanes::point_on(p0, p1, p2, b1, b2), normal = Lanes::normal_of(p0, p1, p2);
    const Lanes::V3 direction = Lanes::look_direction(grid, point);
    const V incidence = Lanes::cos_incidence_of(normal, direction);
    const V twist = Lanes::cos_twist_of(normal, direction, grid.u);
    const V azimuth2 = Lanes::cos2_azimuth_of(normal, direction);
    for (int lane = 0; lane < count; ++lane) {
        const int i = begin + lane;
        hits_out.pixel.data[i] = wp::int32(key.data[i] >> face_bits);
        hits_out.face.data[i] = met[lane];
        hits_out.barycentric.data[i] = {b1[lane], b2[lane]};
        hits_out.weight.data[i] = weight[lane];
        hits_out.point.data[i] = {point.c[0][lane], point.c[1][lane], point.c[2][lane]};
        hits_out.cos_incidence.data[i] = incidence[lane];
        hits_out.cos_twist.data[i] = twist[lane];
        hits_out.cos2_azimuth.data[i] = azimuth2[lane];
    }
"""


@wp.func_native(_GEOMETRY + _HITS)
def hit_block(
    block: int,
    grid: RayGrid,
    mesh: Triangles,
    records: Records,
    key: wp.array(dtype=wp.int64),
    row: wp.array(dtype=int),
    hits_out: HitArrays,
): ...


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
    """`trace.hit_kernel`, LANES rows at once."""
    hit_block(wp.tid(), grid, mesh, records, key, row, hits_out)
