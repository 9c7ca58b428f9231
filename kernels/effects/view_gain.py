"""One factor on all the power of a view."""

import warp as wp

NEPER_PER_DB = wp.constant(0.2302585092994046)  # ln 10 / 10


@wp.kernel
def gain_kernel(
    # In:
    p: wp.array(dtype=float),  # gain [dB]
    sigma: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    sigma_out[i] = sigma[i] * wp.exp(NEPER_PER_DB * p[0])
