"""Microwave backscatter of a rough dielectric facet as differentiable Warp functions (docs/physics.md).

Functions are generic over float32 and float64: all floating arguments of one call have the same type. The
permittivity is eps = eps_re - j eps_im with eps_re >= 1, eps_im >= 0. Angles are to the facet's normal and
come as cosines, so a hit's geometry needs no inverse trigonometry. Complex numbers are vectors (re, im).

Every value and every derivative is finite for 0 <= cos_theta <= 1, h > 0, l > 0: at eps_im = 0, at
specular_fraction 0 and 1, and where an exponential underflows.
"""

from typing import Any

import warp as wp

# Channel of the radar, receive and transmit; HV and VH are equal by reciprocity.
HH = wp.constant(0)
VV = wp.constant(1)
HV = wp.constant(2)
VH = wp.constant(3)

# Roughness spectrum of the small-perturbation term; SEPARABLE is the paper's equation (16).
GAUSSIAN = wp.constant(0)
EXPONENTIAL = wp.constant(1)
SEPARABLE = wp.constant(2)

# Equations as derived, or with the constant of the paper's (13) and the amplitude of its (18).
STANDARD = wp.constant(0)
AS_PRINTED = wp.constant(1)

# Less than 0.21 arcseconds from grazing counts as 0.21: keeps 1/cos^4 and its derivative finite in float32.
MIN_COS_INCIDENCE = wp.constant(1.0e-6)


