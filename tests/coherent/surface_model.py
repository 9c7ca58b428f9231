"""The surface model's sigma0 in float64, for the tests of rough scatterers."""

import warp as wp

from warpsar.kernels.scattering import sigma0


@wp.kernel
def sigma0_kernel(
    k: wp.float64,
    cosine: wp.float64,
    eps_re: wp.float64,
    eps_im: wp.float64,
    height: wp.float64,
    length: wp.float64,
    tau: wp.float64,
    out: wp.array[wp.float64],
):
    i = wp.tid()
    one = wp.float64(1.0)
    out[i] = sigma0(i, 0, 0, k, cosine, one, eps_re, eps_im, height, length, length, one, tau)
