"""Look-ups of nodes on the CPU that ask for memory ahead."""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.codes import Layout
from warpsar.kernels.shade import NodeMap, OnMesh


@wp.func_native(
    lanes.enum(Layout)
    + """
    const int f = hits.face.data[i], ahead = hits.face.data[wp::min(i + 24, zeta_out.shape[0] - 1)];
    __builtin_prefetch(node_map.faces.data + 3 * ahead);
    __builtin_prefetch(node_map.face_material.data + ahead);
    const int* corner = node_map.faces.data + 3 * f;
    const wp::vec_t<4, wp::int32>* place = node_map.places.data + 4 * node_map.face_material.data[f];
    const float b1 = hits.barycentric.data[i].c[0], b2 = hits.barycentric.data[i].c[1], b0 = 1.0f - b1 - b2;
    for (int kind = 0; kind < 4; ++kind) {
        const float* node = nodes.data + place[kind].c[1];
        zeta_out.data[i].c[kind] = place[kind].c[0] == VERTEX
            ? b0 * node[corner[0]] + b1 * node[corner[1]] + b2 * node[corner[2]]
            : node[0];
    }
"""
)
def gather(
    i: int, hits: OnMesh, node_map: NodeMap, nodes: wp.array(dtype=float), zeta_out: wp.array(dtype=wp.vec4)
): ...


@wp.kernel(enable_backward=False)
def gather_kernel(
    # In:
    hits: OnMesh,
    node_map: NodeMap,
    nodes: wp.array(dtype=float),
    # Out:
    zeta_out: wp.array(dtype=wp.vec4),
):
    """`shade.gather_kernel` where no parameter is a texture."""
    gather(wp.tid(), hits, node_map, nodes, zeta_out)


@wp.func_native(
    """
    const int s_end = s + 1 < first.shape[0] ? first.data[s + 1] : part.shape[0], last = part.shape[0] - 1;
    float total[4] = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int i = first.data[s]; i < s_end; ++i) {
        __builtin_prefetch(zeta_gradient.data + (part.data[wp::min(i + 24, last)] >> 32));
        const wp::uint32 bits = wp::uint32(part.data[i]);
        float share;
        __builtin_memcpy(&share, &bits, sizeof(share));
        for (int kind = 0; kind < 4; ++kind)
            total[kind] += share * zeta_gradient.data[part.data[i] >> 32].c[kind];
    }
    for (int kind = 0; kind < 4; ++kind)
        if (target.data[s].c[kind] >= 0)
            nodes_gradient_out.data[target.data[s].c[kind]] += total[kind];
"""
)
def spread(
    s: int,
    first: wp.array(dtype=int),
    target: wp.array(dtype=wp.vec4i),
    part: wp.array(dtype=wp.int64),
    zeta_gradient: wp.array(dtype=wp.vec4),
    nodes_gradient_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def spread_kernel(
    # In:
    first: wp.array(dtype=int),
    target: wp.array(dtype=wp.vec4i),
    part: wp.array(dtype=wp.int64),
    zeta_gradient: wp.array(dtype=wp.vec4),
    # Out:
    nodes_gradient_out: wp.array(dtype=float),
):
    """`shade.spread_kernel`: what is read at random is asked for some turns before."""
    spread(wp.tid(), first, target, part, zeta_gradient, nodes_gradient_out)
