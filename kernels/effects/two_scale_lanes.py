"""`two_scale.tilt_kernel` on the CPU: sixteen hits at once, and the slopes of sigma0 where a gradient is asked for.

The equations are those of kernels/scattering.py and two_scale.py, written out by kernels/lanes.py. Loads, stores and
the sum over the tilts are by hand.
"""

import warp as wp

from warpsar.kernels import lanes
from warpsar.kernels.effects.two_scale import LEAST_VARIANCE, facing_normal, side_of, tilted_by
from warpsar.kernels.geometry import cos2_azimuth_of, cos_twist_of
from warpsar.kernels.shade import sigma0_and_slopes_of, sigma0_of

HITS = 16  # of a block

_UNIFORM = ("polarization", "variant", "wavenumber")
_MODEL = lanes.source(
    HITS,
    {
        side_of: (),
        facing_normal: (),
        tilted_by: ("deviation", "first", "second"),
        cos_twist_of: ("u",),
        cos2_azimuth_of: (),
        sigma0_of: _UNIFORM,
        sigma0_and_slopes_of: _UNIFORM,
    },
)

_TILT = """
    typedef Lanes::V V;
    typedef Lanes::V3 V3;
    // the block's hits side by side; beyond the last one, its copies
    const int begin = block * 16, count = wp::min(sigma_out.shape[0] - begin, 16);
    V loss, ratio;
    Lanes::I spectra;
    Lanes::V4 z;
    V3 corner[3], at;
    for (int k = 0; k < 16; ++k) {
        const int i = begin + wp::min(k, count - 1), f = face.data[i], material = face_material.data[f];
        spectra[k] = spectrum.data[material];
        loss[k] = eps_im.data[material];
        ratio[k] = aspect.data[material];
        for (int j = 0; j < 4; ++j)
            z.c[j][k] = zeta.data[i].c[j];
        for (int axis = 0; axis < 3; ++axis) {
            at.c[axis][k] = point.data[i].c[axis];
            for (int j = 0; j < 3; ++j)
                corner[j].c[axis][k] = vertices.data[faces.data[3 * f + j]].c[axis];
        }
    }
    V3 direction = V3::of(d);
    if (slant_range > 0.0f)
        direction = Lanes::normalize(
            V3::of(d) * (V(slant_range) + Lanes::dot(at, V3::of(d))) + V3::of(v) * Lanes::dot(at, V3::of(v)));
    const V3 side = Lanes::side_of(corner[0], corner[1]);
    const V3 normal = Lanes::facing_normal(side, corner[0], corner[2], direction);
    const V3 across = Lanes::cross(normal, side);
    const float deviation = wp::sqrt(wp::max(p.data[0], 0.0f) + least_variance);
    const bool sloped = slopes_out.shape[0] > 0;
    V mean[5] = {V(0.0f), V(0.0f), V(0.0f), V(0.0f), V(0.0f)};
    for (int q = 0; q < tilts.shape[0]; ++q) {
        const V3 tilted = Lanes::tilted_by(normal, side, across, deviation, tilts.data[q].c[0], tilts.data[q].c[1]);
        const V cosine = -Lanes::dot(tilted, direction);
        const Lanes::I up = cosine > 0.0f;  // a tilt past grazing is hidden
        if (!Lanes::any(up))
            continue;
        const V below = Lanes::choose(up, Lanes::min(cosine, V(1.0f)), V(1.0f)), weight = tilts.data[q].c[2];
        const V twist = local_basis ? V(1.0f) : Lanes::cos_twist_of(tilted, direction, u);
        const V azimuth = Lanes::cos2_azimuth_of(tilted, direction);
        if (sloped) {
            const Lanes::V5 found = Lanes::sigma0_and_slopes_of(
                polarization, spectra, variant, wavenumber, below, twist, azimuth, loss, ratio, z);
            for (int k = 0; k < 5; ++k)
                mean[k] += weight * Lanes::choose(up, found.c[k], V(0.0f));
        } else {
            const V found =
                Lanes::sigma0_of(polarization, spectra, variant, wavenumber, below, twist, azimuth, loss, ratio, z);
            mean[0] += weight * Lanes::choose(up, found, V(0.0f));
        }
    }
    for (int k = 0; k < count; ++k) {
        const int i = begin + k;
        sigma_out.data[i] = sigma.data[i] + (mean[0][k] - plain.data[i]);
        if (sloped)
            slopes_out.data[i] = {mean[1][k], mean[2][k], mean[3][k], mean[4][k]};
    }
"""


@wp.func_native(_MODEL + _TILT)
def tilt_block(
    block: int,
    least_variance: float,
    p: wp.array(dtype=float),
    tilts: wp.array(dtype=wp.vec3),
    polarization: int,
    variant: int,
    wavenumber: float,
    local_basis: int,
    slant_range: float,
    d: wp.vec3,
    u: wp.vec3,
    v: wp.vec3,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    point: wp.array(dtype=wp.vec3),
    face_material: wp.array(dtype=int),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    aspect: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    plain: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
): ...


@wp.kernel(enable_backward=False)
def tilt_kernel(
    # In:
    p: wp.array(dtype=float),
    tilts: wp.array(dtype=wp.vec3),
    polarization: int,
    variant: int,
    wavenumber: float,
    local_basis: int,
    slant_range: float,
    d: wp.vec3,
    u: wp.vec3,
    v: wp.vec3,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    face: wp.array(dtype=int),
    point: wp.array(dtype=wp.vec3),
    face_material: wp.array(dtype=int),
    spectrum: wp.array(dtype=int),
    eps_im: wp.array(dtype=float),
    aspect: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    plain: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
    slopes_out: wp.array(dtype=wp.vec4),
):
    """`two_scale.tilt_kernel` for HITS hits; with `slopes_out` not empty also the slopes to the learned coordinates."""
    tilt_block(
        wp.tid(),
        LEAST_VARIANCE,
        p,
        tilts,
        polarization,
        variant,
        wavenumber,
        local_basis,
        slant_range,
        d,
        u,
        v,
        vertices,
        faces,
        face,
        point,
        face_material,
        spectrum,
        eps_im,
        aspect,
        zeta,
        plain,
        sigma,
        sigma_out,
        slopes_out,
    )


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
