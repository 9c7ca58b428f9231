"""Complex amplitudes of a rough facet: independent Gaussian parts whose powers add up to a model's sigma0."""

import warp as wp


@wp.struct
class Lookup:
    """What models look up of a material. An array that no material needs is empty."""

    twice: wp.array2d[wp.vec4]  # ln of double scattering over incidence; rows: frequencies times materials
    rows: wp.array[wp.vec2i]  # of `sigma0_db`: the first row of a material, and how many it has
    incidence_deg: wp.array[float]
    sigma0_db: wp.array2d[float]
    zeta: wp.array2d[wp.float64]  # learned coordinates: materials times places
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
def parts_of_powers(hh: wp.float64, vv: wp.float64, hv: wp.float64) -> Parts:
    """HH and VV with one phase, as `empirical.turned_power` mixes them."""
    zero = wp.float64(0.0)
    found = Parts()
    found.first_hh = wp.vec2d(wp.sqrt(wp.max(hh, zero)), zero)
    found.first_vv = wp.vec2d(wp.sqrt(wp.max(vv, zero)), zero)
    found.crossed = wp.sqrt(wp.max(hv, zero))
    return found
