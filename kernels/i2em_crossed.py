"""Multiple scattering of I2EM: HV of level ground, by an integral over the waves that run along the surface.

Source: Fung, Li and Chen 1992, equations 17, 18 and A28; Fung and Chen 2010, chapter 4. The published program takes
waves that leave the surface alone (its r from 0.1 to 1), which loses 3 to 10 dB. Here the
integral runs over the evanescent waves too, as the paper's does. docs/scattering.md lists what else differs.
"""

from typing import Any

import warp as wp

from warpsar.kernels.i2em import complex_decaying_root, poisson_series
from warpsar.kernels.scattering import (
    amplitude_te,
    amplitude_tm,
    complex_inverse,
    complex_product,
    refraction,
    sine_squared,
    slope_te,
    slope_tm,
)

# Loss of a wave that grazes the surface above (the published 1.0001 - r^2) and below it (a share of eps_re): without
# one the integral has no value.
LOSS_ABOVE = wp.constant(1.0e-4)
LOSS_BELOW = wp.constant(0.5)
# Midpoint rule in asinh((r^2 - 1) / LOSS_ABOVE), from r = 0 to r^2 = 1 + 1000, and in the azimuth: within 0.3 dB.
LOWEST = wp.constant(-9.903487555036128)
STEP = wp.constant(1.6696706491596496)
# Of the series, hit by hit: a thousandth of a decibel, where the quadrature is good to 0.3.
TOLERANCE = wp.constant(1.0e-4)
RINGS = wp.constant(16)
SPOKES = wp.constant(5)


@wp.func
def ring_amplitude(eps: Any, r: Any, dr: Any, eccentric: Any, wave: Any):
    """F of a wave along the surface over its direction, complex, and dF / d eps_re.

    r: (R_v - R_h) / 2, dr: its slope. `eccentric`: rho^2 of the wave, `wave`: 1 / q of it above the surface.
    """
    one = type(eccentric)(1.0)
    two = type(eccentric)(2.0)
    loss = type(eccentric)(LOSS_BELOW)
    below = complex_inverse(complex_decaying_root(eps[0] - eccentric, eps[1] - loss * eps[0]))
    inverse = complex_inverse(eps)
    unit = wp.vector(one, type(eccentric)(0.0))
    plus = unit + r
    minus = unit - r
    plus2 = complex_product(plus, plus)
    minus2 = complex_product(minus, minus)
    r2 = complex_product(r, r)
    over_eps = complex_product(plus2, inverse)
    inside = r2 * type(eccentric)(6.0) - unit * two + over_eps + complex_product(eps, minus2)
    by_r = r * type(eccentric)(12.0) + complex_product(plus, inverse) * two - complex_product(eps, minus) * two
    inside_slope = complex_product(by_r, dr) - complex_product(over_eps, inverse) + minus2
    # d(q_t^2) / d eps_re = 1 - j loss
    growth = complex_product(complex_product(below, below), wp.vector(one, -loss)) * type(eccentric)(0.5)
    amplitude = complex_product(r2, wave) * type(eccentric)(8.0) + complex_product(inside, below)
    slope = complex_product(complex_product(r, dr), wave) * type(eccentric)(16.0) + complex_product(
        inside_slope - complex_product(inside, growth), below
    )
    return amplitude, slope


@wp.func
def half_difference(cosine: Any, eps: Any):
    """(R_v - R_h) / 2 of the smooth surface, complex, and its slope."""
    half = type(cosine)(0.5)
    q = refraction(cosine, eps)
    r_h = amplitude_te(cosine, eps, q)
    minus_r_v = amplitude_tm(cosine, eps, q, cosine * cosine)
    dr_h = slope_te(cosine, q, r_h)
    minus_dr_v = slope_tm(cosine, eps, q, cosine * cosine, minus_r_v)
    return -(minus_r_v + r_h) * half, -(minus_dr_v + dr_h) * half


@wp.func
def ring_power(ring: int, eps: Any, r: Any, dr: Any):
    """|F|^2 of a ring of waves with its weight, twice its change with eps_re, and the ring's rho^2."""
    one = type(eps[0])(1.0)
    half = type(eps[0])(0.5)
    two = type(eps[0])(2.0)
    step = type(eps[0])(STEP)
    loss = type(eps[0])(LOSS_ABOVE)
    grown = wp.exp(type(eps[0])(LOWEST) + step * (type(eps[0])(float(ring)) + half))
    fallen = one / grown
    beyond = loss * half * (grown - fallen)
    rho2 = one + beyond
    spoke = type(eps[0])(wp.pi) * half / type(eps[0])(float(SPOKES))
    weight = loss * half * (grown + fallen) * step * half * two * spoke
    amplitude, slope = ring_amplitude(eps, r, dr, rho2, complex_inverse(complex_decaying_root(-beyond, -loss)))
    return weight * wp.dot(amplitude, amplitude), two * weight * wp.dot(amplitude, slope), rho2


@wp.func
def spoke_series(spoke: int, tolerance: float, spectrum: int, rho2: Any, sine: Any, mean: Any, area: Any):
    """Of one wave of a ring: how much of it the surface makes and scatters back; its derivatives to ln h and ln l."""
    half = type(rho2)(0.5)
    two = type(rho2)(2.0)
    angle = type(rho2)(wp.pi) * half / type(rho2)(float(SPOKES)) * (type(rho2)(float(spoke)) + half)
    rho = wp.sqrt(rho2)
    along = rho * wp.cos(angle)
    sides = along * rho * wp.sin(angle)
    share = sides * sides
    middle = rho2 + sine * sine
    near, near_by_height, near_by_length = poisson_series(
        1, tolerance, spectrum, mean, area * (middle - two * along * sine)
    )
    far, far_by_height, far_by_length = poisson_series(
        1, tolerance, spectrum, mean, area * (middle + two * along * sine)
    )
    return (
        share * near * far,
        share * (near_by_height * far + near * far_by_height),
        share * (near_by_length * far + near * far_by_length),
    )


@wp.func
def multiple_scale(cosine: Any, length: Any):
    """What stands before the integral."""
    area = length * length
    return area * area / (type(cosine)(4.0) * type(cosine)(wp.pi) * cosine * cosine)


@wp.func
def i2em_multiple(spectrum: int, cosine: Any, eps: Any, height: Any, length: Any):
    """HV by double scattering: sigma0 and its derivatives to eps_re, ln h and ln l; kh and kl as in `i2em_single`."""
    r, dr = half_difference(cosine, eps)
    mean = height * height * cosine * cosine
    sine = wp.sqrt(sine_squared(cosine))
    area = length * length
    total = type(cosine)(0.0)
    by_eps = type(cosine)(0.0)
    by_height = type(cosine)(0.0)
    by_length = type(cosine)(0.0)
    for i in range(RINGS):
        power, power_by_eps, rho2 = ring_power(i, eps, r, dr)
        series = type(cosine)(0.0)
        series_by_height = type(cosine)(0.0)
        series_by_length = type(cosine)(0.0)
        for j in range(SPOKES):
            part, part_by_height, part_by_length = spoke_series(j, TOLERANCE, spectrum, rho2, sine, mean, area)
            series += part
            series_by_height += part_by_height
            series_by_length += part_by_length
        total += power * series
        by_eps += power_by_eps * series
        by_height += power * series_by_height
        by_length += power * series_by_length
    scale = multiple_scale(cosine, length)
    return scale * total, scale * by_eps, scale * by_height, scale * by_length
