"""Oh 2004, fitted to bare soils, with the moisture of Topp, Davis and Annan 1980 (docs/scattering-checks.md)."""

from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate
from warpsar.kernels.empirical import power, topp_moisture, turned_power
from warpsar.kernels.scattering import bounded_cosine, sine_squared


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
    value, by_eps, by_height, by_length = oh(
        polarization,
        bounded_cosine(cos_incidence),
        cos_twist,
        eps_re,
        wavenumber * wp.exp(zeta[Coordinate.HEIGHT]),
    )
    return wp.vector(value, by_eps * (eps_re - one), by_height, by_length, type(wavenumber)(0.0))
