"""Small perturbation on tilted facets, in closed form: roughness at two scales (docs/scattering-checks.md).

Sources: Valenzuela 1968 and Wright 1968 (Bragg's waves on tilted facets). Slopes of the large scale are Gaussian, of
one variance v along both axes. The slope t in the plane of incidence is at three Gauss-Hermite points. The slope
across it turns the facet's basis about the line of sight, by angles of variance w = v / (sin - t cos)^2: means of
cos 2 psi and cos 4 psi over a Gaussian are exp(-2 w) and exp(-8 w). It also lowers the facet's cosine, to first order
in v.

The effect `two_scale` has the same mean over tilts by a quadrature of 25 points, for surfaces of `ka_spm`.
"""

from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate, Variant
from warpsar.kernels.empirical import turned_power
from warpsar.kernels.scattering import (
    amplitude_te,
    amplitude_tm,
    bounded_cosine,
    complex_inverse,
    complex_product,
    factor_vv,
    refraction,
    roughness_spectrum,
    sine_squared,
    slope_te,
    slope_tm,
    spectrum_slope,
)

# Place of ln(slope variance) among the learned coordinates: that of a specular fraction, which the model has not.
SLOPE = wp.constant(3)
# Gauss-Hermite points at 0 and +-sqrt(3), in standard deviations, and their weights.
OUTER = wp.constant(1.7320508075688772)
INNER_WEIGHT = wp.constant(2.0 / 3.0)
OUTER_WEIGHT = wp.constant(1.0 / 6.0)
# Keeps the turn's variance finite where a facet looks into the radar.
LEAST_SQUARE = wp.constant(1.0e-6)
# Below it 1 - exp(-x) is taken from its series, which float32 asks for.
SERIES_BELOW = wp.constant(0.03)
# Least power that a slope is divided by: without contrast, or where a spectrum underflows, both are 0.
LEAST_POWER = wp.constant(1.0e-30)


@wp.func
def lost(x: Any):
    """1 - exp(-x) without its cancellation at small x."""
    one = type(x)(1.0)
    half = type(x)(0.5)
    series = x * (one - half * x * (one - x / type(x)(3.0)))
    return wp.where(x < type(x)(SERIES_BELOW), series, one - wp.exp(-x))


@wp.func
def te_by_cosine(q: Any, amplitude: Any):
    """d amplitude_te / d cos theta, complex: -2 a / q."""
    return complex_product(amplitude, complex_inverse(q)) * type(q[0])(-2.0)


@wp.func
def vv_by_cosine(cosine: Any, eps: Any, q: Any, amplitude: Any):
    """d a_vv / d cos theta, complex, where `amplitude` is a_vv."""
    two = type(cosine)(2.0)
    inverse = complex_inverse(eps * cosine + q)
    ratio = complex_product(wp.vector(eps[0] - type(cosine)(1.0), eps[1]), inverse)
    growth = complex_product(eps + complex_inverse(q) * cosine, inverse)
    return complex_product(ratio, ratio) * (two * cosine) - complex_product(amplitude, growth) * two


@wp.func
def mean_powers(mean: Any, half: Any, double_turn: Any, crossed_share: Any):
    """|S|^2 in HH, VV and HV over the turns; mean and half: (a_hh + a_vv) / 2 and (a_hh - a_vv) / 2.

    double_turn: the mean of cos 2 psi; crossed_share: of sin^2 2 psi.
    """
    one = type(double_turn)(1.0)
    both = wp.dot(mean, mean)
    beat = type(double_turn)(2.0) * wp.dot(mean, half) * double_turn
    apart = wp.dot(half, half)
    kept = both + apart * (one - crossed_share)
    return wp.vector(kept + beat, kept - beat, apart * crossed_share)


@wp.func
def powers_by(mean: Any, half: Any, by_mean: Any, by_half: Any, double_turn: Any, crossed_share: Any):
    """The change of `mean_powers` with that of its amplitudes."""
    one = type(double_turn)(1.0)
    two = type(double_turn)(2.0)
    both = two * wp.dot(mean, by_mean)
    beat = two * (wp.dot(by_mean, half) + wp.dot(mean, by_half)) * double_turn
    apart = two * wp.dot(half, by_half)
    kept = both + apart * (one - crossed_share)
    return wp.vector(kept + beat, kept - beat, apart * crossed_share)


