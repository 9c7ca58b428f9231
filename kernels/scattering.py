"""Microwave backscatter of a rough dielectric facet as differentiable Warp functions (docs/physics.md).

Functions are generic over float32 and float64: all floating arguments of one call have the same type. The
permittivity is eps = eps_re - j eps_im with eps_re >= 1, eps_im >= 0. Angles are to the facet's normal and
come as cosines, so a hit's geometry needs no inverse trigonometry. Complex numbers are vectors (re, im).

Every value and every derivative is finite for 0 <= cos_theta <= 1, h > 0, l > 0: at eps_im = 0, at
specular_fraction 0 and 1, and where an exponential underflows.

This is the only statement of the model: CUDA and reverse mode compile these functions, and kernels/lanes.py writes the
CPU's vector code from them. A further model takes the same way, by a `sigma0` and a `sigma0_and_slopes` of its own.
"""

from typing import Any

import warp as wp

from warpsar.kernels.codes import Polarization, Spectrum, Variant

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
def factor_vv(cos_theta: Any, variant: int):
    """`factor` of the Bragg amplitude a_vv, which is a_hh at theta = 0; AS_PRINTED: the paper's (18), which is -R_v."""
    factor = type(cos_theta)(1.0) + sine_squared(cos_theta)
    if variant == Variant.AS_PRINTED:
        factor = cos_theta * cos_theta
    return factor


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
def mirror_lobe(cos_tilt: Any, slope_variance: Any):
    """Kirchhoff coefficient in geometric optics for a reflectivity of 1: exp(-tan^2 / (2 m^2)) / (2 m^2 cos^4).

    cos_tilt: of the angle between the normal and the half vector of the two directions (backscatter: theta);
    slope_variance: m^2 of the surface's slopes, per axis.
    """
    c = bounded_cosine(cos_tilt)
    half = type(c)(0.5)
    p = half / slope_variance
    sec2 = type(c)(1.0) / (c * c)
    # Half the exponent beside each sec^2: no factor overflows where the other one has underflowed.
    root = sec2 * wp.exp(-half * p * sine_squared(c) * sec2)
    return p * root * root


@wp.func
def bistatic_geometric_optics(
    polarization: int, cos_half_angle: Any, cos_tilt: Any, eps_re: Any, eps_im: Any, slope_variance: Any
):
    """Bistatic coefficient |R_p(theta_h)|^2 exp(-tan^2 beta / (2 m^2)) / (2 m^2 cos^4 beta); 0 in HV and VH.

    p: HH or VV in the basis of the plane of incidence on the mirroring slope; cos_half_angle: of theta_h,
    between the incoming direction and the half vector; cos_tilt: of beta, between half vector and normal.
    """
    reflectivity = type(cos_tilt)(0.0)
    if polarization == Polarization.HH:
        reflectivity = fresnel_h(cos_half_angle, eps_re, eps_im)
    elif polarization == Polarization.VV:
        reflectivity = fresnel_v(cos_half_angle, eps_re, eps_im)
    return reflectivity * mirror_lobe(cos_tilt, slope_variance)


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
    if spectrum == Spectrum.GAUSSIAN:
        quarter = type(rms_height)(0.25)
        w = hl * hl * quarter / pi * wp.exp(-quarter * kx2)
    elif spectrum == Spectrum.EXPONENTIAL:
        t = one + kx2
        w = hl * hl / ((pi + pi) * t * wp.sqrt(t))
    else:
        ky2 = wavenumber_squared * correlation_length_y * correlation_length_y
        lorentz = (one + kx2 * cos2_azimuth) * (one + ky2 * (one - cos2_azimuth))
        w = hl * rms_height * correlation_length_y / (pi * pi * lorentz)
    return w


@wp.func
def is_crossed(polarization: int):
    return polarization == Polarization.HV or polarization == Polarization.VH


@wp.func
def turned(polarization: int, cos_twist: Any, hh: Any, vv: Any):
    """A channel's amplitude from those of the facet's own basis, turned into the radar's basis about the ray.

    That of HV and VH lacks its factor sin(psi) cos(psi), whose square `turned_share` has.
    """
    cos2 = cos_twist * cos_twist
    sin2 = sine_squared(cos_twist)
    amplitude = vv - hh
    if polarization == Polarization.HH:
        amplitude = hh * cos2 + vv * sin2
    elif polarization == Polarization.VV:
        amplitude = hh * sin2 + vv * cos2
    return amplitude


@wp.func
def turned_share(polarization: int, cos_twist: Any):
    share = type(cos_twist)(1.0)
    if is_crossed(polarization):
        share = sine_squared(cos_twist) * cos_twist * cos_twist
    return share


@wp.func
def bragg_terms(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: Any,
    cosine: Any,
    cos_twist: Any,
    eps: Any,
    rms_height: Any,
    correlation_length_x: Any,
    correlation_length_y: Any,
    cos2_azimuth: Any,
):
    """First-order small perturbation: sigma0 is `scale` |S|^2, the amplitude S is a_hh and a_vv `turned`.

    Returns scale, S, and for the slopes of S: q, a_hh, a_vv.
    """
    # In units of 1/k the Bragg wavenumber is 2 sin(theta), and the spectrum comes out multiplied by k^4.
    w = roughness_spectrum(
        spectrum,
        type(cosine)(4.0) * sine_squared(cosine),
        cos2_azimuth,
        wavenumber * rms_height,
        wavenumber * correlation_length_x,
        wavenumber * correlation_length_y,
    )
    prefactor = type(cosine)(16.0) * type(cosine)(wp.pi)
    if variant == Variant.AS_PRINTED:
        prefactor = type(cosine)(8.0)
    cos2 = cosine * cosine
    scale = prefactor * cos2 * cos2 * w * turned_share(polarization, cos_twist)
    q = refraction(cosine, eps)
    a_hh = amplitude_te(cosine, eps, q)
    a_vv = amplitude_tm(cosine, eps, q, factor_vv(cosine, variant))
    return scale, turned(polarization, cos_twist, a_hh, a_vv), q, a_hh, a_vv


