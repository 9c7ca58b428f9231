"""Rough faces of the models beside `ka_spm`, and of any model with a learned term, as complex scatterers.

A scatterer sends back a sum of independent complex Gaussian parts, whose powers add up to the model's sigma0:

- of I2EM the first power of the correlation and all higher ones, each with a pair of amplitudes (`kernels/i2em.py`),
  and in HV double scattering. So the covariances of HH, VV and HV are the model's;
- of the models that know powers alone HH and VV as if fully correlated, and HV of level ground by itself.

A kernel is made for each model: one for all would have the registers of its longest branch. HV is VH: one number.
"""

from functools import cache

import warp as wp

from warpsar.kernels.codes import Model, Polarization, Variant
from warpsar.kernels.coherent.numbers import product, root, turned
from warpsar.kernels.coherent.radiate import FOUR_PI, Four
from warpsar.kernels.coherent.rough import SCATTERERS, RoughSurface, Scatterer, scattered, turn_of
from warpsar.kernels.coherent.tubes import Radar, look
from warpsar.kernels.crossed_table import DOUBLE, interpolated
from warpsar.kernels.empirical import dubois, oh
from warpsar.kernels.facet import powers_at
from warpsar.kernels.i2em import (
    TOLERANCE,
    hidden_share,
    higher_amplitude,
    poisson_series,
    power_spectrum,
    slope_deviation,
)
from warpsar.kernels.scattering import (
    amplitude_te,
    amplitude_tm,
    bounded_cosine,
    factor_vv,
    refraction,
    sine_squared,
)


@wp.struct
class Tables:
    """What models look up of a material. An array that no material needs is empty."""

    twice: wp.array2d[wp.vec4]  # ln of double scattering over incidence; rows: frequencies times materials
    rows: wp.array[wp.vec2i]  # of `sigma0_db`: the first row of a material, and how many it has
    incidence_deg: wp.array[float]
    sigma0_db: wp.array2d[float]
    level: wp.array[float]  # factor on a material's table
    units: wp.array[wp.vec2i]  # of a learned term: the first unit of a material, and how many it has
    inverse_width: wp.array[wp.vec4]
    places: wp.array[wp.vec4]
    weights: wp.array2d[float]


@wp.struct
class Parts:
    """Amplitudes whose squares are sigma0, of three independent numbers of unit power."""

    first_hh: wp.vec2d  # in the facet's own basis
    first_vv: wp.vec2d
    second_hh: wp.vec2d
    second_vv: wp.vec2d
    crossed: wp.float64  # in the radar's basis, of HV and VH


@wp.func
def real(x: wp.float64) -> wp.vec2d:
    return wp.vec2d(x, wp.float64(0.0))


