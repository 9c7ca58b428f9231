"""Rough faces as complex scatterers that belong to places of the surface."""

import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.kernels.coherent.bistatic import PI, azimuth_cos2, first_order, mirrored
from warpsar.kernels.coherent.numbers import product, root, turned
from warpsar.kernels.coherent.radiate import FOUR_PI, Four, keep, plus, unit
from warpsar.kernels.coherent.reflection import Face
from warpsar.kernels.coherent.tubes import TubeRadar, look
from warpsar.kernels.scattering import bounded_cosine, bragg_terms, mirror_terms, roughness_spectrum

SCATTERERS = wp.constant(64)
"""Scatterers that one thread adds up."""


@wp.struct
class Scatterer:
    """A place of a rough face. What it sends back is a sum of complex Gaussian numbers, whose mean power is sigma0."""

    point: wp.vec3d  # [m]
    normal: wp.vec3d
    area: wp.float64  # [m2]
    diffuse: wp.vec2d  # complex Gaussian, of unit power: of small perturbation
    specular: wp.vec2d  # of geometric optics; with another model of the higher powers of the correlation
    material: int


@wp.struct
class RoughSurface:
    """The surface model's parameters of a material; `kernels/scattering.py` says what they mean."""

    spectrum: int
    permittivity: wp.vec2d
    rms_height: wp.float64
    length: wp.vec2d
    specular_fraction: wp.float64


@wp.struct
class Scattering:
    """A facet's complex amplitudes in the radar's basis: of small perturbation, and of geometric optics."""

    hh: wp.vec2d
    hv: wp.vec2d
    vv: wp.vec2d
    scale: wp.float64  # sigma0 over |hh|^2
    mirror: wp.vec2d
    lobe: wp.float64


@wp.func
def turn_of(d: wp.vec3d, n: wp.vec3d, u: wp.vec3d, v: wp.vec3d) -> wp.vec2d:
    """Cosine and sine of the turn of the facet's basis about the line of sight."""
    across = wp.cross(n, d)
    if wp.length(across) < wp.float64(1.0e-9):
        across = u
    across = wp.normalize(across)
    return wp.vec2d(wp.dot(u, across), wp.dot(v, across))


@wp.func
def scattering_of(
    rough: RoughSurface, variant: int, k: wp.float64, d: wp.vec3d, n: wp.vec3d, u: wp.vec3d, v: wp.vec3d
) -> Scattering:
    """The model of `kernels/scattering.py` with its phases. The facet's basis is turned about the line of sight."""
    one = wp.float64(1.0)
    c = bounded_cosine(-wp.dot(n, d))
    x = wp.vec3d(-n[1], n[0], wp.float64(0.0))  # the facet's x axis, as in kernels/geometry.py
    if wp.length(x) < wp.float64(1.0e-6):
        x = wp.vec3d(one, wp.float64(0.0), wp.float64(0.0))
    along = d - wp.dot(d, n) * n
    cos2 = one
    if wp.length(along) > wp.float64(1.0e-6):
        ratio = wp.dot(wp.normalize(along), wp.normalize(x))
        cos2 = ratio * ratio
    lx = rough.length[0]
    ly = rough.length[1]
    h = rough.rms_height
    eps = rough.permittivity
    scale, a_hh, _q, _h, _v = bragg_terms(
        int(Polarization.HH), rough.spectrum, variant, k, c, one, eps, h, lx, ly, cos2
    )
    _scale, a_vv, _q2, _h2, _v2 = bragg_terms(
        int(Polarization.VV), rough.spectrum, variant, k, c, one, eps, h, lx, ly, cos2
    )
    lobe, r, _q0, _variance = mirror_terms(rough.spectrum, c, eps, h, lx, ly)
    turn = turn_of(d, n, u, v)
    cosine = turn[0]
    sine = turn[1]
    found = Scattering()
    found.hh = cosine * cosine * a_hh + sine * sine * a_vv
    found.hv = sine * cosine * (a_hh - a_vv)
    found.vv = sine * sine * a_hh + cosine * cosine * a_vv
    found.scale = scale
    found.mirror = r
    found.lobe = lobe
    return found


@wp.func
def scattered(radar: TubeRadar, k: wp.float64, rough: RoughSurface, variant: int, place: Scatterer) -> Four:
    """What a scatterer sends back."""
    sight = look(radar, place.point, 0.0)
    phase = sight.spread * sight.spread * turned(-wp.float64(2.0) * k * sight.back)
    return scattered_toward(sight.s, phase, radar, k, rough, variant, place)


