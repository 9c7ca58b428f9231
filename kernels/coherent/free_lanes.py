"""Which points the radar sees, on the CPU eight at once.

Neighbouring points look for shadows along much the same ray. So eight of them go down the tree of the mesh together,
and meet boxes and triangles in vectors. The tests are those of Warp's `mesh_query_ray_anyhit`: slabs, and Woop,
Benthin, Wald (JCGT 2(1), 2013). Where a triangle's edge is met to the last bit, Warp's own test decides.
"""

import warp as wp

from warpsar.kernels.coherent.tubes import TubeMesh, TubeRadar

LANES = 8  # points that are worked on at once

_FREE = """
    typedef float F __attribute__((ext_vector_type(8)));
    typedef int I __attribute__((ext_vector_type(8)));
    const auto any = [](I mask) -> bool { return __builtin_reduce_or(mask) != 0; };
    // a b - c d
    const auto difference = [](F a, F b, F c, F d) -> F {
        const F cd = c * d;
        return __builtin_elementwise_fma(a, b, -cd) + __builtin_elementwise_fma(-c, d, cd);
    };
    const wp::Mesh& mesh = *(const wp::Mesh*)body.tree;
    const wp::BVH& tree = mesh.bvh;
    const int begin = 8 * block, count = wp::min(points.shape[0] - begin, 8);
    F start[3], along[3], inverse[3], reach;
    wp::vec3 start_of[8], along_of[8];
    int axis = 0;
    bool alike = true;
    for (int lane = 0; lane < 8; ++lane) {
        const int i = begin + wp::min(lane, count - 1);
        const auto point = wp::index(points, i);
        auto s = radar.s;
        double way = body.reach;
        if (radar.near) {
            s = radar.place - point;
            const double distance = wp::length(s);
            s = s / distance;
            way = wp::min(distance, way);
        }
        const auto normal = wp::index(normals, i);
        const double side = both_sides && wp::dot(normal, s) < 0.0 ? -body.offset : body.offset;
        reach[lane] = (float)way;
        for (int c = 0; c < 3; ++c) {
            start_of[lane].c[c] = (float)(point.c[c] + side * normal.c[c]);
            along_of[lane].c[c] = (float)s.c[c];
            start[c][lane] = start_of[lane].c[c];
            along[c][lane] = along_of[lane].c[c];
            inverse[c][lane] = 1.0f / (along_of[lane].c[c] == 0.0f ? 1.0e-20f : along_of[lane].c[c]);
        }
        const int largest = wp::max_dim(along_of[lane]);
        if (lane == 0) axis = largest;
        alike &= largest == axis && (along[axis][lane] < 0.0f) == (along[axis][0] < 0.0f);
    }
    const bool backward = along[axis][0] < 0.0f;
    const int x = (axis + (backward ? 2 : 1)) % 3, y = (axis + (backward ? 1 : 2)) % 3;
    const F shear_x = along[x] / along[axis], shear_y = along[y] / along[axis], scale = 1.0f / along[axis];

    I open = I{} - 1;
    struct Waiting { int node; I lanes; } stack[2 * BVH_QUERY_STACK_SIZE];
    int waiting = 0;
    stack[waiting++] = {*tree.root, open};
    while (waiting) {
        const Waiting now = stack[--waiting];
        const I lanes = now.lanes & open;
        if (!any(lanes)) continue;
        const auto& lower = tree.node_lowers[now.node];
        const auto& upper = tree.node_uppers[now.node];
        if (lower.b) {
            for (int at = lower.i; at < (int)upper.i; ++at) {
                const int* corner = mesh.indices.data + 3 * tree.primitive_indices[at];
                const wp::vec3 p = mesh.points.data[corner[0]];
                const wp::vec3 q = mesh.points.data[corner[1]];
                const wp::vec3 r = mesh.points.data[corner[2]];
                const F pz = p.c[axis] - start[axis], qz = q.c[axis] - start[axis], rz = r.c[axis] - start[axis];
                const F px = p.c[x] - start[x] - shear_x * pz, py = p.c[y] - start[y] - shear_y * pz;
                const F qx = q.c[x] - start[x] - shear_x * qz, qy = q.c[y] - start[y] - shear_y * qz;
                const F rx = r.c[x] - start[x] - shear_x * rz, ry = r.c[y] - start[y] - shear_y * rz;
                const F u = difference(rx, qy, ry, qx), v = difference(px, ry, py, rx), w = difference(qx, py, qy, px);
                if (!alike || any(lanes & ((u == 0.0f) | (v == 0.0f) | (w == 0.0f)))) {
                    for (int lane = 0; lane < 8; ++lane) {
                        float t, b1, b2, sign;
                        if (lanes[lane] && wp::intersect_ray_tri_woop(
                                start_of[lane], along_of[lane], p, q, r, t, b1, b2, sign, (wp::vec3*)nullptr))
                            if (t >= 0.0f && t < reach[lane]) open[lane] = 0;
                    }
                    continue;
                }
                const I positive = (u > 0.0f) & (v > 0.0f) & (w > 0.0f);
                const I negative = (u < 0.0f) & (v < 0.0f) & (w < 0.0f);
                const F t = scale * (u * pz + v * qz + w * rz) / (u + v + w);
                open &= ~(lanes & (positive | negative) & (t >= 0.0f) & (t < reach));
            }
            if (!any(open)) break;
            continue;
        }
        const int children[2] = {(int)lower.i, (int)upper.i};
        for (int k = 0; k < 2; ++k) {
            const auto& low = tree.node_lowers[children[k]];
            const auto& high = tree.node_uppers[children[k]];
            const float lows[3] = {low.x, low.y, low.z}, highs[3] = {high.x, high.y, high.z};
            F enter = F{} - __builtin_inff(), leave = F{} + __builtin_inff();
            for (int c = 0; c < 3; ++c) {
                const F a = (lows[c] - start[c]) * inverse[c], b = (highs[c] - start[c]) * inverse[c];
                enter = __builtin_elementwise_max(enter, __builtin_elementwise_min(a, b));
                leave = __builtin_elementwise_min(leave, __builtin_elementwise_max(a, b));
            }
            const I inside = lanes & (leave >= 0.0f) & (leave >= enter) & (enter < reach);
            if (any(inside) && waiting < 2 * BVH_QUERY_STACK_SIZE) stack[waiting++] = {children[k], inside};
        }
    }
    for (int lane = 0; lane < count; ++lane) seen_out.data[begin + lane] = open[lane] ? 1 : 0;
"""


@wp.func_native(_FREE)
def free_block(
    block: int,
    body: TubeMesh,
    radar: TubeRadar,
    points: wp.array[wp.vec3d],
    normals: wp.array[wp.vec3d],
    both_sides: int,
    seen_out: wp.array[wp.uint8],
): ...


@wp.kernel(enable_backward=False)
def free_kernel(
    # In:
    body: TubeMesh,
    radar_in: wp.array[TubeRadar],
    point_in: wp.array[wp.vec3d],
    normal_in: wp.array[wp.vec3d],
    both_sides: int,
    # Out:
    seen_out: wp.array2d[wp.uint8],
):
    """`tubes.free_kernel`, LANES points at once: a thread to a view and a block."""
    view, block = wp.tid()
    free_block(block, body, radar_in[view], point_in, normal_in, both_sides, seen_out[view])