@wp.func
def i2em_parts(rough: RoughSurface, k: wp.float64, c: wp.float64, tables: Tables, row: int, material: int) -> Parts:
    """The terms of `i2em_single` less what lies in shadow, and double scattering from its table."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    four = wp.float64(4.0)
    eps = rough.permittivity
    height = k * rough.rms_height
    length = k * rough.length[0]
    q = refraction(c, eps)
    a_hh = amplitude_te(c, eps, q)
    a_vv = amplitude_tm(c, eps, q, factor_vv(c, int(Variant.STANDARD)))
    r_v = amplitude_tm(c, eps, q, c * c)  # -R_v: the sign falls out of its square
    mean = four * height * height * c * c
    square = four * sine_squared(c) * length * length
    total, _by_height, _by_length = poisson_series(2, TOLERANCE, rough.spectrum, mean, square)
    value, _slope = power_spectrum(rough.spectrum, one, square)
    hidden, _by_slope = hidden_share(c, slope_deviation(rough.spectrum, height, length))
    scale = two * length * length / (one + two * hidden)
    first = root(scale * c * c * mean * wp.exp(-mean) * value)
    higher = root(scale * total)
    twice = interpolated(tables.twice, row, float(c), DOUBLE)
    found = Parts()
    found.first_hh = first * a_hh
    found.first_vv = first * a_vv
    found.second_hh = higher * higher_amplitude(c, a_hh, a_hh, -one)
    found.second_vv = higher * higher_amplitude(c, a_vv, r_v, one)
    found.crossed = c * root(wp.exp(wp.float64(twice[0])))
    return found


@wp.func
def of_powers(hh: wp.float64, vv: wp.float64, hv: wp.float64) -> Parts:
    """HH and VV with one phase, as `empirical.turned_power` mixes them."""
    found = Parts()
    found.first_hh = real(root(hh))
    found.first_vv = real(root(vv))
    found.crossed = root(hv)
    return found


@wp.func
def oh_parts(rough: RoughSurface, k: wp.float64, c: wp.float64, tables: Tables, row: int, material: int) -> Parts:
    one = wp.float64(1.0)
    eps = rough.permittivity[0]
    height = k * rough.rms_height
    hh, _a, _b, _c = oh(int(Polarization.HH), c, one, eps, height)
    vv, _d, _e, _f = oh(int(Polarization.VV), c, one, eps, height)
    hv, _g, _h, _i = oh(int(Polarization.HV), c, one, eps, height)
    return of_powers(hh, vv, hv)


@wp.func
def dubois_parts(rough: RoughSurface, k: wp.float64, c: wp.float64, tables: Tables, row: int, material: int) -> Parts:
    one = wp.float64(1.0)
    eps = rough.permittivity[0]
    height = k * rough.rms_height
    hh, _a, _b, _c = dubois(int(Polarization.HH), k, c, one, eps, height)
    vv, _d, _e, _f = dubois(int(Polarization.VV), k, c, one, eps, height)
    return of_powers(hh, vv, wp.float64(0.0))


@wp.func
def facet_parts(rough: RoughSurface, k: wp.float64, c: wp.float64, tables: Tables, row: int, material: int) -> Parts:
    """A table of sigma0 over incidence."""
    power = tables.level[material] * powers_at(tables.incidence_deg, tables.sigma0_db, tables.rows[material], float(c))
    return of_powers(wp.float64(power[0]), wp.float64(power[1]), wp.float64(power[2]))


PARTS = {
    Model.I2EM: i2em_parts,
    Model.OH: oh_parts,
    Model.DUBOIS: dubois_parts,
    Model.FACET: facet_parts,
}


@wp.func
def turned_into_radar(hh: wp.vec2d, vv: wp.vec2d, turn: wp.vec2d, number: wp.vec2d) -> Four:
    """A pair of amplitudes of the facet's own basis in the radar's, times one complex number."""
    cosine = turn[0]
    sine = turn[1]
    found = Four()
    found.hh = product(number, cosine * cosine * hh + sine * sine * vv)
    found.hv = product(number, sine * cosine * (hh - vv))
    found.vv = product(number, sine * sine * hh + cosine * cosine * vv)
    return found


@wp.func
def sent_back(parts: Parts, turn: wp.vec2d, place: Scatterer, crossed: wp.vec2d, factor: wp.vec2d) -> Four:
    """Amplitudes [m] in the radar's basis; `crossed`: a complex Gaussian number of unit power, as those of `place`."""
    once = turned_into_radar(parts.first_hh, parts.first_vv, turn, product(place.diffuse, factor))
    more = turned_into_radar(parts.second_hh, parts.second_vv, turn, product(place.specular, factor))
    found = Four()
    found.hh = once.hh + more.hh
    found.hv = once.hv + more.hv + parts.crossed * product(crossed, factor)
    found.vh = found.hv
    found.vv = once.vv + more.vv
    return found


@wp.func
def with_term(four: Four, tables: Tables, rough: RoughSurface, k: wp.float64, c: wp.float64, material: int) -> Four:
    """Amplitudes times exp(g / 2), g the learned term of each channel (`kernels/learned_term.py`)."""
    at = wp.vec4(
        float(c),
        float(wp.log(rough.rms_height * k)),
        float(wp.log(rough.length[0] * k)),
        float(wp.log(rough.permittivity[0] - wp.float64(1.0))),
    )
    g = wp.vec3()  # of HH, HV and VV; one exponential of a unit serves all three
    units = tables.units[material]
    for j in range(units[0], units[0] + units[1]):
        apart = wp.cw_mul(at - tables.places[j], tables.inverse_width[material])
        weights = wp.vec3(
            tables.weights[j, Polarization.HH], tables.weights[j, Polarization.HV], tables.weights[j, Polarization.VV]
        )
        g += wp.exp(-0.5 * wp.dot(apart, apart)) * weights
    found = Four()
    found.hh = wp.exp(wp.float64(0.5 * g[0])) * four.hh
    found.hv = wp.exp(wp.float64(0.5 * g[1])) * four.hv
    found.vh = found.hv
    found.vv = wp.exp(wp.float64(0.5 * g[2])) * four.vv
    return found


