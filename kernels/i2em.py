"""Improved integral equation model (I2EM) in backscatter, as differentiable Warp functions (docs/scattering.md).

Sources: Fung, Li and Chen 1992 (IEM); Fung, Liu, Chen and Tsay 2002 (its phases); Fung and Chen 2010, chapters 3 and 4.
In backscatter the published coefficients come down to two amplitudes for each polarization: Bragg's for the first power
of the correlation, and one for all higher powers. tests/test_i2em.py holds them against the published coefficients.

Functions are generic over float32 and float64. Lengths are in units of 1/k. The series over the powers of the
correlation is a mean over a Poisson distribution; it ends where the distribution does.
"""

from typing import Any

import warp as wp

from warpsar.kernels.codes import Spectrum, Variant
from warpsar.kernels.scattering import (
    amplitude_te,
    amplitude_tm,
    complex_product,
    factor_vv,
    refraction,
    sine_squared,
    slope_te,
    slope_tm,
    turned,
    turned_share,
)

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
