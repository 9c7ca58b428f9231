"""Tables over incidence whose nodes are dense at both ends: where they lie, and how they are interpolated."""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.scattering import MIN_COS_INCIDENCE

SINGLE = wp.constant(384)  # nodes of single scattering, whose lobe about the normal may be narrow
DOUBLE = wp.constant(32)  # nodes of double scattering


@wp.func
def node_cosine(node: int, count: int):
    """cos(theta) of a node, kept off 0 and 1, where powers of it and of the sine are taken out."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    place = two * wp.float64(float(node)) / wp.float64(float(count - 1)) - one
    root = (place + wp.sqrt(two - place * place)) / two
    least = wp.float64(MIN_COS_INCIDENCE)
    return wp.clamp(root * root, least, one - least)


@wp.func
def stencil(cos_incidence: float, nodes: float):
    """The first of the four nodes about an incidence, and the cubic's weights of them: a vector of five."""
    cosine = wp.clamp(cos_incidence, MIN_COS_INCIDENCE, 1.0)
    at = 0.5 * (wp.sqrt(cosine) - wp.sqrt(1.0 - cosine) + 1.0) * (nodes - 1.0)
    low = wp.clamp(wp.floor(at) - 1.0, 0.0, nodes - 4.0)
    x = at - low - 1.0
    return wp.vector(
        low,
        x * (x - 1.0) * (2.0 - x) / 6.0,
        (x + 1.0) * (x - 1.0) * (x - 2.0) * 0.5,
        (x + 1.0) * x * (2.0 - x) * 0.5,
        (x + 1.0) * x * (x - 1.0) / 6.0,
    )


@wp.func
def interpolated(table: wp.array2d(dtype=wp.vec4), material: int, cos_incidence: float, nodes: int) -> wp.vec4:
    """A row of a table at an incidence."""
    found = stencil(cos_incidence, float(nodes))
    low = int(found[0])
    return (
        found[1] * table[material, low]
        + found[2] * table[material, low + 1]
        + found[3] * table[material, low + 2]
        + found[4] * table[material, low + 3]
    )


# In lanes the four nodes of a hit are read at once: they lie side by side.
lanes.by_hand(
    interpolated,
    """
[[gnu::always_inline]] static V4
interpolated(const wp::array_t<wp::vec_t<4, wp::float32>>& table, I material, V cosine, int nodes)
{
    typedef float Row __attribute__((ext_vector_type(4)));
    const V5 found = stencil(cosine, wp::float32(nodes));
    const I low = __builtin_convertvector(found.c[0], I);
    float share[5][LANES], sum[4][LANES];
    __builtin_memcpy(share, &found, sizeof(found));
    for (int k = 0; k < LANES; ++k) {
        Row r[4];
        __builtin_memcpy(r, table.data[material[k] * nodes + low[k]].c, sizeof(r));
        r[0] = share[1][k] * r[0] + share[2][k] * r[1] + share[3][k] * r[2] + share[4][k] * r[3];
        for (int j = 0; j < 4; ++j)
            sum[j][k] = r[0][j];
    }
    V4 result;
    __builtin_memcpy(&result, sum, sizeof(result));
    return result;
}
""",
    {stencil: ("nodes",)},
)