@wp.func
def scattered_toward(
    s: wp.vec3d,
    phase: wp.vec2d,
    radar: TubeRadar,
    k: wp.float64,
    rough: RoughSurface,
    variant: int,
    place: Scatterer,
) -> Four:
    """The same toward `s`, with a factor `phase` of the way."""
    one = wp.float64(1.0)
    n = place.normal
    if wp.dot(n, s) < wp.float64(0.0):
        n = -n
    model = scattering_of(rough, variant, k, -s, n, radar.u, radar.v)
    share = place.area / FOUR_PI
    bragg = root(share * (one - rough.specular_fraction) * model.scale) * product(place.diffuse, phase)
    mirror = root(share * rough.specular_fraction * model.lobe) * product(product(place.specular, phase), model.mirror)
    found = Four()
    found.hh = product(bragg, model.hh) + mirror
    found.hv = product(bragg, model.hv)
    found.vh = found.hv
    found.vv = product(bragg, model.vv) + mirror
    return found


@wp.func
def scattered_between(
    radar: TubeRadar, receiver: TubeRadar, k: wp.float64, rough: RoughSurface, place: Scatterer
) -> Four:
    """What a scatterer sends from a transmitter to a receiver apart from it, without the phase of the ways.

    Small perturbation of first order and geometric optics, as `scattered` of one antenna, which it equals there. Both
    must be on one side of the face.
    """
    one = wp.float64(1.0)
    there = look(radar, place.point, 0.0)
    back = look(receiver, place.point, 0.0)
    found = Four()
    n = place.normal
    if wp.dot(n, there.s) < wp.float64(0.0):
        n = -n
    if wp.dot(n, back.s) <= wp.float64(0.0):
        return found
    q = k * (there.s + back.s)
    upright = wp.dot(q, n)
    across2 = wp.max(wp.dot(q, q) - upright * upright, wp.float64(0.0))
    lx = rough.length[0]
    ly = rough.length[1]
    h = rough.rms_height
    heights = roughness_spectrum(rough.spectrum, across2, azimuth_cos2(q, n), h, lx, ly)
    lobe, _r, _q0, _variance = mirror_terms(rough.spectrum, upright / wp.length(q), rough.permittivity, h, lx, ly)
    share = there.spread * back.spread * root(place.area / FOUR_PI)
    bragg = -share * root((one - rough.specular_fraction) * PI * heights) * k * k * place.diffuse
    mirror = share * root(rough.specular_fraction * lobe) * place.specular
    flat = Face()
    flat.permittivity = rough.permittivity
    d = -there.s
    s = back.s
    u = receiver.u
    v = receiver.v
    h_sent = unit(radar.u)
    v_sent = unit(radar.v)
    found.hh = product(bragg, first_order(flat, k, h_sent, d, n, s, u))
    found.hh += product(mirror, mirrored(flat, k, h_sent, d, s, u))
    found.hv = product(bragg, first_order(flat, k, v_sent, d, n, s, u))
    found.hv += product(mirror, mirrored(flat, k, v_sent, d, s, u))
    found.vh = product(bragg, first_order(flat, k, h_sent, d, n, s, v))
    found.vh += product(mirror, mirrored(flat, k, h_sent, d, s, v))
    found.vv = product(bragg, first_order(flat, k, v_sent, d, n, s, v))
    found.vv += product(mirror, mirrored(flat, k, v_sent, d, s, v))
    return found


@wp.kernel(enable_backward=False)
def rough_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    surface_in: wp.array[RoughSurface],
    variant: int,
    scatterer_in: wp.array[Scatterer],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """What SCATTERERS scatterers send back, shape (views, frequencies, chunks, 4)."""
    view, f, chunk = wp.tid()
    k = wavenumber_in[f]
    total = Four()
    for i in range(SCATTERERS):
        j = chunk * SCATTERERS + i
        if j < scatterer_in.shape[0]:
            if seen_in[view, j] != wp.uint8(0):
                place = scatterer_in[j]
                four = scattered(radar_in[view], k, surface_in[place.material], variant, place)
                total = plus(total, four)
    total.vh = total.hv
    keep(view, f, chunk, total, amplitude_out)
