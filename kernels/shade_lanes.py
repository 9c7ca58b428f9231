"""Shading on the CPU: sigma0 and its slopes for sixteen hits at once, and look-ups that ask for memory ahead.

The equations are those of kernels/scattering.py. What Warp makes of them takes one hit after the other, and clang does
not find sixteen in it (the C library's exp, complex numbers that pass as pairs). Every lane does the same steps, so
that a hit's numbers do not depend on where in a block it lies, nor on where a view's hits are cut for the cores.
"""

import warp as wp

HITS = 16  # of a block

_SIGMA0 = """
    typedef float V __attribute__((ext_vector_type(16)));
    typedef int I __attribute__((ext_vector_type(16)));
    struct C { V re, im; };
    const auto product = [](C a, C b) -> C { return {a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re}; };
    const auto inverse = [](C a) -> C {
        const V inverse = 1.0f / (a.re * a.re + a.im * a.im);
        return {a.re * inverse, -a.im * inverse};
    };
    const auto dot = [](C a, C b) -> V { return a.re * b.re + a.im * b.im; };
    const auto root = [](V re, V im) -> C {
        const V root = __builtin_elementwise_sqrt((__builtin_elementwise_sqrt(re * re + im * im) + re) * 0.5f);
        return {root, 0.5f * im / root};
    };
    // Cody and Waite's reduction, and the polynomial of Moshier's Cephes: within 2e-7 of e^x
    const auto exponential = [](V x) -> V {
        const V lowest = -87.3f, highest = 88.8f;
        const V bounded = __builtin_elementwise_min(__builtin_elementwise_max(x, lowest), highest);
        const V n = __builtin_elementwise_floor(bounded * 1.44269504f + 0.5f);
        const V r = (x - n * 0.693359375f) + n * 2.12194440e-4f;
        V p = r * 1.9875691500e-4f + 1.3981999507e-3f;
        p = p * r + 8.3334519073e-3f;
        p = p * r + 4.1665795894e-2f;
        p = p * r + 1.6666665459e-1f;
        p = p * r + 5.0000001201e-1f;
        p = p * r * r + r + 1.0f;
        const I exponent = (__builtin_convertvector(n, I) + 127) << 23;
        return x < lowest ? V(0.0f) : p * __builtin_bit_cast(V, exponent);
    };

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
    V c = load(cos_incidence.data), turn = load(cos_twist.data);
    const V cos2_azimuth = load(cos2_azimuth_of.data);
    V eps_im, aspect, z[4];
    I spectra;
    int found = 0;
    for (int k = 0; k < 16; ++k) {
        const int i = begin + wp::min(k, count - 1);
        const int material = face_material.data[face.data[i]];
        spectra[k] = spectrum.data[material];
        found |= 1 << spectrum.data[material];
        eps_im[k] = eps_im_of.data[material];
        aspect[k] = aspect_of.data[material];
        for (int j = 0; j < 4; ++j)
            z[j][k] = zeta.data[i].c[j];
    }
    const V least = 1.0e-6f, one = 1.0f, none = 0.0f, limit = 40.0f;
    c = __builtin_elementwise_min(__builtin_elementwise_max(c, least), one);
    turn = local_basis ? one : turn;
    const V grown = exponential(z[0]), h = exponential(z[1]), length = exponential(z[2]), length_y = aspect * length;
    V tau = 1.0f / (1.0f + exponential(-z[3]));
    tau = z[3] >= limit ? one : z[3] > -limit ? tau : none;
    const C eps = {1.0f + grown, -eps_im};
    const V sine2 = (1.0f - c) * (1.0f + c), cos2 = c * c;

    // the spectrum, in units of 1 / k, and its logarithm's slope to ln l
    const float pi = 3.14159265358979f;
    const V bragg = 4.0f * sine2, kl = wavenumber * length, kl_y = wavenumber * length_y, kh = wavenumber * h;
    const V kx2 = bragg * kl * kl, hl = kh * kl;
    V w = none, by_length = none;
    if (found & 1) {
        w = hl * hl * 0.25f / pi * exponential(-0.25f * kx2);
        by_length = 2.0f - 0.5f * kx2;
    }
    if (found & 2) {
        const V t = 1.0f + kx2;
        const V of = hl * hl / ((pi + pi) * t * __builtin_elementwise_sqrt(t));
        w = spectra == 1 ? of : w;
        by_length = spectra == 1 ? 2.0f - 3.0f * kx2 / t : by_length;
    }
    if (found & 4) {
        const V x = kx2 * cos2_azimuth, y = bragg * kl_y * kl_y * (1.0f - cos2_azimuth);
        const V of = hl * kh * kl_y / (pi * pi * ((1.0f + x) * (1.0f + y)));
        w = spectra == 2 ? of : w;
        by_length = spectra == 2 ? 2.0f - 2.0f * (x / (1.0f + x) + y / (1.0f + y)) : by_length;
    }

    // Bragg amplitudes
    const bool printed = variant == 1;
    const C q = root((eps.re - 1.0f) + cos2, eps.im);
    const C contrast = {1.0f - eps.re, -eps.im};
    const C over_te = inverse({c + q.re, q.im}), over_tm = inverse({eps.re * c + q.re, eps.im * c + q.im});
    const C a_hh = product(product(contrast, over_te), over_te);
    const V factor = printed ? cos2 : 1.0f + sine2;
    const C numerator = {sine2 - factor * eps.re, -factor * eps.im};
    const C a_vv = product(product({-contrast.re, -contrast.im}, over_tm), product(numerator, over_tm));
    const V turn2 = turn * turn, rest = (1.0f - turn) * (1.0f + turn);
    const V of_hh = polarization == 0 ? turn2 : polarization == 1 ? rest : -one;
    const V of_vv = polarization == 0 ? rest : polarization == 1 ? turn2 : one;
    const V share = polarization < 2 ? one : turn2 * rest;
    const C amplitude = {a_hh.re * of_hh + a_vv.re * of_vv, a_hh.im * of_hh + a_vv.im * of_vv};
    const V scale = (printed ? 8.0f : 16.0f * pi) * cos2 * cos2 * w * share;
    const V diffuse = scale * dot(amplitude, amplitude);

    // geometric optics: reflectivity of normal incidence, and slopes of variance 2 h^2 / l^2
    V specular = none, per_reflectivity = none, reflectivity = none, variance = one;
    C q0 = {one, none}, a0 = {none, none}, over0 = {one, none};
    if (polarization < 2) {
        variance = 2.0f * h * h / (spectra == 2 ? length * length_y : length * length);
        const V p = 0.5f / variance, sec2 = 1.0f / cos2;
        const V half = sec2 * exponential(-0.5f * p * sine2 * sec2);
        per_reflectivity = p * half * half;
        q0 = root((eps.re - 1.0f) + 1.0f, eps.im);
        over0 = inverse({1.0f + q0.re, q0.im});
        a0 = product(product(contrast, over0), over0);
        reflectivity = dot(a0, a0);
        specular = reflectivity * per_reflectivity;
    }
    const V sigma = (1.0f - tau) * diffuse + tau * specular;
    for (int k = 0; k < count; ++k)
        sigma_out.data[begin + k] = sigma[k];
    if (!slopes_out.shape[0])
        return;

    const auto slope_te = [&](C q, C over, C amplitude) -> C {
        const C a = product(over, over), b = product(product(amplitude, inverse(q)), over);
        return {-a.re - b.re, -a.im - b.im};
    };
    const C d_hh = slope_te(q, over_te, a_hh), in_q = inverse(q);
    const C top = product({sine2 - factor * (2.0f * eps.re - 1.0f), -2.0f * factor * eps.im}, over_tm);
    const C growth = product(a_vv, {2.0f * c + in_q.re, in_q.im});
    const C d_vv = product({top.re - growth.re, top.im - growth.im}, over_tm);
    const C slope = {d_hh.re * of_hh + d_vv.re * of_vv, d_hh.im * of_hh + d_vv.im * of_vv};
    V specular_by_eps = none, specular_by_length = none;
    if (polarization < 2) {
        specular_by_eps = per_reflectivity * 2.0f * dot(a0, slope_te(q0, over0, a0));
        specular_by_length = specular * (2.0f - sine2 / (cos2 * variance));
    }
    const V by_eps = ((1.0f - tau) * scale * 2.0f * dot(amplitude, slope) + tau * specular_by_eps) * grown;
    const V by_h = (1.0f - tau) * 2.0f * diffuse - tau * specular_by_length;
    const V by_l = (1.0f - tau) * by_length * diffuse + tau * specular_by_length;
    const V by_tau = tau * (1.0f - tau) * (specular - diffuse);
    const V slopes[4] = {by_eps, by_h, by_l, by_tau};
    float across[4][16];
    __builtin_memcpy(across, slopes, sizeof(slopes));
    if (count == 16)
        for (int k = 0; k < 16; ++k)
            slopes_out.data[begin + k] = {across[0][k], across[1][k], across[2][k], across[3][k]};
    else
        for (int k = 0; k < count; ++k)
            slopes_out.data[begin + k] = {across[0][k], across[1][k], across[2][k], across[3][k]};
"""


@wp.func_native(_SIGMA0)
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
    cos2_azimuth_of: wp.array(dtype=float),
    spectrum: wp.array(dtype=int),
    eps_im_of: wp.array(dtype=float),
    aspect_of: wp.array(dtype=float),
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
    """sigma0 of HITS hits, and with `slopes_out` not empty their derivatives to `zeta` (`scattering.sigma0_slopes`)."""
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
    """
    const int f = face.data[i], ahead = face.data[wp::min(i + 24, zeta_out.shape[0] - 1)];
    __builtin_prefetch(faces.data + 3 * ahead);
    __builtin_prefetch(face_material.data + ahead);
    const int* corner = faces.data + 3 * f;
    const wp::vec_t<4, wp::int32>* place = places.data + 4 * face_material.data[f];
    const float b1 = barycentric.data[i].c[0], b2 = barycentric.data[i].c[1], b0 = 1.0f - b1 - b2;
    for (int kind = 0; kind < 4; ++kind) {
        const float* node = nodes.data + place[kind].c[1];
        zeta_out.data[i].c[kind] = place[kind].c[0] == 1
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
