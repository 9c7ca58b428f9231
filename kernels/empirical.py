"""Empirical backscatter of bare soil, as differentiable Warp functions (docs/scattering.md).

Functions are generic over float32 and float64. They know sigma0 of HH, VV and HV for level ground. A facet that is
turned about the line of sight mixes their roots, as if HH and VV were fully correlated.
"""

from typing import Any

import warp as wp

from warpsar.kernels.scattering import is_crossed, sine_squared, turned, turned_share

# Below this moisture Oh's model and its slopes are held: Topp's polynomial reaches 0 at eps' = 1.9.
DRIEST = wp.constant(0.01)
# cos of 80 and of 10 degrees: Dubois' model is held beyond them, where it has no bound.
DUBOIS_LOW = wp.constant(0.17364817766693036)
DUBOIS_HIGH = wp.constant(0.984807753012208)
DUBOIS_MOST = wp.constant(60.0)  # of ln(sigma0), which grows with eps' tan(theta) and would leave float32


@wp.func
def power(base: Any, exponent: Any):
    return wp.exp(exponent * wp.log(base))


@wp.func
def topp_moisture(eps_re: Any):
    """Volumetric moisture [m^3/m^3] by Topp, Davis and Annan 1980, and its slope; held below DRIEST."""
    one = type(eps_re)(1.0)
    cubic = type(eps_re)(4.3e-6)
    square = type(eps_re)(-5.5e-4)
    linear = type(eps_re)(2.92e-2)
    moisture = ((cubic * eps_re + square) * eps_re + linear) * eps_re - type(eps_re)(5.3e-2)
    slope = (type(eps_re)(3.0) * cubic * eps_re + type(eps_re)(2.0) * square) * eps_re + linear
    driest = type(eps_re)(DRIEST)
    if moisture < driest:
        moisture = driest
        slope = slope * (one - one)
    return moisture, slope


@wp.func
def turned_power(polarization: int, cos_twist: Any, hh: Any, vv: Any, hv: Any, d_hh: Any, d_vv: Any, d_hv: Any):
    """A channel's sigma0 from those of level ground, and its derivative where d_hh, d_vv and d_hv are theirs of the ln.

    HV of level ground does not turn.
    """
    half = type(hh)(0.5)
    two = type(hh)(2.0)
    root_hh = wp.sqrt(hh)
    root_vv = wp.sqrt(vv)
    amplitude = turned(polarization, cos_twist, root_hh, root_vv)
    change = turned(polarization, cos_twist, half * d_hh * root_hh, half * d_vv * root_vv)
    share = turned_share(polarization, cos_twist)
    value = share * amplitude * amplitude
    slope = share * two * amplitude * change
    if is_crossed(polarization):
        value += hv
        slope += hv * d_hv
    return value, slope


@wp.func
def oh(polarization: int, cosine: Any, cos_twist: Any, eps_re: Any, height: Any):
    """Oh 2004 with Topp's moisture: sigma0 and its derivatives to eps_re, ln h and ln l (none); `height` is kh."""
    one = type(cosine)(1.0)
    zero = type(cosine)(0.0)
    moisture, by_eps = topp_moisture(eps_re)
    by_eps = by_eps / moisture  # d ln(moisture) / d eps
    theta = wp.atan2(wp.sqrt(sine_squared(cosine)), cosine)
    # p = HH / VV
    bend = power(height, type(cosine)(1.4)) * type(cosine)(0.4)
    dry = type(cosine)(0.35) * power(moisture, type(cosine)(-0.65))
    log_angle = wp.log(wp.max(theta, type(cosine)(1.0e-6)) * type(cosine)(2.0 / wp.pi))
    lost = wp.exp(dry * log_angle - bend)
    p = wp.max(one - lost, type(cosine)(1.0e-6))
    p_by_moisture = lost * dry * log_angle * type(cosine)(0.65) / p
    p_by_height = lost * bend * type(cosine)(1.4) / p
    # q = HV / VV
    rough = power(height, type(cosine)(0.9)) * type(cosine)(1.3)
    bent = wp.exp(-rough)
    filled = one - bent
    wide = type(cosine)(0.13) + wp.sin(type(cosine)(1.5) * theta)
    q = type(cosine)(0.095) * power(wide, type(cosine)(1.4)) * filled
    q_by_height = bent * rough * type(cosine)(0.9) / filled
    # HV
    steep = power(height, type(cosine)(1.8)) * type(cosine)(0.32)
    sunk = wp.exp(-steep)
    risen = one - sunk
    wet = type(cosine)(0.11) * power(moisture, type(cosine)(0.7))
    hv = wet * power(cosine, type(cosine)(2.2)) * risen
    hv_by_height = sunk * steep * type(cosine)(1.8) / risen
    vv = hv / q
    vv_by_height = hv_by_height - q_by_height
    wetter = type(cosine)(0.7)
    value, by_moisture = turned_power(polarization, cos_twist, p * vv, vv, hv, wetter + p_by_moisture, wetter, wetter)
    _value, by_height = turned_power(
        polarization, cos_twist, p * vv, vv, hv, vv_by_height + p_by_height, vv_by_height, hv_by_height
    )
    return value, by_moisture * by_eps, by_height, zero


@wp.func
def dubois(polarization: int, wavenumber: Any, cosine: Any, cos_twist: Any, eps_re: Any, height: Any):
    """Dubois, van Zyl and Engman 1995, with their correction: as `oh`; HV of level ground is none."""
    ten = type(cosine)(2.302585092994046)  # ln 10
    zero = type(cosine)(0.0)
    c = wp.clamp(cosine, type(cosine)(DUBOIS_LOW), type(cosine)(DUBOIS_HIGH))
    log_cosine = wp.log(c)
    log_sine = type(cosine)(0.5) * wp.log(sine_squared(c))
    tangent = wp.exp(log_sine - log_cosine)
    log_height = wp.log(height) + log_sine
    # their wavelength is in centimetres
    log_wave = type(cosine)(0.7) * wp.log(type(cosine)(200.0 * wp.pi) / wavenumber)
    h_by_eps = type(cosine)(0.028) * ten * tangent
    v_by_eps = type(cosine)(0.046) * ten * tangent
    log_hh = (
        type(cosine)(-2.75) * ten
        + type(cosine)(1.5) * log_cosine
        - type(cosine)(5.0) * log_sine
        + h_by_eps * eps_re
        + type(cosine)(1.4) * log_height
        + log_wave
    )
    log_vv = (
        type(cosine)(-2.35) * ten
        + type(cosine)(3.0) * log_cosine
        - type(cosine)(3.0) * log_sine
        + v_by_eps * eps_re
        + type(cosine)(1.1) * log_height
        + log_wave
    )
    hh = wp.exp(wp.min(log_hh, type(cosine)(DUBOIS_MOST)))
    vv = wp.exp(wp.min(log_vv, type(cosine)(DUBOIS_MOST)))
    value, by_eps = turned_power(polarization, cos_twist, hh, vv, zero, h_by_eps, v_by_eps, zero)
    _value, by_height = turned_power(polarization, cos_twist, hh, vv, zero, type(cosine)(1.4), type(cosine)(1.1), zero)
    return value, by_eps, by_height, zero
