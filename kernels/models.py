"""Backscatter models beside the default one: from the learned coordinates of a hit to its sigma0 and slopes.

`scattering.py` states the default, ka_spm. A further model is a function here or in a file of its own, and a branch in
`modelled`; kernels/models_lanes.py writes the CPU's vector code from it.
"""

from functools import cache
from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate, Model, Polarization
from warpsar.kernels.empirical import dubois, oh
from warpsar.kernels.i2em import hidden_share, i2em_single, slope_deviation
from warpsar.kernels.i2em_crossed import i2em_multiple
from warpsar.kernels.scattering import bounded_cosine, is_crossed
from warpsar.kernels.wide import read_float, read_int, read_vec4, write_vec4

# The series are loops: unrolled they would take minutes to compile.
wp.set_module_options({"max_unroll": 1})


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
def modelled(
    model: int,
    polarization: int,
    spectrum: int,
    wavenumber: Any,
    cos_theta: Any,
    cos_twist: Any,
    eps_re: Any,
    eps_im: Any,
    rms_height: Any,
    correlation_length: Any,
):
    """sigma0 by `model`, and its derivatives to ln(eps_re - 1), ln h, ln l, logit tau (none has one): a vector of five.

    Arguments are those of `scattering.sigma0`, but that surfaces are isotropic.
    """
    zero = type(cos_theta)(0.0)
    c = bounded_cosine(cos_theta)
    height = wavenumber * rms_height
    value = zero
    by_eps = zero
    by_height = zero
    by_length = zero
    if model == Model.I2EM:
        eps = wp.vector(eps_re, -eps_im)
        length = wavenumber * correlation_length
        value, by_eps, by_height, by_length = i2em(polarization, spectrum, c, cos_twist, eps, height, length)
    elif model == Model.OH:
        value, by_eps, by_height, by_length = oh(polarization, c, cos_twist, eps_re, height)
    elif model == Model.DUBOIS:
        value, by_eps, by_height, by_length = dubois(polarization, wavenumber, c, cos_twist, eps_re, height)
    return wp.vector(value, by_eps * (eps_re - type(cos_theta)(1.0)), by_height, by_length, zero)


@wp.func
def modelled_of(
    model: int,
    polarization: int,
    spectrum: int,
    wavenumber: float,
    cos_incidence: float,
    cos_twist: float,
    eps_im: float,
    zeta: wp.vec4,
):
    """`modelled` from the learned coordinates."""
    return modelled(
        model,
        polarization,
        spectrum,
        wavenumber,
        cos_incidence,
        cos_twist,
        1.0 + wp.exp(zeta[Coordinate.EPS]),
        eps_im,
        wp.exp(zeta[Coordinate.HEIGHT]),
        wp.exp(zeta[Coordinate.LENGTH]),
    )


@cache
def scatter_kernel(model: Model, polarization: Polarization, slopes: bool) -> wp.Kernel:
    """The kernel of sigma0 for the hits `mine`, whose materials have `model`; with `slopes` of its slopes too.

    There is a kernel for each. One kernel for all would take the registers of its longest branch, HV of I2EM, and be
    three times slower on a GPU.
    """
    model_code, polarization_code = int(model), int(polarization)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def scatter_kernel(
        # In:
        mine: wp.array(dtype=int),
        wavenumber: float,
        local_basis: int,
        face: wp.array(dtype=int),
        face_material: wp.array(dtype=int),
        cos_incidence: wp.array(dtype=float),
        cos_twist: wp.array(dtype=float),
        spectrum: wp.array(dtype=int),
        eps_im: wp.array(dtype=float),
        zeta: wp.array(dtype=wp.vec4),
        # Out:
        sigma_out: wp.array(dtype=float),
        slopes_out: wp.array(dtype=wp.vec4),
    ):
        i = read_int(mine, wp.tid())
        material = read_int(face_material, read_int(face, i))
        twist = read_float(cos_twist, i)
        if local_basis != 0:
            twist = 1.0
        found = modelled_of(
            wp.static(model_code),
            wp.static(polarization_code),
            read_int(spectrum, material),
            wavenumber,
            read_float(cos_incidence, i),
            twist,
            read_float(eps_im, material),
            read_vec4(zeta, i),
        )
        sigma_out[i] = found[0]
        if wp.static(slopes):
            write_vec4(slopes_out, i, wp.vec4(found[1], found[2], found[3], found[4]))

    return scatter_kernel
