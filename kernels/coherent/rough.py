"""Rough faces as complex scatterers that belong to places of the surface."""

import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.kernels.coherent.numbers import product, root, turned
from warpsar.kernels.coherent.radiate import FOUR_PI, Four
from warpsar.kernels.coherent.tubes import Radar, look
from warpsar.kernels.scattering import bounded_cosine, bragg_terms, mirror_terms

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
class Facet:
    """A rough face as the radar sees it."""

    cosine: wp.float64  # of the incidence
    cos2: wp.float64  # squared cosine between the facet's x axis and the ray on the facet
    turn: wp.vec2d  # cosine and sine of the turn of the facet's basis about the line of sight
    spread: wp.float64  # field over that at the reference point's distance, both ways
    back: wp.float64  # way to the radar [m]


@wp.func
def facet_of(radar: Radar, place: Scatterer) -> Facet:
    one = wp.float64(1.0)
    sight = look(radar, place.point, 0.0)
    n = place.normal
    if wp.dot(n, sight.s) < wp.float64(0.0):
        n = -n
    d = -sight.s
    found = Facet()
    found.cosine = bounded_cosine(-wp.dot(n, d))
    x = wp.vec3d(-n[1], n[0], wp.float64(0.0))  # the facet's x axis, as in kernels/geometry.py
    if wp.length(x) < wp.float64(1.0e-6):
        x = wp.vec3d(one, wp.float64(0.0), wp.float64(0.0))
    along = d - wp.dot(d, n) * n
    cos2 = one
    if wp.length(along) > wp.float64(1.0e-6):
        ratio = wp.dot(wp.normalize(along), wp.normalize(x))
        cos2 = ratio * ratio
    found.cos2 = cos2
    across = wp.cross(n, d)
    if wp.length(across) < wp.float64(1.0e-9):
        across = radar.u
    across = wp.normalize(across)
    found.turn = wp.vec2d(wp.dot(radar.u, across), wp.dot(radar.v, across))
    found.spread = sight.spread * sight.spread
    found.back = sight.back
    return found


@wp.struct
class Scattering:
    """A facet's complex amplitudes in its own basis: of small perturbation, and of geometric optics."""

    hh: wp.vec2d
    vv: wp.vec2d
    scale: wp.float64  # sigma0 over |hh|^2
    mirror: wp.vec2d
    lobe: wp.float64


@wp.func
def scattering_of(rough: RoughSurface, variant: int, k: wp.float64, facet: Facet) -> Scattering:
    """The model of `kernels/scattering.py` with its phases."""
    one = wp.float64(1.0)
    c = facet.cosine
    lx = rough.length[0]
    ly = rough.length[1]
    h = rough.rms_height
    eps = rough.permittivity
    scale, a_hh, _q, _h, _v = bragg_terms(
        int(Polarization.HH), rough.spectrum, variant, k, c, one, eps, h, lx, ly, facet.cos2
    )
    _scale, a_vv, _q2, _h2, _v2 = bragg_terms(
        int(Polarization.VV), rough.spectrum, variant, k, c, one, eps, h, lx, ly, facet.cos2
    )
    lobe, r, _q0, _variance = mirror_terms(rough.spectrum, c, eps, h, lx, ly)
    found = Scattering()
    found.hh = a_hh
    found.vv = a_vv
    found.scale = scale
    found.mirror = r
    found.lobe = lobe
    return found


@wp.func
def turned_into_radar(hh: wp.vec2d, vv: wp.vec2d, turn: wp.vec2d, number: wp.vec2d) -> Four:
    """A pair of amplitudes of the facet's own basis in the radar's, times one complex number."""
    cosine = turn[0]
    sine = turn[1]
    found = Four()
    found.hh = product(number, cosine * cosine * hh + sine * sine * vv)
    found.hv = product(number, sine * cosine * (hh - vv))
    found.vh = found.hv
    found.vv = product(number, sine * sine * hh + cosine * cosine * vv)
    return found


@wp.func
def scattered(radar: Radar, k: wp.float64, rough: RoughSurface, variant: int, place: Scatterer) -> Four:
    """What a scatterer sends back."""
    one = wp.float64(1.0)
    facet = facet_of(radar, place)
    model = scattering_of(rough, variant, k, facet)
    phase = facet.spread * turned(-wp.float64(2.0) * k * facet.back)
    share = place.area / FOUR_PI
    bragg = root(share * (one - rough.specular_fraction) * model.scale) * product(place.diffuse, phase)
    mirror = root(share * rough.specular_fraction * model.lobe) * product(product(place.specular, phase), model.mirror)
    found = turned_into_radar(model.hh, model.vv, facet.turn, bragg)
    found.hh = found.hh + mirror
    found.vv = found.vv + mirror
    return found


@wp.kernel(enable_backward=False)
def rough_kernel(
    # In:
    radar_in: wp.array[Radar],
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
    hh = wp.vec2d()
    hv = wp.vec2d()
    vv = wp.vec2d()
    for i in range(SCATTERERS):
        j = chunk * SCATTERERS + i
        if j < scatterer_in.shape[0]:
            if seen_in[view, j] != wp.uint8(0):
                place = scatterer_in[j]
                four = scattered(radar_in[view], k, surface_in[place.material], variant, place)
                hh += four.hh
                hv += four.hv
                vv += four.vv
    amplitude_out[view, f, chunk, 0] = hh
    amplitude_out[view, f, chunk, 1] = hv
    amplitude_out[view, f, chunk, 2] = hv
    amplitude_out[view, f, chunk, 3] = vv
