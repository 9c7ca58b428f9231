"""Permittivity that changes across the scene."""

import warp as wp

from warpsar.kernels.codes import Coordinate


@wp.kernel
def slope_kernel(
    # In:
    p: wp.array(dtype=float),  # per metre east, per metre north
    point: wp.array(dtype=wp.vec3),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    zeta_out: wp.array(dtype=wp.vec4),
):
    i = wp.tid()
    z = zeta[i]
    eps = z[Coordinate.EPS] + p[0] * point[i][0] + p[1] * point[i][1]
    zeta_out[i] = wp.vec4(eps, z[Coordinate.HEIGHT], z[Coordinate.LENGTH], z[Coordinate.FRACTION])
