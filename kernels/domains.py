"""Whether a surface lies in the domain of the model that is used for it (equations 9, 12, 19, corrected)."""

import warp as wp

from warpsar.kernels.codes import FRACTION_LIMIT, Coordinate
from warpsar.kernels.empirical import topp_moisture

# Partial sums, spread over as many cells so that CUDA atomics seldom meet.
PARTIALS = wp.constant(256)


@wp.func
def spm_valid(kh: wp.float64, kl: wp.float64) -> bool:
    """Small perturbation (19): kh < 0.3 and sqrt(2) h / l < 0.3."""
    limit = wp.float64(0.3)
    return kh < limit and wp.sqrt(wp.float64(2.0)) * kh / kl < limit


@wp.func
def ka_valid(kh: wp.float64, kl: wp.float64, cos_incidence: wp.float64) -> bool:
    """Geometric optics (9, 12): kh cos(theta) > sqrt(10) / 2, kl > 6 and l^2 > 2.76 h lambda."""
    rough = kh * cos_incidence > wp.sqrt(wp.float64(10.0)) / wp.float64(2.0)
    return rough and kl > wp.float64(6.0) and kl * kl > wp.float64(2.76 * 2.0 * wp.pi) * kh


@wp.kernel(enable_backward=False)
def area_kernel(
    # In:
    wavenumber: wp.float64,
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    cos_incidence: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    area_out: wp.array3d(dtype=wp.float64),
):
    """Per partial sum and material: lit area where SPM is in use (tau < 1) and where KA is (tau > 0), and of each what
    lies outside its domain."""
    i = wp.tid()
    z = zeta[i]
    kh = wavenumber * wp.exp(wp.float64(z[Coordinate.HEIGHT]))
    kl = wavenumber * wp.exp(wp.float64(z[Coordinate.LENGTH]))
    cell, material, area = i % PARTIALS, face_material[face[i]], wp.float64(weight[i])
    if z[Coordinate.FRACTION] < FRACTION_LIMIT:
        wp.atomic_add(area_out, cell, material, 0, area)
        if not spm_valid(kh, kl):
            wp.atomic_add(area_out, cell, material, 2, area)
    if z[Coordinate.FRACTION] > -FRACTION_LIMIT:
        wp.atomic_add(area_out, cell, material, 1, area)
        if not ka_valid(kh, kl, wp.float64(cos_incidence[i])):
            wp.atomic_add(area_out, cell, material, 3, area)


@wp.struct
class KernelDomain:
    """Where a model has been found good: incidence [deg], kh, kl, moisture [m^3/m^3] and h / l, from and up to."""

    incidence_deg: wp.vec2
    kh: wp.vec2
    kl: wp.vec2
    moisture: wp.vec2
    slope: float


@wp.func
def within(value: float, ends: wp.vec2) -> bool:
    return value >= ends[0] and value <= ends[1]


@wp.kernel(enable_backward=False)
def model_area_kernel(
    # In:
    wavenumber: float,
    domains: wp.array(dtype=KernelDomain),
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    cos_incidence: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    area_out: wp.array3d(dtype=wp.float64),
):
    """Per partial sum and material: lit area, and what of it lies outside the domain of the material's model."""
    i = wp.tid()
    z = zeta[i]
    material = face_material[face[i]]
    domain = domains[material]
    kh = wavenumber * wp.exp(z[Coordinate.HEIGHT])
    moisture, _slope = topp_moisture(1.0 + wp.exp(z[Coordinate.EPS]))
    kl = wavenumber * wp.exp(z[Coordinate.LENGTH])
    inside = within(wp.acos(cos_incidence[i]) * 57.29577951308232, domain.incidence_deg) and within(kh, domain.kh)
    steep = wp.exp(z[Coordinate.HEIGHT] - z[Coordinate.LENGTH]) > domain.slope
    wp.atomic_add(area_out, i % PARTIALS, material, 0, wp.float64(weight[i]))
    if steep or not inside or not within(kl, domain.kl) or not within(moisture, domain.moisture):
        wp.atomic_add(area_out, i % PARTIALS, material, 1, wp.float64(weight[i]))
