"""HV of I2EM where a surface varies: double scattering from a spline, single scattering at every hit.

B, double scattering, is a sum over rings of waves: sum P(ring; eps, theta) S(ring; kh, kl, theta). Permittivity enters
P alone, and roughness S alone. So S is computed once for each spectrum. From it follows a lattice of B over incidence,
ln kh, ln kl and ln(eps_re - 1), for each spectrum and eps_im. Powers of cos theta, kh and kl are taken out first. The
logarithm of the rest is a quadratic spline along each axis, and a hit reads 81 coefficients. Its slopes have no jumps,
and they are the exact ones of what is interpolated.

The lattice does not depend on the surface. B of a smooth surface grows with h^4, so below the least kh the spline stays
as it is there. Beyond any other end a hit has the integral. docs/scattering-checks.md says how near the spline is.
"""

import math
from functools import cache

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.codes import Coordinate, Polarization, Spectrum
from warpsar.kernels.crossed_table import LEAST, TOLERANCE
from warpsar.kernels.incidence_table import node_cosine
from warpsar.kernels.models.i2em import (
    RINGS,
    SPOKES,
    half_difference,
    hidden_share,
    i2em_single,
    ring_power,
    sigma0_and_slopes_of,
    slope_deviation,
    spoke_series,
)
from warpsar.kernels.scattering import bounded_cosine, sine_squared
from warpsar.kernels.shade import HitSurfaces
from warpsar.kernels.wide import read_float, read_int, read_vec4, write_vec4

# Loops over a spline's three nodes are written out; the series stay loops.
wp.set_module_options({"max_unroll": 3})

# Nodes along the axes of incidence, ln kh, ln kl and ln(eps_re - 1). Of each there are two coefficients more.
COSINES = wp.constant(24)
HEIGHTS = wp.constant(32)
LENGTHS = wp.constant(36)
CONTRASTS = wp.constant(29)
ROW = wp.constant(32)  # coefficients over the contrast, and one that fills 128 bytes
# The first node, and how many there are to a unit of the logarithm: kh from 0.01 to 4.9, eps_re from 1.1 to 111, and kl
# from 0.03 to 189. A gaussian needs more, from 0.1 to 7.9: its integral has too few waves beyond 4.
HEIGHT_LOW = wp.constant(math.log(0.01))
HEIGHT_DENSITY = wp.constant(5.0)
GAUSSIAN_LOW = wp.constant(math.log(0.1))
GAUSSIAN_DENSITY = wp.constant(8.0)
LENGTH_LOW = wp.constant(math.log(0.03))
LENGTH_DENSITY = wp.constant(4.0)
CONTRAST_LOW = wp.constant(math.log(0.1))
CONTRAST_DENSITY = wp.constant(4.0)


@wp.func
def length_low(spectrum: int):
    return wp.where(spectrum == Spectrum.GAUSSIAN, GAUSSIAN_LOW, LENGTH_LOW)


@wp.func
def length_density(spectrum: int):
    return wp.where(spectrum == Spectrum.GAUSSIAN, GAUSSIAN_DENSITY, LENGTH_DENSITY)


@wp.func
def node_of(node: int, low: float, density: float):
    """The number whose logarithm a node stands for, float64."""
    return wp.exp(wp.float64(low) + wp.float64(float(node)) / wp.float64(density))


@wp.kernel(enable_backward=False)
def series_kernel(
    # In:
    spectrum: int,
    # Out:
    series_out: wp.array4d(dtype=wp.float64),
):
    """S over (kh cos theta)^4; (cosines, heights, lengths, rings)."""
    i, j, k, ring = wp.tid()
    cosine = node_cosine(i, COSINES)
    height = node_of(j, HEIGHT_LOW, HEIGHT_DENSITY)
    length = node_of(k, length_low(spectrum), length_density(spectrum))
    mean = height * height * cosine * cosine
    sine = wp.sqrt(sine_squared(cosine))
    _power, _by_eps, rho2 = ring_power(ring, wp.vec2d(wp.float64(2.0), wp.float64(0.0)), wp.vec2d(), wp.vec2d())
    total = wp.float64(0.0)
    for spoke in range(SPOKES):
        part, _by_height, _by_length = spoke_series(spoke, TOLERANCE, spectrum, rho2, sine, mean, length * length)
        total += part
    series_out[i, j, k, ring] = total / (mean * mean)


