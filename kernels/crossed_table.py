"""HV of I2EM from a table over incidence, for a material whose surface is the same everywhere.

There sigma0 is share(psi) A(theta) + B(theta): single scattering of a facet that is turned about the line of sight, and
double scattering. B is an integral over eighty waves. So both are computed once at some incidences, a thread for each
wave, and every hit interpolates. Powers of cos and sin theta are taken out first. The logarithm of the rest is
interpolated by the cubic through four nodes, equal steps apart in sqrt(cos) - sqrt(1 - cos). So they are dense at both
ends, for the lobe about the normal and for the shadow. The same weights on the nodes' slopes of the logarithm give the
exact derivative of what is interpolated. docs/scattering-checks.md says how far it is from the integral.
"""

from functools import cache
from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate, Polarization
from warpsar.kernels.incidence_table import DOUBLE, SINGLE, interpolated, node_cosine
from warpsar.kernels.models.i2em import (
    SPOKES,
    half_difference,
    hidden_share,
    i2em_single,
    multiple_scale,
    ring_power,
    slope_deviation,
    spoke_series,
)
from warpsar.kernels.scattering import MIN_COS_INCIDENCE, sine_squared
from warpsar.kernels.shade import HitSurfaces
from warpsar.kernels.wide import read_float, read_int, write_vec4

wp.set_module_options({"max_unroll": 1})

WAVES = wp.constant(80)  # RINGS * SPOKES
TOLERANCE = wp.constant(1.0e-8)  # of the series: a jump of it between two nodes would be seen in the cubic
LEAST = wp.constant(wp.float64(1.0e-30))  # of a node: its logarithm is finite
TURNED = wp.constant(wp.float64(0.7071067811865476))  # cos(psi) of the node, where the share of A is 1 / 4


@wp.func
def surface_of(wavenumber: wp.float64, zeta: wp.vec4):
    """eps_re, kh and kl of learned coordinates, float64."""
    return (
        wp.float64(1.0) + wp.exp(wp.float64(zeta[Coordinate.EPS])),
        wavenumber * wp.exp(wp.float64(zeta[Coordinate.HEIGHT])),
        wavenumber * wp.exp(wp.float64(zeta[Coordinate.LENGTH])),
    )


