"""sigma0 from a table over incidence, interpolated in decibels; differentiable in its level and in its values."""

import warp as wp

from warpsar.kernels.codes import Polarization
from warpsar.kernels.empirical import turned_power
from warpsar.kernels.parts import Lookup, Parts, parts_of_powers
from warpsar.kernels.scattering import sine_squared
from warpsar.kernels.shade import HitSurfaces
from warpsar.kernels.wide import read_float, read_int, read_vec4, write_vec4

LEVEL = wp.constant(0)  # the place of ln(level) among the learned coordinates


@wp.func
def linear(db: float) -> float:
    return wp.exp(db * 0.23025850929940458)  # ln 10 / 10


@wp.func
def row_below(incidence_deg: wp.array(dtype=float), rows: wp.vec2i, angle: float) -> int:
    """The row below an angle, or the first or the last but one."""
    found = rows[0]
    for row in range(rows[0] + 1, rows[0] + rows[1] - 1):
        if incidence_deg[row] <= angle:
            found = row
    return found


@wp.func
def share_above(incidence_deg: wp.array(dtype=float), row: int, angle: float) -> float:
    """How far an angle lies from a row to the next one; held at the table's ends."""
    step = incidence_deg[row + 1] - incidence_deg[row]
    return wp.clamp((angle - incidence_deg[row]) / step, 0.0, 1.0)


@wp.func
def powers_at(
    incidence_deg: wp.array(dtype=float), sigma0_db: wp.array2d(dtype=float), rows: wp.vec2i, cosine: float
) -> wp.vec3:
    """sigma0 of HH, VV and HV of level ground; `rows`: the first row of the table, and how many it has."""
    angle = wp.atan2(wp.sqrt(wp.max(sine_squared(cosine), 0.0)), cosine) * 57.29577951308232
    row = row_below(incidence_deg, rows, angle)
    above = share_above(incidence_deg, row, angle)
    hh = linear((1.0 - above) * sigma0_db[row, Polarization.HH] + above * sigma0_db[row + 1, Polarization.HH])
    vv = linear((1.0 - above) * sigma0_db[row, Polarization.VV] + above * sigma0_db[row + 1, Polarization.VV])
    hv = linear((1.0 - above) * sigma0_db[row, Polarization.HV] + above * sigma0_db[row + 1, Polarization.HV])
    return wp.vec3(hh, vv, hv)


@wp.kernel
def scatter_kernel(
    # In:
    mine: wp.array(dtype=int),
    hits: HitSurfaces,
    rows: wp.array(dtype=wp.vec2i),
    incidence_deg: wp.array(dtype=float),
    sigma0_db: wp.array2d(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """sigma0 of the hits `mine`, and with `slopes_out` not empty its slopes: to ln(level) alone."""
    i = read_int(mine, wp.tid())
    material = hits.face_material[hits.face[i]]
    cosine = hits.cos_incidence[i]
    power = powers_at(incidence_deg, sigma0_db, rows[material], cosine)
    twist = float(1.0)
    if hits.local_basis == 0:
        twist = read_float(hits.cos_twist, i)
    value, _slope = turned_power(hits.polarization, twist, power[0], power[1], power[2], 0.0, 0.0, 0.0)
    level = read_vec4(zeta, i)
    sigma = value * wp.exp(level[LEVEL])
    sigma_out[i] = sigma
    if slopes_out.shape[0] > 0:
        write_vec4(slopes_out, i, wp.vec4(sigma, 0.0, 0.0, 0.0))


@wp.func
def parts_of(
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
    power = float(wp.exp(lookup.zeta[material, LEVEL])) * powers_at(
        lookup.incidence_deg, lookup.sigma0_db, lookup.rows[material], float(cosine)
    )
    return parts_of_powers(wp.float64(power[0]), wp.float64(power[1]), wp.float64(power[2]))
