"""Dubois, van Zyl and Engman 1995, fitted to bare soils; HH and VV alone (docs/scattering-checks.md)."""

from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate
from warpsar.kernels.empirical import turned_power
from warpsar.kernels.scattering import bounded_cosine, sine_squared

# cos of 80 and of 10 degrees: Dubois' model is held beyond them, where it has no bound.
DUBOIS_LOW = wp.constant(0.17364817766693036)
DUBOIS_HIGH = wp.constant(0.984807753012208)
DUBOIS_MOST = wp.constant(60.0)  # of ln(sigma0), which grows with eps' tan(theta) and would leave float32


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
    value, by_eps, by_height, by_length = dubois(
        polarization,
        wavenumber,
        bounded_cosine(cos_incidence),
        cos_twist,
        eps_re,
        wavenumber * wp.exp(zeta[Coordinate.HEIGHT]),
    )
    return wp.vector(value, by_eps * (eps_re - one), by_height, by_length, type(wavenumber)(0.0))
