"""Improved integral equation model (I2EM) in backscatter, as differentiable Warp functions (docs/scattering-checks.md).

Sources: Fung, Li and Chen 1992 (IEM); Fung, Liu, Chen and Tsay 2002 (its phases); Fung and Chen 2010, chapters 3 and 4.
In backscatter the published coefficients come down to two amplitudes for each polarization: Bragg's for the first power
of the correlation, and one for all higher powers. tests/test_i2em.py holds them against the published coefficients.

HV of level ground is an integral over the waves that run along the surface: Fung, Li and Chen 1992, equations 17, 18
and A28; Fung and Chen 2010, chapter 4. The published program takes waves that leave the surface alone (its r from 0.1
to 1), which loses 3 to 10 dB. Here the integral runs over the evanescent waves too, as the paper's does.

Functions are generic over float32 and float64. Lengths are in units of 1/k. The series over the powers of the
correlation is a mean over a Poisson distribution; it ends where the distribution does.
"""

from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate, Spectrum, Variant
from warpsar.kernels.incidence_table import DOUBLE, interpolated
from warpsar.kernels.parts import Lookup, Parts
from warpsar.kernels.scattering import (
    amplitude_te,
    amplitude_tm,
    bounded_cosine,
    complex_inverse,
    complex_product,
    factor_vv,
    is_crossed,
    refraction,
    sine_squared,
    slope_te,
    slope_tm,
    turned,
    turned_share,
)

# Loss of a wave that grazes the surface above (the published 1.0001 - r^2) and below it (a share of eps_re): without
# one the integral has no value.
LOSS_ABOVE = wp.constant(1.0e-4)
LOSS_BELOW = wp.constant(0.5)
# Midpoint rule in asinh((r^2 - 1) / LOSS_ABOVE), from r = 0 to r^2 = 1 + 1000, and in the azimuth: within 0.3 dB.
LOWEST = wp.constant(-9.903487555036128)
STEP = wp.constant(1.6696706491596496)
# Of the series in HV, hit by hit: a thousandth of a decibel, where the quadrature is good to 0.3.
CROSSED_TOLERANCE = wp.constant(1.0e-4)
RINGS = wp.constant(16)
SPOKES = wp.constant(5)
# Terms of the series are taken in blocks, while one of them has more than the tolerance of the distribution.
TOLERANCE = wp.constant(1.0e-5)
BLOCK = wp.constant(4)
BLOCKS = wp.constant(32)
# A distribution with a larger mean is taken at the two places that have its first three moments: exp(-x) is float32's.
LARGEST_MEAN = wp.constant(60.0)
# cot(theta) over the slopes; beyond it less than 1e-17 of the surface is in shadow.
LARGEST_SLOPE_RATIO = wp.constant(6.0)
LEAST_SINE = wp.constant(1.0e-6)


@wp.func
def power_spectrum(spectrum: int, power: Any, square: Any):
    """Spectrum of a power of the correlation over (kl)^2, and d ln of it / d ln l with (kl)^2; square: (K l)^2."""
    one = type(square)(1.0)
    two = type(square)(2.0)
    half = type(square)(0.5)
    value = square
    slope = square
    if spectrum == Spectrum.GAUSSIAN:
        inverse_power = half / power
        fall = square * inverse_power
        value = wp.exp(-half * fall) * inverse_power
        slope = two - fall
    else:
        inverse = one / (power * power + square)
        value = power * inverse * wp.sqrt(inverse)
        slope = two - type(square)(3.0) * square * inverse
    return value, slope


@wp.func
def poisson_series(first: int, tolerance: float, spectrum: int, mean: Any, square: Any):
    """Sum of exp(-x) x^n / n! times the spectrum of the n-th power, from n = first (1 or 2) on; x is `mean`.

    It ends where a term's exp(-x) x^n / n! is below `tolerance`. Returns the sum, and its derivatives to ln h (x grows
    as h^2) and ln l, all over (kl)^2.
    """
    one = type(mean)(1.0)
    half = type(mean)(0.5)
    two = type(mean)(2.0)
    x = wp.min(mean, type(mean)(LARGEST_MEAN))
    share = wp.exp(-x)
    if first == 2:
        share = share * x
    total = type(mean)(0.0)
    by_height = type(mean)(0.0)
    by_length = type(mean)(0.0)
    for block in range(BLOCKS):
        start = type(mean)(float(first + block * BLOCK))
        if share > type(mean)(tolerance) or start <= x:
            for i in range(BLOCK):
                n = start + type(mean)(float(i))
                share = share * (x * (one / n))
                value, slope = power_spectrum(spectrum, n, square)
                part = share * value
                total += part
                by_height += two * (n - x) * part
                by_length += slope * part
    if mean > type(mean)(LARGEST_MEAN):
        root = wp.sqrt(mean + half * half)
        upper = (root - half) / (two * root)
        high, high_slope = power_spectrum(spectrum, mean + half + root, square)
        low, low_slope = power_spectrum(spectrum, mean + half - root, square)
        # d / dx of a Poisson mean of f(n) is that of f(n + 1) - f(n)
        high_next, _high = power_spectrum(spectrum, mean + half + root + one, square)
        low_next, _low = power_spectrum(spectrum, mean + half - root + one, square)
        total = upper * high + (one - upper) * low
        by_height = two * mean * (upper * (high_next - high) + (one - upper) * (low_next - low))
        by_length = upper * high * high_slope + (one - upper) * low * low_slope
    return total, by_height, by_length


