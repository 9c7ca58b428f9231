"""The learned term on sigma0: sigma0 = physics x exp(g), g a network of radial units (world/scattering_term.py)."""

import warp as wp

from warpsar.kernels.codes import Coordinate
from warpsar.kernels.shade import HitSurfaces


@wp.func
def term_at(
    polarization: int,
    at: wp.vec4,
    scale: wp.vec4,
    units: wp.vec2i,
    places: wp.array(dtype=wp.vec4),
    weights: wp.array2d(dtype=float),
) -> float:
    """g. A function of its own: in a kernel Warp's adjoint would not know a loop's sum after the loop."""
    g = float(0.0)
    for j in range(units[0], units[0] + units[1]):
        apart = wp.cw_mul(at - places[j], scale)
        g += weights[j, polarization] * wp.exp(-0.5 * wp.dot(apart, apart))
    return g


@wp.kernel
def term_kernel(
    # In:
    hits: HitSurfaces,
    log_wavenumber: float,
    first: wp.array(dtype=wp.vec2i),  # of a material: its first unit, and how many it has
    inverse_width: wp.array(dtype=wp.vec4),
    places: wp.array(dtype=wp.vec4),
    weights: wp.array2d(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    """Differentiable in the coordinates, in sigma0 and in the weights."""
    i = wp.tid()
    material = hits.face_material[hits.face[i]]
    z = zeta[i]
    at = wp.vec4(
        hits.cos_incidence[i],
        z[Coordinate.HEIGHT] + log_wavenumber,
        z[Coordinate.LENGTH] + log_wavenumber,
        z[Coordinate.EPS],
    )
    g = term_at(hits.polarization, at, inverse_width[material], first[material], places, weights)
    sigma_out[i] = sigma[i] * wp.exp(g)