@wp.kernel(enable_backward=False)
def power_kernel(
    # In:
    eps_im: wp.float64,
    # Out:
    power_out: wp.array3d(dtype=wp.float64),
):
    """P; (cosines, contrasts, rings)."""
    i, m, ring = wp.tid()
    eps = wp.vec2d(wp.float64(1.0) + node_of(m, CONTRAST_LOW, CONTRAST_DENSITY), -eps_im)
    r, dr = half_difference(node_cosine(i, COSINES), eps)
    power, _by_eps, _rho2 = ring_power(ring, eps, r, dr)
    power_out[i, m, ring] = power


@wp.kernel(enable_backward=False)
def lattice_kernel(
    # In:
    power: wp.array3d(dtype=wp.float64),
    series: wp.array4d(dtype=wp.float64),
    # Out:
    lattice_out: wp.array4d(dtype=wp.float64),
):
    """ln of the sum of P S over the rings; (cosines, heights, lengths, contrasts)."""
    i, j, k, m = wp.tid()
    total = wp.float64(0.0)
    for ring in range(RINGS):
        total += power[i, m, ring] * series[i, j, k, ring]
    lattice_out[i, j, k, m] = wp.log(wp.max(total, LEAST))


@wp.func
def place_of(spectrum: int, wavenumber: float, cos_incidence: float, zeta: wp.vec4):
    """Where a hit lies along the axes of incidence, ln kh, ln kl and contrast, in steps from the first node."""
    cosine = bounded_cosine(cos_incidence)
    scale = wp.log(wavenumber)
    return wp.vector(
        0.5 * (wp.sqrt(cosine) - wp.sqrt(1.0 - cosine) + 1.0) * (float(COSINES) - 1.0),
        (zeta[Coordinate.HEIGHT] + scale - HEIGHT_LOW) * HEIGHT_DENSITY,
        (zeta[Coordinate.LENGTH] + scale - length_low(spectrum)) * length_density(spectrum),
        (zeta[Coordinate.EPS] - CONTRAST_LOW) * CONTRAST_DENSITY,
    )


@wp.func
def is_beyond(place: wp.vec4):
    """Whether a hit has no place in the lattice."""
    return (
        place[1] > float(HEIGHTS) - 1.0
        or place[2] < 0.0
        or place[2] > float(LENGTHS) - 1.0
        or place[3] < 0.0
        or place[3] > float(CONTRASTS) - 1.0
    )


@wp.func
def stencil(place: float, nodes: float):
    """The first of the three coefficients about a place along an axis, their weights, and these' slopes; (7,).

    Before the first node, and beyond the last, values stay as they are there.
    """
    held = wp.clamp(place, 0.0, nodes - 1.0)
    low = wp.floor(held + 0.5)
    x = held - low
    share = wp.where(held == place, 1.0, 0.0)
    return wp.vector(
        low,
        0.5 * (0.5 - x) * (0.5 - x),
        0.75 - x * x,
        0.5 * (0.5 + x) * (0.5 + x),
        share * (x - 0.5),
        share * (-2.0 * x),
        share * (x + 0.5),
    )


