"""sigma0 averaged over the tilts of a large-scale roughness."""

from functools import cache

import warp as wp

from warpsar.kernels.geometry import RayGrid, Triangles, cos2_azimuth_of, cos_twist_of, look_direction
from warpsar.kernels.models.ka_spm import sigma0_and_slopes_of, sigma0_of
from warpsar.kernels.shade import HitSurfaces
from warpsar.kernels.wide import read_float, read_int

# Added to the slope variance, a tilt of 1e-4: its square root has no derivative at 0.
LEAST_VARIANCE = wp.constant(1.0e-8)


@wp.func
def side_of(p0: wp.vec3, p1: wp.vec3) -> wp.vec3:
    """A facet's first side, along which the first slope lies."""
    return wp.normalize(p1 - p0)


@wp.func
def facing_normal(side: wp.vec3, p0: wp.vec3, p2: wp.vec3, direction: wp.vec3) -> wp.vec3:
    """A facet's normal, against the direction that the wave comes in."""
    normal = wp.normalize(wp.cross(side, p2 - p0))
    if wp.dot(normal, direction) > 0.0:
        normal = -normal
    return normal


@wp.func
def tilted_by(
    normal: wp.vec3, side: wp.vec3, across: wp.vec3, deviation: float, first: float, second: float
) -> wp.vec3:
    """The normal with two slopes, in standard deviations."""
    return wp.normalize(normal + deviation * (first * side + second * across))


@cache
def tilt_kernel(slopes: bool) -> wp.Kernel:
    """The kernel of `sigma` plus the change of sigma0 by the tilts, a Gauss-Hermite quadrature over both slopes.

    With `slopes` also the derivatives to the learned coordinates, and no adjoint of its own.
    """
    function = sigma0_and_slopes_of if slopes else sigma0_of

    @wp.kernel(enable_backward=not slopes, module="unique")
    def tilt_kernel(
        # In:
        p: wp.array(dtype=float),  # slope variance per axis
        tilts: wp.array(dtype=wp.vec3),  # two slopes in standard deviations, and the weight
        look: RayGrid,
        mesh: Triangles,
        hits: HitSurfaces,
        point: wp.array(dtype=wp.vec3),
        zeta: wp.array(dtype=wp.vec4),
        plain: wp.array(dtype=float),  # sigma0 without the tilts
        sigma: wp.array(dtype=float),
        # Out:
        sigma_out: wp.array(dtype=float),
        slopes_out: wp.array(dtype=wp.vec4),
    ):
        i = wp.tid()
        f = read_int(hits.face, i)
        material = read_int(hits.face_material, f)
        kind = read_int(hits.spectrum, material)
        loss = read_float(hits.eps_im, material)
        ratio = read_float(hits.aspect, material)
        z = zeta[i]
        direction = look_direction(look, point[i])
        p0 = mesh.vertices[mesh.faces[f, 0]]
        e1 = side_of(p0, mesh.vertices[mesh.faces[f, 1]])
        normal = facing_normal(e1, p0, mesh.vertices[mesh.faces[f, 2]], direction)
        e2 = wp.cross(normal, e1)
        deviation = wp.sqrt(wp.max(p[0], 0.0) + LEAST_VARIANCE)
        mean = float(0.0)
        by_zeta = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for q in range(tilts.shape[0]):
            tilted = tilted_by(normal, e1, e2, deviation, tilts[q][0], tilts[q][1])
            cosine = -wp.dot(tilted, direction)
            # a tilt past grazing is hidden
            if cosine > 0.0:
                twist = float(1.0)
                if hits.local_basis == 0:
                    twist = cos_twist_of(tilted, direction, look.u)
                found = function(
                    hits.polarization,
                    kind,
                    hits.variant,
                    hits.wavenumber,
                    wp.min(cosine, 1.0),
                    twist,
                    cos2_azimuth_of(tilted, direction),
                    loss,
                    ratio,
                    z,
                )
                if wp.static(slopes):
                    mean += tilts[q][2] * found[0]
                    by_zeta += tilts[q][2] * wp.vec4(found[1], found[2], found[3], found[4])
                else:
                    mean += tilts[q][2] * found
        sigma_out[i] = sigma[i] + (mean - plain[i])
        if wp.static(slopes):
            slopes_out[i] = by_zeta

    return tilt_kernel


@wp.kernel(enable_backward=False)
def change_adjoint_kernel(
    # In:
    gradient: wp.array(dtype=float),
    # Out:
    plain_gradient_out: wp.array(dtype=float),
    sigma_gradient_out: wp.array(dtype=float),
):
    """The adjoint of sigma + (mean - plain) to `plain` and `sigma`."""
    i = wp.tid()
    plain_gradient_out[i] = plain_gradient_out[i] - gradient[i]
    sigma_gradient_out[i] = sigma_gradient_out[i] + gradient[i]
