"""Faint copies of the image to both sides in azimuth."""

import warp as wp


@wp.func
def sample(image: wp.array(dtype=float), row_start: int, cols: int, col: float) -> float:
    """Linear between pixel centres; nothing outside the image."""
    c0 = int(wp.floor(col))
    t = col - wp.floor(col)
    value = float(0.0)
    if c0 >= 0 and c0 < cols:
        value += (1.0 - t) * image[row_start + c0]
    if c0 + 1 >= 0 and c0 + 1 < cols:
        value += t * image[row_start + c0 + 1]
    return value


@wp.kernel
def ghost_kernel(
    # In:
    p: wp.array(dtype=float),  # level, offset [m]
    spacing: float,
    cols: int,
    image: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    i = wp.tid()
    col = i % cols
    shift = p[1] / spacing
    left = sample(image, i - col, cols, float(col) - shift)
    right = sample(image, i - col, cols, float(col) + shift)
    image_out[i] = image[i] + p[0] * (left + right)
