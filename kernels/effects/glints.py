"""Points of a body that flash."""

import warp as wp


@wp.kernel
def glint_kernel(
    # In:
    p: wp.array(dtype=float),  # strength
    rcs: wp.array(dtype=float),  # of a glint in this view [m2], as often as it has bins
    # Out:
    sigma_out: wp.array(dtype=float),
):
    i = wp.tid()
    sigma_out[i] = p[0] * rcs[i]
