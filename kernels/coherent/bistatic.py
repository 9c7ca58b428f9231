"""What a rough plane scatters of a plane wave to another direction (docs/checks.md, multiple bounces)."""

import warp as wp

from warpsar.kernels.codes import Spectrum
from warpsar.kernels.coherent.numbers import product
from warpsar.kernels.coherent.reflection import Face, Field, reflected
from warpsar.kernels.scattering import mirror_lobe, roughness_spectrum

PI = wp.constant(wp.float64(3.141592653589793))
ORDERS = wp.constant(64)
"""Powers of a surface's correlation that are added up."""
HEIGHTS = wp.constant(wp.float64(10.0))
"""Correlation length in rms heights where a model has none: slopes of 8 degrees, as of bare soil."""
MANY = wp.constant(wp.float64(30.0))
"""(q_z h)^2 from which on a surface is taken at the limit of all powers, geometric optics."""


@wp.func
def tangential(n: wp.vec3d, a: wp.vec3d) -> wp.vec3d:
    return a - wp.dot(n, a) * n


@wp.func
def first_order(
    face: Face, k: wp.float64, field: Field, d: wp.vec3d, n: wp.vec3d, s: wp.vec3d, p: wp.vec3d
) -> wp.vec2d:
    """(eps - 1) (E_t . F_t + E_n F_n / eps): small perturbation of first order, for a unit of height.

    E is the whole field over the plane surface, F that of a wave `p` which the radar would send (reciprocity).
    """
    two = wp.float64(2.0)
    out = d - two * wp.dot(n, d) * n
    back = reflected(face, k, field, d, n, out)
    sent = Field()
    sent.re = p
    answer = reflected(face, k, sent, -s, n, -s + two * wp.dot(n, s) * n)
    e_re = field.re + back.re
    e_im = field.im + back.im
    f_re = sent.re + answer.re
    f_im = answer.im
    level_re = wp.dot(tangential(n, e_re), f_re) - wp.dot(tangential(n, e_im), f_im)
    level_im = wp.dot(tangential(n, e_re), f_im) + wp.dot(tangential(n, e_im), f_re)
    upright = product(wp.vec2d(wp.dot(n, e_re), wp.dot(n, e_im)), wp.vec2d(wp.dot(n, f_re), wp.dot(n, f_im)))
    eps = face.permittivity
    inverse = wp.vec2d(eps[0], -eps[1]) / wp.dot(eps, eps)
    total = wp.vec2d(level_re, level_im) + product(upright, inverse)
    return product(eps - wp.vec2d(wp.float64(1.0), wp.float64(0.0)), total)


@wp.func
def mirrored(face: Face, k: wp.float64, field: Field, d: wp.vec3d, s: wp.vec3d, p: wp.vec3d) -> wp.vec2d:
    """What a facet across the half vector mirrors to the radar."""
    back = reflected(face, k, field, d, wp.normalize(s - d), s)
    return wp.vec2d(wp.dot(back.re, p), wp.dot(back.im, p))


@wp.func
def higher_orders(
    spectrum: int, x: wp.float64, across: wp.float64, length: wp.float64, log_factorial: wp.array(dtype=wp.float64)
) -> wp.float64:
    """exp(-x) SUM x^n / n! W_n from n = 2 on, W_n being the transform of the n-th power of the correlation [m2].

    x = (q_z h)^2; `across`: the part of q in the surface [1/m].
    """
    total = wp.float64(0.0)
    for n in range(2, ORDERS):
        order = wp.float64(n)
        weight = wp.exp(order * wp.log(x) - log_factorial[n] - x)
        if spectrum == Spectrum.GAUSSIAN:
            t = across * across * length * length / (wp.float64(4.0) * order)
            total += weight * PI * length * length / order * wp.exp(-t)
        else:
            t = across * length / order
            root = wp.sqrt(wp.float64(1.0) + t * t)
            total += weight * wp.float64(2.0) * PI * length * length / (order * order * root * root * root)
    return total


@wp.func
def azimuth_cos2(q: wp.vec3d, n: wp.vec3d) -> wp.float64:
    """Of the angle between the part of `q` in a facet and the facet's x axis, as in kernels/geometry.py."""
    x = wp.vec3d(-n[1], n[0], wp.float64(0.0))
    if wp.length(x) < wp.float64(1.0e-6):
        x = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    along = q - wp.dot(q, n) * n
    if wp.length(along) <= wp.float64(1.0e-6) * wp.length(q):
        return wp.float64(1.0)
    ratio = wp.dot(wp.normalize(along), wp.normalize(x))
    return ratio * ratio


@wp.func
def diffuse_shares(
    spectrum: int,
    q: wp.vec3d,
    n: wp.vec3d,
    cos2: wp.float64,
    k: wp.float64,
    h: wp.float64,
    length_x: wp.float64,
    length_y: wp.float64,
    tau: wp.float64,
    log_factorial: wp.array(dtype=wp.float64),
) -> wp.vec2d:
    """The factors on |`first_order`|^2 and on |`mirrored`|^2, whose sum is the bistatic coefficient.

    `q`: k times the difference of the directions [1/m]; `cos2`: of the angle between its part in the surface and the
    facet's x axis; `tau`: the share of geometric optics.
    """
    one = wp.float64(1.0)
    upright = wp.dot(q, n)
    size2 = wp.dot(q, q)
    across2 = wp.max(size2 - upright * upright, wp.float64(0.0))
    x = upright * upright * h * h
    mean_length = wp.sqrt(length_x * length_y)
    height_spectrum = roughness_spectrum(spectrum, across2, cos2, h, length_x, length_y)
    diffuse = PI * k * k * k * k * height_spectrum * wp.exp(-x)
    tilt = upright / wp.sqrt(size2)
    optics = mirror_lobe(tilt, wp.float64(2.0) * h * h / (mean_length * mean_length))
    lobe = one * optics
    if x < MANY:
        series = higher_orders(spectrum, x, wp.sqrt(across2), mean_length, log_factorial)
        lobe = size2 * size2 / (wp.float64(4.0) * PI * upright * upright) * series
    return wp.vec2d((one - tau) * diffuse, (one - tau) * lobe + tau * optics)
