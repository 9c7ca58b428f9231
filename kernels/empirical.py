"""What models of backscatter that know powers alone have in common, as differentiable Warp functions.

Functions are generic over float32 and float64. Such models know sigma0 of HH, VV and HV for level ground. A facet that
is turned about the line of sight mixes their roots, as if HH and VV were fully correlated.
"""

from typing import Any

import warp as wp

from warpsar.kernels.scattering import is_crossed, turned, turned_share

# Below this moisture Oh's model and its slopes are held: Topp's polynomial reaches 0 at eps' = 1.9.
DRIEST = wp.constant(0.01)


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