@cache
def scattered_by(model: Model, termed: bool) -> wp.Function:
    """`rough.scattered` for faces of a model, and `termed` for those with a learned term."""
    parts_of = PARTS.get(model)

    @wp.func
    def scattered_by_it(
        radar: Radar,
        k: wp.float64,
        surfaces: wp.array[RoughSurface],
        variant: int,
        place: Scatterer,
        tables: Tables,
        first_row: int,
        crossed: wp.vec2d,
    ) -> Four:
        material = place.material
        rough = surfaces[material]
        sight = look(radar, place.point, 0.0)
        n = place.normal
        if wp.dot(n, sight.s) < wp.float64(0.0):
            n = -n
        c = bounded_cosine(wp.dot(n, sight.s))
        if wp.static(model == Model.KA_SPM):
            four = scattered(radar, k, rough, variant, place)
        else:
            parts = parts_of(rough, k, c, tables, first_row + material, material)
            factor = root(place.area / FOUR_PI) * sight.spread * sight.spread
            phase = turned(-wp.float64(2.0) * k * sight.back)
            four = sent_back(parts, turn_of(-sight.s, n, radar.u, radar.v), place, crossed, factor * phase)
        if wp.static(termed):
            four = with_term(four, tables, rough, k, c, material)
        return four

    return scattered_by_it


@cache
def rough_kernel(model: Model, termed: bool) -> wp.Kernel:
    """`rough.rough_kernel` for faces of a model, and `termed` for those with a learned term."""
    scattered_by_it = scattered_by(model, termed)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def rough_kernel(
        # In:
        radar_in: wp.array[Radar],
        wavenumber_in: wp.array[wp.float64],
        surface_in: wp.array[RoughSurface],
        variant: int,
        scatterer_in: wp.array[Scatterer],
        seen_in: wp.array2d[wp.uint8],
        tables: Tables,
        crossed_in: wp.array[wp.vec2d],
        # Out:
        amplitude_out: wp.array4d[wp.vec2d],
    ):
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
                    row = f * surface_in.shape[0]
                    four = scattered_by_it(radar_in[view], k, surface_in, variant, place, tables, row, crossed_in[j])
                    hh += four.hh
                    hv += four.hv
                    vv += four.vv
        amplitude_out[view, f, chunk, 0] = hh
        amplitude_out[view, f, chunk, 1] = hv
        amplitude_out[view, f, chunk, 2] = hv
        amplitude_out[view, f, chunk, 3] = vv

    return rough_kernel


@cache
def rough_places_kernel(model: Model, termed: bool) -> wp.Kernel:
    """`collection.rough_places_kernel` for faces of a model, and `termed` for those with a learned term."""
    scattered_by_it = scattered_by(model, termed)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def rough_places_kernel(
        # In:
        radar_in: wp.array[Radar],
        k: wp.float64,
        surface_in: wp.array[RoughSurface],
        variant: int,
        scatterer_in: wp.array[Scatterer],
        seen_in: wp.array2d[wp.uint8],
        tables: Tables,
        crossed_in: wp.array[wp.vec2d],
        # Out:
        amplitude_out: wp.array2d[wp.vec2],
    ):
        i = wp.tid()
        if seen_in[0, i] == wp.uint8(0):
            return
        place = scatterer_in[i]
        four = scattered_by_it(radar_in[0], k, surface_in, variant, place, tables, 0, crossed_in[i])
        turn = turned(wp.float64(2.0) * k * look(radar_in[0], place.point, 0.0).back)
        amplitude_out[i, 0] = wp.vec2(product(four.hh, turn))
        amplitude_out[i, 1] = wp.vec2(product(four.hv, turn))
        amplitude_out[i, 2] = wp.vec2(product(four.vh, turn))
        amplitude_out[i, 3] = wp.vec2(product(four.vv, turn))

    return rough_places_kernel