@wp.func
def hidden_share(cosine: Any, slope: Any):
    """Smith's Lambda of one direction for slopes with the deviation `slope`, and its derivative to ln(slope)."""
    half = type(cosine)(0.5)
    one = type(cosine)(1.0)
    sine = wp.max(wp.sqrt(sine_squared(cosine)), type(cosine)(LEAST_SINE))
    ratio = cosine / (sine * slope * wp.sqrt(type(cosine)(2.0)))
    u = wp.min(ratio, type(cosine)(LARGEST_SLOPE_RATIO))
    # Abramowitz and Stegun 7.1.26 for erfc(u) exp(u^2): within 1.5e-7.
    t = one / (one + type(cosine)(0.3275911) * u)
    p = type(cosine)(1.061405429) * t - type(cosine)(1.453152027)
    p = p * t + type(cosine)(1.421413741)
    p = p * t - type(cosine)(0.284496736)
    p = (p * t + type(cosine)(0.254829592)) * t
    bell = wp.exp(-u * u)
    over = bell / (wp.sqrt(type(cosine)(wp.pi)) * u)
    return half * (over - p * bell), half * over


@wp.func
def higher_amplitude(cosine: Any, bragg: Any, fresnel: Any, sign: Any):
    """Amplitude of the powers from the second on, complex: cos a +- sin^2 R^2 / cos; + for VV.

    R is Fresnel's coefficient, and a Bragg's amplitude.
    """
    return bragg * cosine + complex_product(fresnel, fresnel) * (sign * sine_squared(cosine) / cosine)


@wp.func
def higher_slope(cosine: Any, bragg_slope: Any, fresnel: Any, fresnel_slope: Any, sign: Any):
    """d higher_amplitude / d eps, complex."""
    two = type(cosine)(2.0)
    return bragg_slope * cosine + complex_product(fresnel, fresnel_slope) * (two * sign * sine_squared(cosine) / cosine)


# Long because of its arguments and of the list that it returns: one term and its slopes.
@wp.func
def i2em_single(
    polarization: int,
    spectrum: int,
    cosine: Any,
    cos_twist: Any,
    eps: Any,
    height: Any,
    length: Any,
):
    """Single scattering: sigma0 and its derivatives to eps_re, ln h and ln l; kh and kl are `height` and `length`."""
    one = type(cosine)(1.0)
    two = type(cosine)(2.0)
    q = refraction(cosine, eps)
    a_hh = amplitude_te(cosine, eps, q)
    a_vv = amplitude_tm(cosine, eps, q, factor_vv(cosine, Variant.STANDARD))
    d_hh = slope_te(cosine, q, a_hh)
    d_vv = slope_tm(cosine, eps, q, factor_vv(cosine, Variant.STANDARD), a_vv)
    # -R_v: the sign falls out of its square
    r_v = amplitude_tm(cosine, eps, q, cosine * cosine)
    dr_v = slope_tm(cosine, eps, q, cosine * cosine, r_v)
    first = turned(polarization, cos_twist, a_hh, a_vv)
    first_slope = turned(polarization, cos_twist, d_hh, d_vv)
    higher = turned(
        polarization,
        cos_twist,
        higher_amplitude(cosine, a_hh, a_hh, -one),
        higher_amplitude(cosine, a_vv, r_v, one),
    )
    higher_by_eps = turned(
        polarization,
        cos_twist,
        higher_slope(cosine, d_hh, a_hh, d_hh, -one),
        higher_slope(cosine, d_vv, r_v, dr_v, one),
    )
    cos2 = cosine * cosine
    mean = type(cosine)(4.0) * height * height * cos2
    square = type(cosine)(4.0) * sine_squared(cosine) * length * length
    total, by_height, by_length = poisson_series(2, TOLERANCE, spectrum, mean, square)
    value, slope = power_spectrum(spectrum, one, square)
    bragg = two * cos2 * mean * wp.exp(-mean) * value
    bragg_power = wp.dot(first, first)
    higher_power = wp.dot(higher, higher)
    scale = turned_share(polarization, cos_twist) * length * length
    return (
        scale * (bragg * bragg_power + two * total * higher_power),
        scale * two * (bragg * wp.dot(first, first_slope) + two * total * wp.dot(higher, higher_by_eps)),
        scale * (bragg * two * (one - mean) * bragg_power + two * by_height * higher_power),
        scale * (bragg * slope * bragg_power + two * by_length * higher_power),
    )


@wp.func
def slope_deviation(spectrum: int, height: Any, length: Any):
    """Of the surface's slopes: h / l where the correlation is exponential, which has no slopes of its own."""
    deviation = height / length
    if spectrum == Spectrum.GAUSSIAN:
        deviation = deviation * wp.sqrt(type(height)(2.0))
    return deviation


