"""Power into images: bins that are finer or moved, and the sum of two images."""

import warp as wp


@wp.struct
class Bins:
    """Bins finer than pixels, which reach as far beyond the pixels on either side."""

    bin_rows: int
    bin_cols: int
    bins_per_pixel: int
    rows: int
    cols: int


@wp.func
def overlap(first: float, width: float, pixel: int) -> float:
    """Share of [first, first + width) that lies in [pixel, pixel + 1)."""
    low = wp.max(first, float(pixel))
    high = wp.min(first + width, float(pixel + 1))
    return wp.max(high - low, 0.0) / width


_BINS_OF_PIXEL = """
    const int bin_rows = bins.bin_rows, bin_cols = bins.bin_cols, bins_per_pixel = bins.bins_per_pixel;
    // rows and columns of bins that the pixel overlaps: whole ones but the first and the last
    const int low = wp::max(-first_row, 0), high = wp::min(bin_rows - first_row, bins_per_pixel + 1);
    const int left = wp::max(-first_col, 0), right = wp::min(bin_cols - first_col, bins_per_pixel + 1);
    const auto share = [&](int place, float beyond) {
        return place == 0 ? 1.0f - beyond : place == bins_per_pixel ? beyond : 1.0f;
    };
    const auto slope = [&](int place) {
        return place == 0 ? -1.0f : place == bins_per_pixel ? 1.0f : 0.0f;
    };
    (void)slope;
"""


@wp.func_native(
    _BINS_OF_PIXEL
    + """
    float total = 0.0f;
    for (int a = low; a < high; ++a) {
        const float* line = filled.data + (first_row + a) * bin_cols + first_col;
        float across = 0.0f;
        for (int b = left; b < right; ++b)
            across += share(b, beyond_col) * line[b];
        total += share(a, beyond_row) * across;
    }
    return total;
""",
    adj_snippet=_BINS_OF_PIXEL
    + """
    for (int a = low; a < high; ++a) {
        const int line = (first_row + a) * bin_cols + first_col;
        float across = 0.0f, along = 0.0f;
        for (int b = left; b < right; ++b) {
            const float value = filled.data[line + b];
            across += share(b, beyond_col) * value;
            along += slope(b) * value;
            wp::atomic_add(&wp::index(adj_filled, line + b), adj_ret * share(a, beyond_row) * share(b, beyond_col));
        }
        adj_beyond_row += adj_ret * slope(a) * across;
        adj_beyond_col += adj_ret * share(a, beyond_row) * along;
    }
""",
)
def power_of_pixel(  # type: ignore[empty-body]
    bins: Bins,
    filled: wp.array(dtype=float),
    first_row: int,
    first_col: int,
    beyond_row: float,
    beyond_col: float,
) -> float:
    """Power of the bins that a pixel overlaps; it begins `beyond` bins after the start of the first of them."""


@wp.kernel
def slide_kernel(
    # In:
    bins: Bins,
    shift: wp.array(dtype=float),
    filled: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    """Bins that have moved by `shift` pixels, into the pixels that they overlap. Power is spread evenly over a bin."""
    row, col = wp.tid()
    # Where a pixel begins among the bins: whole bins apart from the rest, which is the same for all pixels.
    down = -shift[0] * float(bins.bins_per_pixel)
    right = -shift[1] * float(bins.bins_per_pixel)
    value = power_of_pixel(
        bins,
        filled,
        row * bins.bins_per_pixel + (bins.bin_rows - bins.rows * bins.bins_per_pixel) // 2 + int(wp.floor(down)),
        col * bins.bins_per_pixel + (bins.bin_cols - bins.cols * bins.bins_per_pixel) // 2 + int(wp.floor(right)),
        down - wp.floor(down),
        right - wp.floor(right),
    )
    wp.atomic_add(image_out, row * bins.cols + col, value)


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
