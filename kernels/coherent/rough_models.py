"""Rough faces of the models beside `ka_spm`, and of any model with a learned term, as complex scatterers.

A scatterer sends back a sum of independent complex Gaussian parts, whose powers add up to the model's sigma0:

- of I2EM the first power of the correlation and all higher ones, each with a pair of amplitudes (its file),
  and in HV double scattering. So the covariances of HH, VV and HV are the model's;
- of the models that know powers alone HH and VV as if fully correlated, and HV of level ground by itself.

A kernel is made for each model: one for all would have the registers of its longest branch. HV is VH: one number.
"""

from functools import cache

import warp as wp

from warpsar.kernels.codes import Polarization, Variant
from warpsar.kernels.coherent.numbers import product, root, turned
from warpsar.kernels.coherent.radiate import FOUR_PI, Four, keep, plus
from warpsar.kernels.coherent.rough import SCATTERERS, RoughSurface, Scatterer, scattered, turn_of
from warpsar.kernels.coherent.tubes import TubeRadar, look
from warpsar.kernels.parts import Lookup, Parts, parts_of_powers
from warpsar.kernels.scatter import functions_of, places_of, sigma0_of
from warpsar.kernels.scattering import bounded_cosine


@cache
def parts_of(model: str) -> wp.Function:
    """The function of a model's amplitudes: its own, or those of its powers in the facet's own basis."""
    module = functions_of(model)
    if hasattr(module, "parts_of"):
        found: wp.Function = module.parts_of
        return found
    value_of = sigma0_of(model)
    places = places_of(model)

    @wp.func
    def parts_of_its_powers(
        lookup: Lookup,
        row: int,
        material: int,
        k: wp.float64,
        cosine: wp.float64,
        spectrum: int,
        permittivity: wp.vec2d,
        rms_height: wp.float64,
        length: wp.float64,
    ) -> Parts:
        one = wp.float64(1.0)
        loss = -permittivity[1]
        variant = int(Variant.STANDARD)
        zeta = wp.vector(length=wp.static(places), dtype=wp.float64)
        for place in range(wp.static(places)):
            zeta[place] = lookup.zeta[material, place]
        hh = value_of(int(Polarization.HH), spectrum, variant, k, cosine, one, one, loss, one, zeta)
        vv = value_of(int(Polarization.VV), spectrum, variant, k, cosine, one, one, loss, one, zeta)
        hv = value_of(int(Polarization.HV), spectrum, variant, k, cosine, one, one, loss, one, zeta)
        return parts_of_powers(hh, vv, hv)

    return parts_of_its_powers


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
def with_term(four: Four, tables: Lookup, rough: RoughSurface, k: wp.float64, c: wp.float64, material: int) -> Four:
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
def scattered_by(model: str, termed: bool) -> wp.Function:
    """`rough.scattered` for faces of a model, and `termed` for those with a learned term."""
    default = model == "ka_spm"
    own_parts_of = None if default else parts_of(model)

    @wp.func
    def scattered_by_it(
        radar: TubeRadar,
        k: wp.float64,
        surfaces: wp.array[RoughSurface],
        variant: int,
        place: Scatterer,
        tables: Lookup,
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
        if wp.static(default):
            four = scattered(radar, k, rough, variant, place)
        else:
            parts = own_parts_of(
                tables,
                first_row + material,
                material,
                k,
                c,
                rough.spectrum,
                rough.permittivity,
                rough.rms_height,
                rough.length[0],
            )
            factor = root(place.area / FOUR_PI) * sight.spread * sight.spread
            phase = turned(-wp.float64(2.0) * k * sight.back)
            four = sent_back(parts, turn_of(-sight.s, n, radar.u, radar.v), place, crossed, factor * phase)
        if wp.static(termed):
            four = with_term(four, tables, rough, k, c, material)
        return four

    return scattered_by_it


@cache
def rough_kernel(model: str, termed: bool) -> wp.Kernel:
    """`rough.rough_kernel` for faces of a model, and `termed` for those with a learned term."""
    scattered_by_it = scattered_by(model, termed)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def rough_kernel(
        # In:
        radar_in: wp.array[TubeRadar],
        wavenumber_in: wp.array[wp.float64],
        surface_in: wp.array[RoughSurface],
        variant: int,
        scatterer_in: wp.array[Scatterer],
        seen_in: wp.array2d[wp.uint8],
        tables: Lookup,
        crossed_in: wp.array[wp.vec2d],
        # Out:
        amplitude_out: wp.array4d[wp.vec2d],
    ):
        view, f, chunk = wp.tid()
        k = wavenumber_in[f]
        total = Four()
        for i in range(SCATTERERS):
            j = chunk * SCATTERERS + i
            if j < scatterer_in.shape[0]:
                if seen_in[view, j] != wp.uint8(0):
                    place = scatterer_in[j]
                    row = f * surface_in.shape[0]
                    four = scattered_by_it(radar_in[view], k, surface_in, variant, place, tables, row, crossed_in[j])
                    total = plus(total, four)
        total.vh = total.hv
        keep(view, f, chunk, total, amplitude_out)

    return rough_kernel


@cache
def rough_places_kernel(model: str, termed: bool) -> wp.Kernel:
    """`collection.rough_places_kernel` for faces of a model, and `termed` for those with a learned term."""
    scattered_by_it = scattered_by(model, termed)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def rough_places_kernel(
        # In:
        radar_in: wp.array[TubeRadar],
        k: wp.float64,
        surface_in: wp.array[RoughSurface],
        variant: int,
        scatterer_in: wp.array[Scatterer],
        seen_in: wp.array2d[wp.uint8],
        tables: Lookup,
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
