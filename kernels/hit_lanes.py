"""Records to hits on the CPU, eight at once.

The steps are those of `trace.hit_kernel`, written out by kernels/lanes.py; only loads and stores are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.geometry import (
    RayGrid,
    cos2_azimuth_of,
    cos_incidence_of,
    cos_twist_of,
    look_direction,
    normal_of,
    point_on,
)

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
    const int n = pixel_out.shape[0], begin = 8 * block, count = wp::min(n - begin, 8);
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
    const V weight = __builtin_convertvector(sums[0] / wp::float64(quanta), V);
    const Lanes::V3 p0 = corner[0], p1 = corner[1], p2 = corner[2];
    const Lanes::V3 point = Lanes::point_on(p0, p1, p2, b1, b2), normal = Lanes::normal_of(p0, p1, p2);
    const Lanes::V3 direction = Lanes::look_direction(grid, point);
    const V incidence = Lanes::cos_incidence_of(normal, direction);
    const V twist = Lanes::cos_twist_of(normal, direction, grid.u);
    const V azimuth2 = Lanes::cos2_azimuth_of(normal, direction);
    for (int lane = 0; lane < count; ++lane) {
        const int i = begin + lane;
        pixel_out.data[i] = wp::int32(key.data[i] >> face_bits);
        face_out.data[i] = met[lane];
        barycentric_out.data[i] = {b1[lane], b2[lane]};
        weight_out.data[i] = weight[lane];
        point_out.data[i] = {point.c[0][lane], point.c[1][lane], point.c[2][lane]};
        cos_incidence_out.data[i] = incidence[lane];
        cos_twist_out.data[i] = twist[lane];
        cos2_azimuth_out.data[i] = azimuth2[lane];
    }
"""


@wp.func_native(_GEOMETRY + _HITS)
def hit_block(
    block: int,
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    rows: wp.array2d(dtype=wp.int64),
    quanta: float,
    key: wp.array(dtype=wp.int64),
    row: wp.array(dtype=int),
    face_bits: int,
    pixel_out: wp.array(dtype=int),
    face_out: wp.array(dtype=int),
    barycentric_out: wp.array(dtype=wp.vec2),
    weight_out: wp.array(dtype=float),
    point_out: wp.array(dtype=wp.vec3),
    cos_incidence_out: wp.array(dtype=float),
    cos_twist_out: wp.array(dtype=float),
    cos2_azimuth_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def hit_kernel(
    # In:
    grid: RayGrid,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    rows: wp.array2d(dtype=wp.int64),
    quanta: float,
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
    """`trace.hit_kernel`, LANES rows at once."""
    hit_block(
        wp.tid(),
        grid,
        vertices,
        faces,
        rows,
        quanta,
        key,
        row,
        face_bits,
        pixel_out,
        face_out,
        barycentric_out,
        weight_out,
        point_out,
        cos_incidence_out,
        cos_twist_out,
        cos2_azimuth_out,
    )