@wp.func
def varying_sigma0(
    spectrum: int,
    wavenumber: float,
    cos_incidence: float,
    cos_twist: float,
    eps_im: float,
    zeta: wp.vec4,
    twice: wp.vec4,
):
    """sigma0 of HV and its slopes to the learned coordinates, (4,); `twice`: the spline, and its slopes to steps."""
    cosine = bounded_cosine(cos_incidence)
    contrast = wp.exp(zeta[Coordinate.EPS])
    height = wavenumber * wp.exp(zeta[Coordinate.HEIGHT])
    length = wavenumber * wp.exp(zeta[Coordinate.LENGTH])
    value, by_eps, by_height, by_length = i2em_single(
        Polarization.HV, spectrum, cosine, cos_twist, wp.vector(1.0 + contrast, -eps_im), height, length
    )
    hidden, hidden_by_slope = hidden_share(cosine, slope_deviation(spectrum, height, length))
    seen = 1.0 / (1.0 + 2.0 * hidden)
    lost = 2.0 * hidden_by_slope * seen
    single = value * seen
    once = 1.0 / (1.0 + hidden)
    lost_once = hidden_by_slope * once
    area = height * length
    area = area * area
    paired = once * area * area * cosine * cosine * (0.25 / wp.pi) * wp.exp(twice[0])
    return wp.vector(
        single + paired,
        by_eps * contrast * seen + paired * twice[3] * CONTRAST_DENSITY,
        by_height * seen - single * lost + paired * (4.0 + twice[1] * HEIGHT_DENSITY - lost_once),
        by_length * seen + single * lost + paired * (4.0 + twice[2] * length_density(spectrum) + lost_once),
    )


@wp.func
def read_three(table: wp.array(dtype=float), i: int):
    return wp.vec3(read_float(table, i), read_float(table, i + 1), read_float(table, i + 2))


@wp.func
def splined(table: wp.array(dtype=float), row: int, place: wp.vec4) -> wp.vec4:
    """The spline of a row of the table, and its slopes to the places along the axes of height, length and contrast."""
    cosines = stencil(place[0], float(COSINES))
    heights = stencil(place[1], float(HEIGHTS))
    lengths = stencil(place[2], float(LENGTHS))
    contrasts = stencil(place[3], float(CONTRASTS))
    first = ((row * (COSINES + 2) + int(cosines[0])) * (HEIGHTS + 2) + int(heights[0])) * (LENGTHS + 2)
    first = (first + int(lengths[0])) * ROW + int(contrasts[0])
    value = wp.vec3()
    by_height = wp.vec3()
    by_length = wp.vec3()
    for j in range(3):
        inner = wp.vec3()
        inner_by_length = wp.vec3()
        for k in range(3):
            innermost = wp.vec3()
            for i in range(3):
                at = first + ((i * (HEIGHTS + 2) + j) * (LENGTHS + 2) + k) * ROW
                innermost += cosines[1 + i] * read_three(table, at)
            inner += lengths[1 + k] * innermost
            inner_by_length += lengths[4 + k] * innermost
        value += heights[1 + j] * inner
        by_height += heights[4 + j] * inner
        by_length += heights[1 + j] * inner_by_length
    weights = wp.vec3(contrasts[1], contrasts[2], contrasts[3])
    slopes = wp.vec3(contrasts[4], contrasts[5], contrasts[6])
    return wp.vec4(
        wp.dot(value, weights), wp.dot(by_height, weights), wp.dot(by_length, weights), wp.dot(value, slopes)
    )


# In lanes four hits lie side by side, of each four coefficients over the contrast: the loops as they stand here would
# read every coefficient by itself.
lanes.by_hand(
    splined,
    f"""
[[gnu::always_inline]] static V4 splined(const wp::array_t<float>& table, I rows, const V4& place)
{{
    typedef float Row __attribute__((ext_vector_type(4)));
    const int cosines = {COSINES}, heights = {HEIGHTS}, lengths = {LENGTHS}, contrasts = {CONTRASTS}, width = {ROW};
"""
    """
    // of each axis: the first coefficient, three weights and their slopes
    float axes[4][7][16], sums[4][16];
    const int nodes[4] = {cosines, heights, lengths, contrasts};
    const int over_height = (lengths + 2) * width, over_cosine = (heights + 2) * over_height;
    const int steps[4] = {over_cosine, over_height, width, 1};
    I start = rows * ((cosines + 2) * over_cosine);
    for (int a = 0; a < 4; ++a) {
        const auto found = stencil(place.c[a], nodes[a]);
        __builtin_memcpy(axes[a], &found, sizeof(found));
        start += __builtin_convertvector(found.c[0], I) * steps[a];
    }
    // four hits side by side, of each four coefficients over the contrast, the last of which has no weight
    const I node = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
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
    V4 twice;
    __builtin_memcpy(&twice, sums, sizeof(twice));
    return twice;
}
""",
    {stencil: ("nodes",)},
)


