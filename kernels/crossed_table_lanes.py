"""`crossed_table.scatter_kernel` on the CPU: sixteen hits at once.

The equations are those of kernels/crossed_table.py, written out by kernels/lanes.py; loads and stores are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.crossed_table import crossed_sigma0, stencil

HITS = 16  # of a block

_TABLE = lanes.source(HITS, {stencil: ("nodes",), crossed_sigma0: ()})

_SCATTER = """
    typedef Lanes::V V;
    typedef float Row __attribute__((ext_vector_type(4)));
    // the block's hits side by side; beyond the last one, its copies
    const int begin = block * 16, count = wp::min(mine.shape[0] - begin, 16);
    const int wanted = slopes_out.shape[0] ? 4 : 1;
    int at[16], material[16];
    V cosine, twist;
    for (int k = 0; k < 16; ++k) {
        const int i = at[k] = mine.data[begin + wp::min(k, count - 1)];
        material[k] = face_material.data[face.data[i]];
        cosine[k] = cos_incidence.data[i];
        twist[k] = local_basis ? 1.0f : cos_twist.data[i];
    }
    const auto interpolated = [&](const wp::array_t<wp::vec4>& table) {
        const int nodes = table.shape[1];
        const Lanes::V5 found = Lanes::stencil(cosine, nodes);
        const Lanes::I low = __builtin_convertvector(found.c[0], Lanes::I);
        float share[5][16], sum[4][16];
        __builtin_memcpy(share, &found, sizeof(found));
        for (int k = 0; k < 16; ++k) {
            const float* row = table.data[material[k] * nodes + low[k]].c;
            if (wanted == 1)
                sum[0][k] =
                    share[1][k] * row[0] + share[2][k] * row[4] + share[3][k] * row[8] + share[4][k] * row[12];
            else {
                Row r[4];
                __builtin_memcpy(r, row, sizeof(r));
                r[0] = share[1][k] * r[0] + share[2][k] * r[1] + share[3][k] * r[2] + share[4][k] * r[3];
                for (int j = 0; j < 4; ++j)
                    sum[j][k] = r[0][j];
            }
        }
        Lanes::V4 result;
        __builtin_memcpy(&result, sum, sizeof(result));
        return result;
    };
    const Lanes::V4 found = Lanes::crossed_sigma0(cosine, twist, interpolated(once), interpolated(twice));
    float across[4][16];
    __builtin_memcpy(across, &found, sizeof(found));
    for (int k = 0; k < count; ++k) {
        sigma_out.data[at[k]] = across[0][k];
        if (wanted == 4)
            slopes_out.data[at[k]] = {across[1][k], across[2][k], across[3][k], 0.0f};
    }
"""


@wp.func_native(_TABLE + _SCATTER)
def scatter_block(
    block: int,
    mine: wp.array(dtype=int),
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    once: wp.array2d(dtype=wp.vec4),
    twice: wp.array2d(dtype=wp.vec4),
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(enable_backward=False)
def scatter_kernel(
    # In:
    mine: wp.array(dtype=int),
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    once: wp.array2d(dtype=wp.vec4),
    twice: wp.array2d(dtype=wp.vec4),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """`crossed_table.scatter_kernel` for HITS hits."""
    scatter_block(
        wp.tid(),
        mine,
        local_basis,
        face,
        face_material,
        cos_incidence,
        cos_twist,
        once,
        twice,
        sigma_out,
        slopes_out,
    )