@wp.kernel(enable_backward=False)
def wave_kernel(
    # In:
    wavenumber: wp.float64,
    own: wp.array(dtype=wp.vec2i),  # of a table: its material, and a hit of it
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    wave_out: wp.array3d(dtype=wp.vec4d),
):
    """What each wave adds to double scattering at each node, and its derivatives to eps_re, ln h and ln l."""
    table, node, wave = wp.tid()
    material = own[table][0]
    re, height, length = surface_of(wavenumber, zeta[own[table][1]])
    eps = wp.vector(re, -wp.float64(eps_im[material]))
    cosine = node_cosine(node, DOUBLE)
    r, dr = half_difference(cosine, eps)
    power, power_by_eps, rho2 = ring_power(wave // SPOKES, eps, r, dr)
    series, by_height, by_length = spoke_series(
        wave % SPOKES,
        TOLERANCE,
        spectrum[material],
        rho2,
        wp.sqrt(sine_squared(cosine)),
        height * height * cosine * cosine,
        length * length,
    )
    wave_out[table, node, wave] = wp.vec4d(power * series, power_by_eps * series, power * by_height, power * by_length)


@wp.func
def logarithmic(value: Any, by_eps: Any, by_height: Any, by_length: Any, contrast: Any):
    """ln of a value, and its derivatives to the learned coordinates; float32."""
    held = wp.max(value, LEAST)
    over = type(held)(1.0) / held
    return wp.vec4(
        float(wp.log(held)), float(by_eps * contrast * over), float(by_height * over), float(by_length * over)
    )


@wp.kernel(enable_backward=False)
def single_kernel(
    # In:
    wavenumber: wp.float64,
    own: wp.array(dtype=wp.vec2i),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    table_out: wp.array2d(dtype=wp.vec4),
):
    """ln A and its slopes at each node; a row of the table is a material's."""
    table, node = wp.tid()
    material = own[table][0]
    re, height, length = surface_of(wavenumber, zeta[own[table][1]])
    cosine = node_cosine(node, SINGLE)
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    kind = spectrum[material]
    eps = wp.vector(re, -wp.float64(eps_im[material]))
    value, by_eps, by_height, by_length = i2em_single(int(Polarization.HV), kind, cosine, TURNED, eps, height, length)
    hidden, hidden_by_slope = hidden_share(cosine, slope_deviation(kind, height, length))
    seen = one / (one + two * hidden)
    lost = two * hidden_by_slope * seen
    powers = sine_squared(cosine) * cosine * cosine
    scale = seen * wp.float64(4.0) / (powers * powers)
    table_out[material, node] = logarithmic(
        value * scale,
        by_eps * scale,
        (by_height - value * lost) * scale,
        (by_length + value * lost) * scale,
        re - one,
    )


@wp.kernel(enable_backward=False)
def double_kernel(
    # In:
    wavenumber: wp.float64,
    own: wp.array(dtype=wp.vec2i),
    spectrum: wp.array(dtype=int),
    zeta: wp.array(dtype=wp.vec4),
    wave: wp.array3d(dtype=wp.vec4d),
    # Out:
    table_out: wp.array2d(dtype=wp.vec4),
):
    """ln B and its slopes at each node, from what `wave_kernel` has found; a row of the table is a material's."""
    table, node = wp.tid()
    material = own[table][0]
    re, height, length = surface_of(wavenumber, zeta[own[table][1]])
    cosine = node_cosine(node, DOUBLE)
    one = wp.float64(1.0)
    total = wp.vec4d()
    for k in range(WAVES):
        total += wave[table, node, k]
    hidden, hidden_by_slope = hidden_share(cosine, slope_deviation(spectrum[material], height, length))
    once = one / (one + hidden)
    lost = hidden_by_slope * once
    scale = once * multiple_scale(cosine, length) / (cosine * cosine)
    table_out[material, node] = logarithmic(
        total[0] * scale,
        total[1] * scale,
        (total[2] - total[0] * lost) * scale,
        (total[3] + total[0] * lost) * scale,
        re - one,
    )


@wp.func
def crossed_sigma0(cos_incidence: float, cos_twist: float, once: wp.vec4, twice: wp.vec4):
    """share A + B and its slopes, from ln A and ln B with theirs: a vector of four."""
    cosine = wp.clamp(cos_incidence, MIN_COS_INCIDENCE, 1.0)
    cos2 = cosine * cosine
    powers = sine_squared(cosine) * cos2
    share = sine_squared(cos_twist) * cos_twist * cos_twist
    single = share * powers * powers * wp.exp(once[0])
    paired = cos2 * wp.exp(twice[0])
    return wp.vector(
        single + paired,
        single * once[1] + paired * twice[1],
        single * once[2] + paired * twice[2],
        single * once[3] + paired * twice[3],
    )


@cache
def scatter_kernel(slopes: bool) -> wp.Kernel:
    """The kernel of sigma0 of HV and VH for the hits `mine`, with `slopes` of its slopes too."""

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def scatter_kernel(
        # In:
        mine: wp.array(dtype=int),
        hits: HitSurfaces,
        once: wp.array2d(dtype=wp.vec4),
        twice: wp.array2d(dtype=wp.vec4),
        # Out:
        sigma_out: wp.array(dtype=float),
        slopes_out: wp.array(dtype=wp.vec4),
    ):
        i = read_int(mine, wp.tid())
        cosine = read_float(hits.cos_incidence, i)
        material = read_int(hits.face_material, read_int(hits.face, i))
        twist = read_float(hits.cos_twist, i)
        if hits.local_basis != 0:
            twist = 1.0
        found = crossed_sigma0(
            cosine, twist, interpolated(once, material, cosine, SINGLE), interpolated(twice, material, cosine, DOUBLE)
        )
        sigma_out[i] = found[0]
        if wp.static(slopes):
            write_vec4(slopes_out, i, wp.vec4(found[1], found[2], found[3], 0.0))

    return scatter_kernel
