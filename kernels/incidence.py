"""sigma0 of one surface against incidence."""

import warp as wp

from warpsar.kernels.codes import Model, Variant
from warpsar.kernels.models import modelled
from warpsar.kernels.scattering import sigma0

# The series of a model are loops: unrolled they would take minutes to compile.
wp.set_module_options({"max_unroll": 1})


@wp.kernel(enable_backward=False)
def sigma0_kernel(
    cos_theta: wp.array(dtype=wp.float64),
    model: int,
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
    c = cos_theta[i]
    one = wp.float64(1.0)
    if model == Model.KA_SPM:
        sigma_out[i] = sigma0(
            polarization,
            spectrum,
            Variant.STANDARD,
            wavenumber,
            c,
            one,
            eps_re,
            eps_im,
            rms_height,
            length,
            length,
            one,
            tau,
        )
    else:
        found = modelled(model, polarization, spectrum, wavenumber, c, one, eps_re, eps_im, rms_height, length)
        sigma_out[i] = found[0]