@wp.func
def mirror_terms(
    spectrum: int, cosine: Any, eps: Any, rms_height: Any, correlation_length_x: Any, correlation_length_y: Any
):
    """Geometric optics: sigma0 is `lobe` |R|^2, R the reflection of normal incidence.

    Returns lobe, R, and for their slopes: q of normal incidence, the variance of the surface's slopes.
    """
    one = type(cosine)(1.0)
    area = correlation_length_x * correlation_length_x
    if spectrum == Spectrum.SEPARABLE:
        area = correlation_length_x * correlation_length_y
    slope_variance = type(cosine)(2.0) * rms_height * rms_height / area
    q = refraction(one, eps)
    return mirror_lobe(cosine, slope_variance), amplitude_te(one, eps, q), q, slope_variance


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

    polarization, spectrum, variant: codes (`kernels/codes.py`); wavenumber [rad/m]; cos_theta: of the incidence on the
    facet; cos_twist: cos psi, 1 for the facet's own basis; rms_height h, correlation lengths [m];
    specular_fraction: tau.

    correlation_length_x is an isotropic surface's only length. correlation_length_y and cos2_azimuth (squared
    cosine between the facet's x axis and the ray's projection on the facet) are read by SEPARABLE alone; its
    slope variance takes l^2 = lx ly. The geometric-optics term does not turn with the basis and has no HV.
    """
    c = bounded_cosine(cos_theta)
    eps = wp.vector(eps_re, -eps_im)
    h = rms_height
    lx = correlation_length_x
    ly = correlation_length_y
    scale, amplitude, _q, _a_hh, _a_vv = bragg_terms(
        polarization, spectrum, variant, wavenumber, c, cos_twist, eps, h, lx, ly, cos2_azimuth
    )
    diffuse = scale * wp.dot(amplitude, amplitude)
    specular = type(c)(0.0)
    if not is_crossed(polarization):
        lobe, r, _q0, _variance = mirror_terms(spectrum, c, eps, h, lx, ly)
        specular = lobe * wp.dot(r, r)
    return (type(c)(1.0) - specular_fraction) * diffuse + specular_fraction * specular


@wp.func
def slope_te(cos_theta: Any, q: Any, amplitude: Any):
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
def spectrum_slope(
    spectrum: int,
    wavenumber_squared: Any,
    cos2_azimuth: Any,
    correlation_length_x: Any,
    correlation_length_y: Any,
):
    """d ln(roughness_spectrum) / d ln l, both lengths together."""
    one = type(wavenumber_squared)(1.0)
    two = type(wavenumber_squared)(2.0)
    kx2 = wavenumber_squared * correlation_length_x * correlation_length_x
    slope = two - type(wavenumber_squared)(0.5) * kx2
    if spectrum == Spectrum.EXPONENTIAL:
        slope = two - type(wavenumber_squared)(3.0) * kx2 / (one + kx2)
    elif spectrum == Spectrum.SEPARABLE:
        x = kx2 * cos2_azimuth
        y = wavenumber_squared * correlation_length_y * correlation_length_y * (one - cos2_azimuth)
        slope = two - two * (x / (one + x) + y / (one + y))
    return slope


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

    The terms are those of `sigma0`; their slopes are in closed form. Reverse mode would take four times the
    instructions and three times the registers. tests/kernels/test_scattering.py holds the two together in float64.
    """
    one = type(cos_theta)(1.0)
    two = type(cos_theta)(2.0)
    c = bounded_cosine(cos_theta)
    eps = wp.vector(eps_re, -eps_im)
    h = rms_height
    lx = correlation_length_x
    ly = correlation_length_y
    scale, amplitude, q, a_hh, a_vv = bragg_terms(
        polarization, spectrum, variant, wavenumber, c, cos_twist, eps, h, lx, ly, cos2_azimuth
    )
    diffuse = scale * wp.dot(amplitude, amplitude)
    d_hh = slope_te(c, q, a_hh)
    d_vv = slope_tm(c, eps, q, factor_vv(c, variant), a_vv)
    diffuse_by_eps = scale * two * wp.dot(amplitude, turned(polarization, cos_twist, d_hh, d_vv))
    by_length = spectrum_slope(spectrum, type(c)(4.0) * sine_squared(c), cos2_azimuth, wavenumber * lx, wavenumber * ly)

    specular = type(c)(0.0)
    specular_by_eps = type(c)(0.0)
    specular_by_length = type(c)(0.0)
    if not is_crossed(polarization):
        lobe, r, q0, slope_variance = mirror_terms(spectrum, c, eps, h, lx, ly)
        specular = lobe * wp.dot(r, r)
        specular_by_eps = lobe * two * wp.dot(r, slope_te(one, q0, r))
        specular_by_length = specular * (two - sine_squared(c) / (c * c * slope_variance))

    tau = specular_fraction
    rest = one - tau
    return wp.vector(
        rest * diffuse + tau * specular,
        (rest * diffuse_by_eps + tau * specular_by_eps) * (eps_re - one),
        rest * two * diffuse - tau * specular_by_length,
        rest * by_length * diffuse + tau * specular_by_length,
        tau * rest * (specular - diffuse),
    )