@wp.func
def complex_decaying_root(re: Any, im: Any):
    """Square root with its imaginary part below 0, for im < 0; finite on both sides of re = 0."""
    half = type(re)(0.5)
    zero = type(re)(0.0)
    large = wp.sqrt((wp.sqrt(re * re + im * im) + wp.abs(re)) * half)
    small = half * im / large
    return wp.vector(wp.where(re < zero, -small, large), wp.where(re < zero, -large, small))


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
            part, part_by_height, part_by_length = spoke_series(j, CROSSED_TOLERANCE, spectrum, rho2, sine, mean, area)
            series += part
            series_by_height += part_by_height
            series_by_length += part_by_length
        total += power * series
        by_eps += power_by_eps * series
        by_height += power * series_by_height
        by_length += power * series_by_length
    scale = multiple_scale(cosine, length)
    return scale * total, scale * by_eps, scale * by_height, scale * by_length


@wp.func
def i2em(
    polarization: int,
    spectrum: int,
    cosine: Any,
    cos_twist: Any,
    eps: Any,
    height: Any,
    length: Any,
):
    """I2EM: single and, in HV, multiple scattering, less what lies in shadow."""
    one = type(cosine)(1.0)
    two = type(cosine)(2.0)
    value, by_eps, by_height, by_length = i2em_single(polarization, spectrum, cosine, cos_twist, eps, height, length)
    hidden, hidden_by_slope = hidden_share(cosine, slope_deviation(spectrum, height, length))
    # Fung's: both ways where the path is single, one way where it is not
    seen = one / (one + two * hidden)
    seen_by_slope = -two * hidden_by_slope * seen
    by_eps = by_eps * seen
    by_height = (by_height + value * seen_by_slope) * seen
    by_length = (by_length - value * seen_by_slope) * seen
    value = value * seen
    if is_crossed(polarization):
        more, more_by_eps, more_by_height, more_by_length = i2em_multiple(spectrum, cosine, eps, height, length)
        once = one / (one + hidden)
        once_by_slope = -hidden_by_slope * once
        value += more * once
        by_eps += more_by_eps * once
        by_height += (more_by_height + more * once_by_slope) * once
        by_length += (more_by_length - more * once_by_slope) * once
    return value, by_eps, by_height, by_length


@wp.func
def sigma0_and_slopes_of(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: Any,
    cos_incidence: Any,
    cos_twist: Any,
    cos2_azimuth: Any,
    eps_im: Any,
    aspect: Any,
    zeta: Any,
):
    """sigma0, and its derivatives to the learned coordinates."""
    one = type(wavenumber)(1.0)
    eps_re = one + wp.exp(zeta[Coordinate.EPS])
    value, by_eps, by_height, by_length = i2em(
        polarization,
        spectrum,
        bounded_cosine(cos_incidence),
        cos_twist,
        wp.vector(eps_re, -eps_im),
        wavenumber * wp.exp(zeta[Coordinate.HEIGHT]),
        wavenumber * wp.exp(zeta[Coordinate.LENGTH]),
    )
    return wp.vector(value, by_eps * (eps_re - one), by_height, by_length, type(wavenumber)(0.0))


@wp.func
def parts_of(
    lookup: Lookup,
    row: int,
    material: int,
    k: wp.float64,
    cosine: wp.float64,
    spectrum: int,
    permittivity: wp.vec2d,
    rms_height: wp.float64,
    length: wp.float64,
) -> Parts:
    """The terms of `i2em_single` less what lies in shadow, and double scattering from its table."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    four = wp.float64(4.0)
    eps = permittivity
    kh = k * rms_height
    kl = k * length
    q = refraction(cosine, eps)
    a_hh = amplitude_te(cosine, eps, q)
    a_vv = amplitude_tm(cosine, eps, q, factor_vv(cosine, int(Variant.STANDARD)))
    r_v = amplitude_tm(cosine, eps, q, cosine * cosine)  # -R_v: the sign falls out of its square
    mean = four * kh * kh * cosine * cosine
    square = four * sine_squared(cosine) * kl * kl
    total, _by_height, _by_length = poisson_series(2, TOLERANCE, spectrum, mean, square)
    value, _slope = power_spectrum(spectrum, one, square)
    hidden, _by_slope = hidden_share(cosine, slope_deviation(spectrum, kh, kl))
    scale = two * kl * kl / (one + two * hidden)
    first = wp.sqrt(scale * cosine * cosine * mean * wp.exp(-mean) * value)
    higher = wp.sqrt(scale * total)
    twice = interpolated(lookup.twice, row, float(cosine), DOUBLE)
    found = Parts()
    found.first_hh = first * a_hh
    found.first_vv = first * a_vv
    found.second_hh = higher * higher_amplitude(cosine, a_hh, a_hh, -one)
    found.second_vv = higher * higher_amplitude(cosine, a_vv, r_v, one)
    found.crossed = cosine * wp.sqrt(wp.exp(wp.float64(twice[0])))
    return found
