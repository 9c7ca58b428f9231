"""Two spectra mixed."""

import warp as wp


@wp.kernel
def mix_kernel(
    # In:
    p: wp.array(dtype=float),  # weight
    sigma: wp.array(dtype=float),
    other: wp.array(dtype=float),
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    sigma_out[i] = sigma[i] + p[0] * (other[i] - sigma[i])
