"""Power of another transmitter in some range lines."""

import warp as wp


@wp.kernel
def lines_kernel(
    # In:
    p: wp.array(dtype=float),  # level
    line: wp.array(dtype=float),  # 1 in the rows that are hit
    cols: int,
    image: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    i = wp.tid()
    image_out[i] = image[i] + p[0] * line[i // cols]
