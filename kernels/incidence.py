"""sigma0 of one surface against incidence."""

import warp as wp

from warpsar.kernels.codes import Variant
from warpsar.kernels.scattering import sigma0


@wp.kernel
def sigma0_kernel(
    cos_theta: wp.array(dtype=wp.float64),
    polarization: int,
    spectrum: int,
    wavenumber: wp.float64,
    eps_re: wp.float64,
    eps_im: wp.float64,
    rms_height: wp.float64,
    length: wp.float64,
    tau: wp.float64,
    # Out:
    sigma_out: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    one = wp.float64(1.0)
    sigma_out[i] = sigma0(
        polarization,
        spectrum,
        Variant.STANDARD,
        wavenumber,
        cos_theta[i],
        one,
        eps_re,
        eps_im,
        rms_height,
        length,
        length,
        one,
        tau,
    )