@cache
def scatter_kernel(slopes: bool, *, beyond: bool) -> wp.Kernel:
    """The kernel of sigma0 of HV and VH for the hits `mine`, with `slopes` of its slopes too; `row`: of each material.

    There are two, because slopes need almost twice the registers. With `beyond` it has the integral for the hits that
    have no place in the lattice; without, `beyond_kernel` has yet to set them: on a GPU the integral needs so many
    registers that few hits would be under way at once.
    """

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1 if beyond else 3})
    def scatter_kernel(
        # In:
        mine: wp.array(dtype=int),
        hits: HitSurfaces,
        zeta: wp.array(dtype=wp.vec4),
        row: wp.array(dtype=int),
        table: wp.array(dtype=float),
        # Out:
        sigma_out: wp.array(dtype=float),
        slopes_out: wp.array(dtype=wp.vec4),
    ):
        i = read_int(mine, wp.tid())
        material = read_int(hits.face_material, read_int(hits.face, i))
        kind = read_int(hits.spectrum, material)
        loss = read_float(hits.eps_im, material)
        cosine = read_float(hits.cos_incidence, i)
        twist = read_float(hits.cos_twist, i)
        if hits.local_basis != 0:
            twist = 1.0
        z = read_vec4(zeta, i)
        place = place_of(kind, hits.wavenumber, cosine, z)
        twice = splined(table, read_int(row, material), place)
        found = varying_sigma0(kind, hits.wavenumber, cosine, twist, loss, z, twice)
        if wp.static(beyond):
            if is_beyond(place):
                found = integral(kind, hits.wavenumber, cosine, twist, loss, z)
        sigma_out[i] = found[0]
        if wp.static(slopes):
            write_vec4(slopes_out, i, wp.vec4(found[1], found[2], found[3], 0.0))

    return scatter_kernel


@wp.func
def integral(
    spectrum: int, wavenumber: float, cos_incidence: float, cos_twist: float, eps_im: float, zeta: wp.vec4
) -> wp.vec4:
    """sigma0 of HV and its slopes as of `varying_sigma0`, where there is no place in the lattice."""
    found = sigma0_and_slopes_of(
        int(Polarization.HV), spectrum, 0, wavenumber, cos_incidence, cos_twist, 1.0, eps_im, 1.0, zeta
    )
    return wp.vec4(found[0], found[1], found[2], found[3])


@wp.kernel(enable_backward=False)
def beyond_kernel(
    # In:
    mine: wp.array(dtype=int),
    hits: HitSurfaces,
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """sigma0 by the integral for those of the hits `mine` that have no place in the lattice; its slopes as above."""
    i = read_int(mine, wp.tid())
    material = read_int(hits.face_material, read_int(hits.face, i))
    kind = read_int(hits.spectrum, material)
    cosine = read_float(hits.cos_incidence, i)
    z = read_vec4(zeta, i)
    if not is_beyond(place_of(kind, hits.wavenumber, cosine, z)):
        return
    twist = read_float(hits.cos_twist, i)
    if hits.local_basis != 0:
        twist = 1.0
    found = integral(kind, hits.wavenumber, cosine, twist, read_float(hits.eps_im, material), z)
    sigma_out[i] = found[0]
    if slopes_out.shape[0] > 0:
        write_vec4(slopes_out, i, wp.vec4(found[1], found[2], found[3], 0.0))
