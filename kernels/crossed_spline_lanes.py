"""`crossed_spline.scatter_kernel` and `beyond_kernel` on the CPU: sixteen hits at once.

The equations are those of kernels/crossed_spline.py, written out by kernels/lanes.py. Loads, stores and the sum over
the coefficients are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.codes import Model, Polarization
from warpsar.kernels.crossed_spline import (
    CONTRASTS,
    COSINES,
    HEIGHTS,
    LENGTHS,
    ROW,
    is_beyond,
    place_of,
    stencil,
    varying_sigma0,
)
from warpsar.kernels.models import modelled_of

HITS = 16  # of a block

_MODEL = lanes.source(
    HITS,
    {
        place_of: ("wavenumber",),
        is_beyond: (),
        stencil: ("nodes",),
        varying_sigma0: ("wavenumber",),
        modelled_of: ("model", "polarization", "wavenumber"),
    },
)
_SIZES = f"""
    const int cosines = {COSINES}, heights = {HEIGHTS}, lengths = {LENGTHS}, contrasts = {CONTRASTS}, width = {ROW};
    const int i2em = {int(Model.I2EM)}, hv = {int(Polarization.HV)};
"""

_SCATTER = """
    typedef Lanes::V V;
    typedef float Row __attribute__((ext_vector_type(4)));
    // the block's hits side by side; beyond the last one, its copies
    const int begin = block * 16, count = wp::min(mine.shape[0] - begin, 16);
    int at[16];
    V cosine, twist, loss;
    Lanes::I spectra, rows;
    Lanes::V4 z;
    for (int k = 0; k < 16; ++k) {
        const int i = at[k] = mine.data[begin + wp::min(k, count - 1)];
        const int material = face_material.data[face.data[i]];
        cosine[k] = cos_incidence.data[i];
        twist[k] = local_basis ? 1.0f : cos_twist.data[i];
        spectra[k] = spectrum.data[material];
        loss[k] = eps_im.data[material];
        rows[k] = row.data[material];
        for (int j = 0; j < 4; ++j)
            z.c[j][k] = zeta.data[i].c[j];
    }
    const Lanes::V4 place = Lanes::place_of(spectra, wavenumber, cosine, z);
    // of each axis: the first coefficient, three weights and their slopes
    float axes[4][7][16], sums[4][16];
    const int nodes[4] = {cosines, heights, lengths, contrasts};
    const int over_height = (lengths + 2) * width, over_cosine = (heights + 2) * over_height;
    const int steps[4] = {over_cosine, over_height, width, 1};
    Lanes::I start = rows * ((cosines + 2) * over_cosine);
    for (int a = 0; a < 4; ++a) {
        const auto found = Lanes::stencil(place.c[a], nodes[a]);
        __builtin_memcpy(axes[a], &found, sizeof(found));
        start += __builtin_convertvector(found.c[0], Lanes::I) * steps[a];
    }
    // four hits side by side, of each four coefficients over the contrast, the last of which has no weight
    const Lanes::I node = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
    for (int k = 0; k < 16; k += 4) {
        const auto rows_at = [&](int step) {
            Row one[4];
            for (int i = 0; i < 4; ++i)
                __builtin_memcpy(&one[i], table.data + start[k + i] + step, sizeof(Row));
            return __builtin_shufflevector(
                __builtin_shufflevector(one[0], one[1], 0, 1, 2, 3, 4, 5, 6, 7),
                __builtin_shufflevector(one[2], one[3], 0, 1, 2, 3, 4, 5, 6, 7),
                0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
        };
        const auto each = [&](int axis, int i) -> V {
            Row one;
            __builtin_memcpy(&one, &axes[axis][i][k], sizeof(one));
            return __builtin_shufflevector(one, one, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
        };
        V value = 0.0f, by_height = 0.0f, by_length = 0.0f;
        for (int h = 0; h < 3; ++h) {
            V inner = 0.0f, inner_by_length = 0.0f;
            for (int l = 0; l < 3; ++l) {
                V innermost = 0.0f;
                for (int c = 0; c < 3; ++c)
                    innermost += each(0, 1 + c) * rows_at(c * over_cosine + h * over_height + l * width);
                inner += each(2, 1 + l) * innermost;
                inner_by_length += each(2, 4 + l) * innermost;
            }
            value += each(1, 1 + h) * inner;
            by_height += each(1, 4 + h) * inner;
            by_length += each(1, 1 + h) * inner_by_length;
        }
        const auto over_contrast = [&](int i) -> V {
            return node == 0 ? each(3, i) : node == 1 ? each(3, i + 1) : node == 2 ? each(3, i + 2) : V(0.0f);
        };
        const auto sum_of = [&](V x, float* sum) {
            x += __builtin_shufflevector(x, x, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14);
            x += __builtin_shufflevector(x, x, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13);
            const Row one = __builtin_shufflevector(x, x, 0, 4, 8, 12);
            __builtin_memcpy(sum + k, &one, sizeof(one));
        };
        const V weights = over_contrast(1);
        sum_of(value * weights, sums[0]);
        sum_of(by_height * weights, sums[1]);
        sum_of(by_length * weights, sums[2]);
        sum_of(value * over_contrast(4), sums[3]);
    }
    Lanes::V4 twice;
    __builtin_memcpy(&twice, sums, sizeof(twice));
    const Lanes::I beyond = Lanes::is_beyond(place);
    Lanes::V4 found;
    if (slopes_out.shape[0])
        found = Lanes::varying_sigma0(spectra, wavenumber, cosine, twist, loss, z, twice);
    else
        found.c[0] = Lanes::varying_sigma0(spectra, wavenumber, cosine, twist, loss, z, twice).c[0];
    if (Lanes::any(beyond)) {
        const Lanes::V5 whole = Lanes::modelled_of(i2em, hv, spectra, wavenumber, cosine, twist, loss, z);
        for (int j = 0; j < 4; ++j)
            found.c[j] = beyond ? whole.c[j] : found.c[j];
    }
    float across[4][16];
    __builtin_memcpy(across, &found, sizeof(found));
    for (int k = 0; k < count; ++k) {
        sigma_out.data[at[k]] = across[0][k];
        if (slopes_out.shape[0])
            slopes_out.data[at[k]] = {across[1][k], across[2][k], across[3][k], 0.0f};
    }
"""


@wp.func_native(_MODEL + _SIZES + _SCATTER)
def scatter_block(
    block: int,
    mine: wp.array(dtype=int),
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    row: wp.array(dtype=int),
    table: wp.array(dtype=float),
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(enable_backward=False)
def scatter_kernel(
    # In:
    mine: wp.array(dtype=int),
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    row: wp.array(dtype=int),
    table: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """`crossed_spline.scatter_kernel` and `beyond_kernel` for HITS hits."""
    scatter_block(
        wp.tid(),
        mine,
        wavenumber,
        local_basis,
        face,
        face_material,
        cos_incidence,
        cos_twist,
        spectrum,
        eps_im,
        zeta,
        row,
        table,
        sigma_out,
        slopes_out,
    )
