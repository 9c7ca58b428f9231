"""Shading on the CPU: sigma0 and its slopes for sixteen hits at once, and look-ups that ask for memory ahead.

The equations are those of kernels/scattering.py, written out by kernels/lanes.py; only loads and stores are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.codes import Layout
from warpsar.kernels.shade import sigma0_and_slopes_of, sigma0_of

HITS = 16  # of a block

_UNIFORM = ("polarization", "variant", "wavenumber")
_MODEL = lanes.source(HITS, {sigma0_of: _UNIFORM, sigma0_and_slopes_of: _UNIFORM})

_SHADE = """
    typedef Lanes::V V;
    // the block's hits side by side; beyond the last one, its copies
    const int begin = block * 16, count = wp::min(sigma_out.shape[0] - begin, 16);
    const auto load = [&](const float* values) -> V {
        V result;
        if (count == 16)
            __builtin_memcpy(&result, values + begin, sizeof(V));
        else
            for (int k = 0; k < 16; ++k)
                result[k] = values[begin + wp::min(k, count - 1)];
        return result;
    };
    const V cosine = load(cos_incidence.data), azimuth = load(cos2_azimuth.data);
    const V twist = local_basis ? V(1.0f) : load(cos_twist.data);
    V loss, ratio;
    Lanes::I spectra;
    Lanes::V4 z;
    for (int k = 0; k < 16; ++k) {
        const int i = begin + wp::min(k, count - 1);
        const int material = face_material.data[face.data[i]];
        spectra[k] = spectrum.data[material];
        loss[k] = eps_im.data[material];
        ratio[k] = aspect.data[material];
        for (int j = 0; j < 4; ++j)
            z.c[j][k] = zeta.data[i].c[j];
    }
    if (!slopes_out.shape[0]) {
        const V sigma =
            Lanes::sigma0_of(polarization, spectra, variant, wavenumber, cosine, twist, azimuth, loss, ratio, z);
        for (int k = 0; k < count; ++k)
            sigma_out.data[begin + k] = sigma[k];
        return;
    }
    const Lanes::V5 found =
        Lanes::sigma0_and_slopes_of(polarization, spectra, variant, wavenumber, cosine, twist, azimuth, loss, ratio, z);
    float across[5][16];
    __builtin_memcpy(across, &found, sizeof(found));
    const auto store = [&](int k) {
        sigma_out.data[begin + k] = across[0][k];
        slopes_out.data[begin + k] = {across[1][k], across[2][k], across[3][k], across[4][k]};
    };
    if (count == 16)
        for (int k = 0; k < 16; ++k)
            store(k);
    else
        for (int k = 0; k < count; ++k)
            store(k);
"""


@wp.func_native(_MODEL + _SHADE)
def shade_block(
    block: int,
    polarization: int,
    variant: int,
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    cos2_azimuth: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    aspect: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(enable_backward=False)
def scatter_kernel(
    # In:
    polarization: int,
    variant: int,
    wavenumber: float,
    local_basis: int,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    cos_incidence: wp.array(dtype=float),
    cos_twist: wp.array(dtype=float),
    cos2_azimuth: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    aspect: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """`shade.scatter_kernel` for HITS hits; with `slopes_out` not empty `shade.scatter_slopes_kernel`."""
    shade_block(
        wp.tid(),
        polarization,
        variant,
        wavenumber,
        local_basis,
        face,
        face_material,
        cos_incidence,
        cos_twist,
        cos2_azimuth,
        spectrum,
        eps_im,
        aspect,
        zeta,
        sigma_out,
        slopes_out,
    )


@wp.func_native(
    lanes.enum(Layout)
    + """
    const int f = face.data[i], ahead = face.data[wp::min(i + 24, zeta_out.shape[0] - 1)];
    __builtin_prefetch(faces.data + 3 * ahead);
    __builtin_prefetch(face_material.data + ahead);
    const int* corner = faces.data + 3 * f;
    const wp::vec_t<4, wp::int32>* place = places.data + 4 * face_material.data[f];
    const float b1 = barycentric.data[i].c[0], b2 = barycentric.data[i].c[1], b0 = 1.0f - b1 - b2;
    for (int kind = 0; kind < 4; ++kind) {
        const float* node = nodes.data + place[kind].c[1];
        zeta_out.data[i].c[kind] = place[kind].c[0] == VERTEX
            ? b0 * node[corner[0]] + b1 * node[corner[1]] + b2 * node[corner[2]]
            : node[0];
    }
"""
)
def gather(
    i: int,
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec2),
    faces: wp.array2d(dtype=int),
    face_material: wp.array(dtype=int),
    places: wp.array2d(dtype=wp.vec4i),
    nodes: wp.array(dtype=float),
    zeta_out: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(enable_backward=False)
def gather_kernel(
    # In:
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec2),
    faces: wp.array2d(dtype=int),
    face_material: wp.array(dtype=int),
    uv: wp.array(dtype=wp.vec2),
    places: wp.array2d(dtype=wp.vec4i),
    nodes: wp.array(dtype=float),
    # Out:
    zeta_out: wp.array(dtype=wp.vec4),
):
    """`shade.gather_kernel` where no parameter is a texture."""
    gather(wp.tid(), face, barycentric, faces, face_material, places, nodes, zeta_out)


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
