"""The same power in every pixel."""

import warp as wp


@wp.kernel
def noise_kernel(
    # In:
    p: wp.array(dtype=float),  # level
    image: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    i = wp.tid()
    image_out[i] = image[i] + p[0]
