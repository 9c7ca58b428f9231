"""Power into images: bins that are finer or moved, and the sum of two images."""

import warp as wp


@wp.func
def overlap(first: float, width: float, pixel: int) -> float:
    """Share of [first, first + width) that lies in [pixel, pixel + 1)."""
    low = wp.max(first, float(pixel))
    high = wp.min(first + width, float(pixel + 1))
    return wp.max(high - low, 0.0) / width


@wp.kernel
def move_kernel(
    # In:
    bin_rows: int,
    bin_cols: int,
    bins_per_pixel: int,
    rows: int,
    cols: int,
    bins: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sigma: wp.array(dtype=float),
    shift: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    """Each bin's power, spread evenly over the bin, goes to the two by two pixels it overlaps once it has moved."""
    i = wp.tid()
    width = 1.0 / float(bins_per_pixel)
    row = bins[i] // bin_cols
    col = bins[i] - row * bin_cols
    # Whole pixels apart from the rest: the difference of bin and margin is exact.
    first_row = float(2 * row - bin_rows + rows * bins_per_pixel) * 0.5 * width + shift[0]
    first_col = float(2 * col - bin_cols + cols * bins_per_pixel) * 0.5 * width + shift[1]
    power = sigma[i] * weight[i]
    r0 = int(wp.floor(first_row))
    c0 = int(wp.floor(first_col))
    for a in range(2):
        for b in range(2):
            r = r0 + a
            c = c0 + b
            if r >= 0 and r < rows and c >= 0 and c < cols:
                share = overlap(first_row, width, r) * overlap(first_col, width, c)
                if share > 0.0:
                    wp.atomic_add(image_out, r * cols + c, power * share)


@wp.kernel
def add_kernel(
    # In:
    image: wp.array(dtype=float),
    more: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    i = wp.tid()
    image_out[i] = image[i] + more[i]
