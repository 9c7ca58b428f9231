"""Images made band after band."""

import warp as wp


@wp.kernel(enable_backward=False)
def add_kernel(
    # In:
    part: wp.array(dtype=float),
    # In and out:
    whole: wp.array(dtype=float),
):
    i = wp.tid()
    whole[i] = whole[i] + part[i]