# Long because of the slopes: one facet's powers and how they change.
@wp.func
def tilted(spectrum: int, cosine: Any, point: Any, eps: Any, height: Any, length: Any, variance: Any):
    """HH, VV and HV of the facets whose slope in the plane of incidence is `point` standard deviations.

    Returns the three powers, and their derivatives to eps_re, ln l and ln(variance); kh and kl are `height` and
    `length`. Those to ln h are twice the powers.
    """
    one = type(cosine)(1.0)
    half = type(cosine)(0.5)
    two = type(cosine)(2.0)
    four = type(cosine)(4.0)
    sine = wp.sqrt(sine_squared(cosine))
    slope = point * wp.sqrt(variance)
    stretch = one + slope * slope + variance
    root = wp.sqrt(stretch)
    c = bounded_cosine((cosine + slope * sine) / root)
    by_tilt = half * slope * sine / root - half * c * (slope * slope + variance) / stretch  # d c / d ln(variance)

    across = sine - slope * cosine
    square = across * across + type(cosine)(LEAST_SQUARE)
    turn = variance / square
    turn_by_tilt = turn * (one + across * slope * cosine / square)
    double_turn = wp.exp(-two * turn)
    crossed_share = half * lost(type(cosine)(8.0) * turn)
    crossed_by_tilt = four * wp.exp(-type(cosine)(8.0) * turn) * turn_by_tilt

    q = refraction(c, eps)
    a_hh = amplitude_te(c, eps, q)
    factor = factor_vv(c, Variant.STANDARD)
    a_vv = amplitude_tm(c, eps, q, factor)
    mean = (a_hh + a_vv) * half
    apart = (a_hh - a_vv) * half
    d_hh = slope_te(c, q, a_hh)
    d_vv = slope_tm(c, eps, q, factor, a_vv)
    c_hh = te_by_cosine(q, a_hh)
    c_vv = vv_by_cosine(c, eps, q, a_vv)

    sin2 = sine_squared(c)
    w = roughness_spectrum(spectrum, four * sin2, one, height, length, length)
    by_length = spectrum_slope(spectrum, four * sin2, one, length, length)
    scale = type(cosine)(16.0) * type(cosine)(wp.pi) * c * c * c * c * w
    scale_by_cosine = four / c + (two - by_length) * c / wp.max(sin2, type(cosine)(LEAST_SQUARE))

    powers = mean_powers(mean, apart, double_turn, crossed_share)
    by_eps = powers_by(mean, apart, (d_hh + d_vv) * half, (d_hh - d_vv) * half, double_turn, crossed_share)
    by_cosine = powers_by(mean, apart, (c_hh + c_vv) * half, (c_hh - c_vv) * half, double_turn, crossed_share)
    beat = -four * wp.dot(mean, apart) * double_turn * turn_by_tilt
    gone = wp.dot(apart, apart) * crossed_by_tilt
    turning = wp.vector(beat - gone, -beat - gone, gone)
    by_variance = (powers * scale_by_cosine + by_cosine) * by_tilt + turning
    return powers * scale, by_eps * scale, powers * (by_length * scale), by_variance * scale


@wp.func
def turned_mean(polarization: int, cos_twist: Any, powers: Any, slopes: Any):
    """A channel of a facet that is turned about the line of sight, and its slope; given those of level ground."""
    least = type(cos_twist)(LEAST_POWER)
    return turned_power(
        polarization,
        cos_twist,
        powers[0],
        powers[1],
        powers[2],
        slopes[0] / wp.max(powers[0], least),
        slopes[1] / wp.max(powers[1], least),
        slopes[2] / wp.max(powers[2], least),
    )


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
    two = type(wavenumber)(2.0)
    zero = type(wavenumber)(0.0)
    outer = type(wavenumber)(OUTER)
    inner_weight = type(wavenumber)(INNER_WEIGHT)
    outer_weight = type(wavenumber)(OUTER_WEIGHT)
    eps_re = one + wp.exp(zeta[Coordinate.EPS])
    eps = wp.vector(eps_re, -eps_im)
    height = wavenumber * wp.exp(zeta[Coordinate.HEIGHT])
    length = wavenumber * wp.exp(zeta[Coordinate.LENGTH])
    variance = wp.exp(zeta[SLOPE])
    cosine = bounded_cosine(cos_incidence)
    p0, e0, l0, v0 = tilted(spectrum, cosine, zero, eps, height, length, variance)
    p1, e1, l1, v1 = tilted(spectrum, cosine, outer, eps, height, length, variance)
    p2, e2, l2, v2 = tilted(spectrum, cosine, -outer, eps, height, length, variance)
    p = p0 * inner_weight + (p1 + p2) * outer_weight
    e = e0 * inner_weight + (e1 + e2) * outer_weight
    by_l = l0 * inner_weight + (l1 + l2) * outer_weight
    v = v0 * inner_weight + (v1 + v2) * outer_weight
    value, by_eps = turned_mean(polarization, cos_twist, p, e)
    _l, by_length = turned_mean(polarization, cos_twist, p, by_l)
    _v, by_variance = turned_mean(polarization, cos_twist, p, v)
    return wp.vector(value, by_eps * (eps_re - one), two * value, by_length, by_variance)
