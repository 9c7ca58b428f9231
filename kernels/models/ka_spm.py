"""The default model: first-order small perturbation and geometric optics, mixed (docs/physics.md).

Its equations are those of kernels/scattering.py, which other models share in part.
"""

from typing import Any

import warp as wp

from warpsar.kernels.codes import FRACTION_LIMIT, Coordinate
from warpsar.kernels.scattering import sigma0, sigma0_and_slopes

LAUNCH_BOUNDS = (256, 6)


@wp.func
def fraction_of(logit: Any):
    one = type(logit)(1.0)
    value = type(logit)(0.0)
    if logit >= type(logit)(FRACTION_LIMIT):
        value = one
    elif logit > type(logit)(-FRACTION_LIMIT):
        value = one / (one + wp.exp(-logit))
    return value


@wp.func
def sigma0_of(
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
    """sigma0 alone: without its slopes it costs half."""
    length = wp.exp(zeta[Coordinate.LENGTH])
    return sigma0(
        polarization,
        spectrum,
        variant,
        wavenumber,
        cos_incidence,
        cos_twist,
        type(length)(1.0) + wp.exp(zeta[Coordinate.EPS]),
        eps_im,
        wp.exp(zeta[Coordinate.HEIGHT]),
        length,
        aspect * length,
        cos2_azimuth,
        fraction_of(zeta[Coordinate.FRACTION]),
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
    length = wp.exp(zeta[Coordinate.LENGTH])
    return sigma0_and_slopes(
        polarization,
        spectrum,
        variant,
        wavenumber,
        cos_incidence,
        cos_twist,
        type(length)(1.0) + wp.exp(zeta[Coordinate.EPS]),
        eps_im,
        wp.exp(zeta[Coordinate.HEIGHT]),
        length,
        aspect * length,
        cos2_azimuth,
        fraction_of(zeta[Coordinate.FRACTION]),
    )