@wp.func
def complex_product(a: Any, b: Any):
    return wp.vector(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.func
def complex_inverse(a: Any):
    inverse = type(a[0])(1.0) / wp.dot(a, a)
    return wp.vector(a[0] * inverse, -a[1] * inverse)


@wp.func
def complex_root(re: Any, im: Any):
    """Principal square root for a positive real part; smooth there, across the real axis too."""
    half = type(re)(0.5)
    root = wp.sqrt((wp.sqrt(re * re + im * im) + re) * half)
    return wp.vector(root, half * im / root)


@wp.func
def bounded_cosine(cosine: Any):
    return wp.clamp(cosine, type(cosine)(MIN_COS_INCIDENCE), type(cosine)(1.0))


@wp.func
def sine_squared(cosine: Any):
    """1 - cos^2 without its cancellation near cos = 1."""
    one = type(cosine)(1.0)
    return (one - cosine) * (one + cosine)


@wp.func
def refraction(cos_theta: Any, eps: Any):
    """Complex q = sqrt(eps - sin^2 theta), sqrt(eps) times the cosine of the transmitted wave's angle."""
    return complex_root((eps[0] - type(cos_theta)(1.0)) + cos_theta * cos_theta, eps[1])


@wp.func
def amplitude_te(cos_theta: Any, eps: Any, q: Any):
    """Fresnel's R_h and the Bragg amplitude a_hh, complex: (cos - q) / (cos + q) = (1 - eps) / (cos + q)^2.

    The second form has no cancellation for eps near 1 or theta near 90 degrees.
    """
    inverse = complex_inverse(wp.vector(cos_theta + q[0], q[1]))
    contrast = wp.vector(type(cos_theta)(1.0) - eps[0], -eps[1])
    return complex_product(complex_product(contrast, inverse), inverse)


@wp.func
def amplitude_tm(cos_theta: Any, eps: Any, q: Any, factor: Any):
    """Complex (eps - 1) (sin^2 - eps factor) / (eps cos + q)^2.

    The Bragg amplitude a_vv for factor = 1 + sin^2; minus Fresnel's R_v for factor = cos^2.
    """
    inverse = complex_inverse(eps * cos_theta + q)
    contrast = wp.vector(eps[0] - type(cos_theta)(1.0), eps[1])
    numerator = wp.vector(sine_squared(cos_theta) - factor * eps[0], -factor * eps[1])
    return complex_product(complex_product(contrast, inverse), complex_product(numerator, inverse))


@wp.func
def amplitude_vv(cos_theta: Any, eps: Any, q: Any, variant: int):
    """Bragg amplitude a_vv, complex; a_hh at theta = 0. AS_PRINTED is the paper's (18), which is -R_v."""
    factor = type(cos_theta)(1.0) + sine_squared(cos_theta)
    if variant == AS_PRINTED:
        factor = cos_theta * cos_theta
    return amplitude_tm(cos_theta, eps, q, factor)


@wp.func
def fresnel_h(cos_theta: Any, eps_re: Any, eps_im: Any):
    """Power reflectivity |R_h(theta)|^2 of the smooth interface, field across the plane of incidence."""
    c = bounded_cosine(cos_theta)
    eps = wp.vector(eps_re, -eps_im)
    r = amplitude_te(c, eps, refraction(c, eps))
    return wp.dot(r, r)


@wp.func
def fresnel_v(cos_theta: Any, eps_re: Any, eps_im: Any):
    """Power reflectivity |R_v(theta)|^2 of the smooth interface, field in the plane of incidence."""
    c = bounded_cosine(cos_theta)
    eps = wp.vector(eps_re, -eps_im)
    r = amplitude_tm(c, eps, refraction(c, eps), c * c)
    return wp.dot(r, r)


@wp.func
def geometric_optics(reflectivity: Any, cos_tilt: Any, slope_variance: Any):
    """Kirchhoff coefficient in geometric optics: reflectivity exp(-tan^2 / (2 m^2)) / (2 m^2 cos^4).

    cos_tilt: of the angle between the normal and the half vector of the two directions (backscatter: theta);
    slope_variance: m^2 of the surface's slopes, per axis.
    """
    c = bounded_cosine(cos_tilt)
    half = type(c)(0.5)
    p = half / slope_variance
    sec2 = type(c)(1.0) / (c * c)
    # Half the exponent beside each sec^2: no factor overflows where the other one has underflowed.
    root = sec2 * wp.exp(-half * p * sine_squared(c) * sec2)
    return reflectivity * p * root * root


@wp.func
def bistatic_geometric_optics(
    polarization: int, cos_half_angle: Any, cos_tilt: Any, eps_re: Any, eps_im: Any, slope_variance: Any
):
    """Bistatic coefficient |R_p(theta_h)|^2 exp(-tan^2 beta / (2 m^2)) / (2 m^2 cos^4 beta); 0 in HV and VH.

    p: HH or VV in the basis of the plane of incidence on the mirroring slope; cos_half_angle: of theta_h,
    between the incoming direction and the half vector; cos_tilt: of beta, between half vector and normal.
    """
    reflectivity = type(cos_tilt)(0.0)
    if polarization == HH:
        reflectivity = fresnel_h(cos_half_angle, eps_re, eps_im)
    elif polarization == VV:
        reflectivity = fresnel_v(cos_half_angle, eps_re, eps_im)
    return geometric_optics(reflectivity, cos_tilt, slope_variance)


@wp.func
def roughness_spectrum(
    spectrum: int,
    wavenumber_squared: Any,
    cos2_azimuth: Any,
    rms_height: Any,
    correlation_length_x: Any,
    correlation_length_y: Any,
):
    """Spectrum W(K) of the heights, normalised so that its integral over the plane of K is h^2.

    Lengths in any unit, K^2 in its inverse square, W in its fourth power. cos2_azimuth: squared cosine of the
    angle between K and the facet's x axis; this and correlation_length_y are read by SEPARABLE alone.
    """
    one = type(rms_height)(1.0)
    pi = type(rms_height)(wp.pi)
    kx2 = wavenumber_squared * correlation_length_x * correlation_length_x
    hl = rms_height * correlation_length_x
    w = type(rms_height)(0.0)
    if spectrum == GAUSSIAN:
        quarter = type(rms_height)(0.25)
        w = hl * hl * quarter / pi * wp.exp(-quarter * kx2)
    elif spectrum == EXPONENTIAL:
        t = one + kx2
        w = hl * hl / ((pi + pi) * t * wp.sqrt(t))
    else:
        ky2 = wavenumber_squared * correlation_length_y * correlation_length_y
        lorentz = (one + kx2 * cos2_azimuth) * (one + ky2 * (one - cos2_azimuth))
        w = hl * rms_height * correlation_length_y / (pi * pi * lorentz)
    return w


@wp.func
def bragg_power(polarization: int, variant: int, cos_theta: Any, cos_twist: Any, eps: Any):
    """Power |S|^2 of the Bragg amplitudes, turned from the facet's basis into the radar's about the ray."""
    q = refraction(cos_theta, eps)
    a_hh = amplitude_te(cos_theta, eps, q)
    a_vv = amplitude_vv(cos_theta, eps, q, variant)
    cos2 = cos_twist * cos_twist
    sin2 = sine_squared(cos_twist)
    power = type(cos_theta)(0.0)
    if polarization == HH:
        s_hh = a_hh * cos2 + a_vv * sin2
        power = wp.dot(s_hh, s_hh)
    elif polarization == VV:
        s_vv = a_hh * sin2 + a_vv * cos2
        power = wp.dot(s_vv, s_vv)
    else:
        difference = a_vv - a_hh
        power = wp.dot(difference, difference) * sin2 * cos2
    return power


@wp.func
def sigma0(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: Any,
    cos_theta: Any,
    cos_twist: Any,
    eps_re: Any,
    eps_im: Any,
    rms_height: Any,
    correlation_length_x: Any,
    correlation_length_y: Any,
    cos2_azimuth: Any,
    specular_fraction: Any,
):
    """Backscatter coefficient, linear: (1 - tau) first-order small perturbation + tau geometric optics.

    polarization: HH, VV, HV, VH; spectrum: GAUSSIAN, EXPONENTIAL, SEPARABLE; variant: STANDARD, AS_PRINTED;
    wavenumber [rad/m]; cos_theta: of the incidence on the facet; cos_twist: cos psi, 1 for the facet's own
    basis; rms_height h, correlation lengths [m]; specular_fraction: tau.

    correlation_length_x is an isotropic surface's only length. correlation_length_y and cos2_azimuth (squared
    cosine between the facet's x axis and the ray's projection on the facet) are read by SEPARABLE alone; its
    slope variance takes l^2 = lx ly. The geometric-optics term does not turn with the basis and has no HV.
    """
    one = type(cos_theta)(1.0)
    c = bounded_cosine(cos_theta)
    # In units of 1/k the Bragg wavenumber is 2 sin(theta), and the spectrum comes out multiplied by k^4.
    w = roughness_spectrum(
        spectrum,
        type(c)(4.0) * sine_squared(c),
        cos2_azimuth,
        wavenumber * rms_height,
        wavenumber * correlation_length_x,
        wavenumber * correlation_length_y,
    )
    prefactor = type(c)(16.0) * type(c)(wp.pi)
    if variant == AS_PRINTED:
        prefactor = type(c)(8.0)
    cos2 = c * c
    power = bragg_power(polarization, variant, c, cos_twist, wp.vector(eps_re, -eps_im))
    diffuse = prefactor * cos2 * cos2 * w * power

    specular = type(c)(0.0)
    if polarization != HV and polarization != VH:
        area = correlation_length_x * correlation_length_x
        if spectrum == SEPARABLE:
            area = correlation_length_x * correlation_length_y
        slope_variance = type(c)(2.0) * rms_height * rms_height / area
        specular = geometric_optics(fresnel_h(one, eps_re, eps_im), c, slope_variance)
    return (one - specular_fraction) * diffuse + specular_fraction * specular


@wp.func
def slope_te(cos_theta: Any, eps: Any, q: Any, amplitude: Any):
    """d amplitude_te / d eps, complex, where `amplitude` is it."""
    inverse = complex_inverse(wp.vector(cos_theta + q[0], q[1]))
    # q' = 1 / (2 q)
    return -complex_product(inverse, inverse) - complex_product(complex_product(amplitude, complex_inverse(q)), inverse)


@wp.func
def slope_tm(cos_theta: Any, eps: Any, q: Any, factor: Any, amplitude: Any):
    """d amplitude_tm / d eps, complex, where `amplitude` is it."""
    one = type(cos_theta)(1.0)
    two = type(cos_theta)(2.0)
    inverse = complex_inverse(eps * cos_theta + q)
    root = complex_inverse(q)
    numerator = wp.vector(sine_squared(cos_theta) - factor * (two * eps[0] - one), -two * factor * eps[1])
    growth = wp.vector(two * cos_theta + root[0], root[1])
    return complex_product(complex_product(numerator, inverse) - complex_product(amplitude, growth), inverse)


@wp.func
def sigma0_and_slopes(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: Any,
    cos_theta: Any,
    cos_twist: Any,
    eps_re: Any,
    eps_im: Any,
    rms_height: Any,
    correlation_length_x: Any,
    correlation_length_y: Any,
    cos2_azimuth: Any,
    specular_fraction: Any,
):
    """`sigma0` and its derivatives to ln(eps_re - 1), ln h, ln l (both lengths together), logit tau: a vector of five.

    In closed form: what reverse mode makes of `sigma0` takes four times the instructions and three times the registers.
    """
    one = type(cos_theta)(1.0)
    two = type(cos_theta)(2.0)
    c = bounded_cosine(cos_theta)
    cos2 = c * c
    eps = wp.vector(eps_re, -eps_im)

    # the diffuse term: spectrum times power
    bragg = type(c)(4.0) * sine_squared(c)
    kx = wavenumber * correlation_length_x
    ky = wavenumber * correlation_length_y
    w = roughness_spectrum(spectrum, bragg, cos2_azimuth, wavenumber * rms_height, kx, ky)
    kx2 = bragg * kx * kx
    by_length = two
    if spectrum == GAUSSIAN:
        by_length = two - type(c)(0.5) * kx2
    elif spectrum == EXPONENTIAL:
        by_length = two - type(c)(3.0) * kx2 / (one + kx2)
    else:
        x = kx2 * cos2_azimuth
        y = bragg * ky * ky * (one - cos2_azimuth)
        by_length = two - two * (x / (one + x) + y / (one + y))
    prefactor = type(c)(16.0) * type(c)(wp.pi)
    if variant == AS_PRINTED:
        prefactor = type(c)(8.0)
    scale = prefactor * cos2 * cos2 * w

    q = refraction(c, eps)
    factor = one + sine_squared(c)
    if variant == AS_PRINTED:
        factor = cos2
    a_hh = amplitude_te(c, eps, q)
    a_vv = amplitude_tm(c, eps, q, factor)
    d_hh = slope_te(c, eps, q, a_hh)
    d_vv = slope_tm(c, eps, q, factor, a_vv)
    turn = cos_twist * cos_twist
    rest = sine_squared(cos_twist)
    amplitude = a_vv - a_hh
    slope = d_vv - d_hh
    share = rest * turn
    power = wp.dot(amplitude, amplitude) * rest * turn
    if polarization == HH:
        amplitude = a_hh * turn + a_vv * rest
        slope = d_hh * turn + d_vv * rest
        share = one
        power = wp.dot(amplitude, amplitude)
    elif polarization == VV:
        amplitude = a_hh * rest + a_vv * turn
        slope = d_hh * rest + d_vv * turn
        share = one
        power = wp.dot(amplitude, amplitude)
    diffuse = scale * power
    diffuse_by_eps = scale * share * two * wp.dot(amplitude, slope)

    # geometric optics: reflectivity of normal incidence, and slopes of variance m^2 = 2 h^2 / l^2
    specular = type(c)(0.0)
    specular_by_eps = type(c)(0.0)
    specular_by_length = type(c)(0.0)
    if polarization != HV and polarization != VH:
        area = correlation_length_x * correlation_length_x
        if spectrum == SEPARABLE:
            area = correlation_length_x * correlation_length_y
        slope_variance = two * rms_height * rms_height / area
        q0 = refraction(one, eps)
        a0 = amplitude_te(one, eps, q0)
        specular = geometric_optics(wp.dot(a0, a0), c, slope_variance)
        specular_by_eps = geometric_optics(two * wp.dot(a0, slope_te(one, eps, q0, a0)), c, slope_variance)
        specular_by_length = specular * (two - sine_squared(c) / (cos2 * slope_variance))

    diffuse_share = one - specular_fraction
    return wp.vector(
        diffuse_share * diffuse + specular_fraction * specular,
        (diffuse_share * diffuse_by_eps + specular_fraction * specular_by_eps) * (eps_re - one),
        diffuse_share * two * diffuse - specular_fraction * specular_by_length,
        diffuse_share * by_length * diffuse + specular_fraction * specular_by_length,
        specular_fraction * diffuse_share * (specular - diffuse),
    )
