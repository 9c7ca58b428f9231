"""sigma0 of one surface against incidence."""

from functools import cache

import warp as wp

from warpsar.kernels.codes import Variant
from warpsar.kernels.scatter import sigma0_of


@cache
def sigma0_kernel(model: str) -> wp.Kernel:
    """The kernel of sigma0 by a model, in float64."""
    value_of = sigma0_of(model)

    # Series are loops: unrolled they would take minutes to compile.
    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def sigma0_kernel(
        cos_theta: wp.array(dtype=wp.float64),
        polarization: int,
        spectrum: int,
        wavenumber: wp.float64,
        eps_im: wp.float64,
        zeta: wp.vec4d,
        # Out:
        sigma_out: wp.array(dtype=wp.float64),
    ):
        i = wp.tid()
        one = wp.float64(1.0)
        sigma_out[i] = value_of(
            polarization, spectrum, Variant.STANDARD, wavenumber, cos_theta[i], one, one, eps_im, one, zeta
        )

    return sigma0_kernel
