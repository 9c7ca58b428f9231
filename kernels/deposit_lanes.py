"""Power into images on the CPU: each thread takes many elements.

The steps are those of kernels/shade.py, kernels/binning.py and kernels/tangents.py, in the same order. An element there
takes a nanosecond, and a thread of Warp's ten.
"""

import warp as wp

from warpsar.kernels.binning import Bins
from warpsar.kernels.tangents import Deposits

EACH = 64
"""Stretches, or deposits, of one thread."""

_EACH = f"const int each = {EACH};\n"


@wp.func_native(
    _EACH
    + """
    const int shared = sample.shape[0], stretches = first.shape[0];
    const int last = wp::min((block + 1) * each, stretches);
    for (int s = block * each; s < last; ++s) {
        const int begin = first.data[s], end = s + 1 < stretches ? first.data[s + 1] : pixel.shape[0];
        float total = 0.0f;
        for (int k = begin; k < end; ++k)
            total += sigma.data[shared ? sample.data[k] : k] * weight.data[k];
        image_out.data[pixel.data[begin]] += total;
    }
"""
)
def deposit(
    block: int,
    first: wp.array(dtype=int),
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sample: wp.array(dtype=int),
    sigma: wp.array(dtype=float),
    image_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def deposit_kernel(
    # In:
    first: wp.array(dtype=int),
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sample: wp.array(dtype=int),
    sigma: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    """`shade.deposit_kernel` with one lane, and `shade.take_kernel` before it where there are samples."""
    deposit(wp.tid(), first, pixel, weight, sample, sigma, image_out)


@wp.func_native(
    """
    for (int k = 0; k < pixel.shape[0]; ++k)
        sigma_gradient_out.data[sample.data[k]] += weight.data[k] * image_gradient.data[pixel.data[k]];
"""
)
def take_back(
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sample: wp.array(dtype=int),
    image_gradient: wp.array(dtype=float),
    sigma_gradient_out: wp.array(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def deposit_adjoint_kernel(
    # In:
    pixel: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    sample: wp.array(dtype=int),
    image_gradient: wp.array(dtype=float),
    # Out:
    sigma_gradient_out: wp.array(dtype=float),
):
    """The adjoint of `deposit_kernel` where there are samples, by one thread: bins of one sample add to one sum."""
    take_back(pixel, weight, sample, image_gradient, sigma_gradient_out)


WIDEST = 240
"""Bins of a pixel row that `slide_kernel` adds up at once, and so the most bins of a pixel."""


@wp.func_native(
    f"const int widest = {WIDEST};\n"
    + """
    const int fine = bins.bins_per_pixel, at_once = widest / fine;
    const float down = -shift.data[0] * (float)fine, right = -shift.data[1] * (float)fine;
    const int from_row = row * fine + (bins.bin_rows - bins.rows * fine) / 2 + (int)wp::floor(down);
    const int from_col = (bins.bin_cols - bins.cols * fine) / 2 + (int)wp::floor(right);
    const float beyond_row = down - wp::floor(down), beyond_col = right - wp::floor(right);
    const int low = wp::max(-from_row, 0), high = wp::min(bins.bin_rows - from_row, fine + 1);
    float* image = image_out.data + row * bins.cols;
    for (int col = 0; col < bins.cols; col += at_once) {
        const int pixels = wp::min(at_once, bins.cols - col), first = from_col + col * fine;
        const int left = wp::max(-first, 0), end = wp::min(bins.bin_cols - first, pixels * fine + 1);
        float column[widest + 1] = {};  // of bins: what they hold within the row of pixels
        for (int a = low; a < high; ++a) {
            const float share = a == 0 ? 1.0f - beyond_row : a == fine ? beyond_row : 1.0f;
            const float* line = filled.data + (from_row + a) * bins.bin_cols + first;
            for (int b = left; b < end; ++b)
                column[b] += share * line[b];
        }
        for (int pixel = 0; pixel < pixels; ++pixel) {
            const float* begin = column + pixel * fine;
            float total = (1.0f - beyond_col) * begin[0];
            for (int b = 1; b < fine; ++b)
                total += begin[b];
            image[col + pixel] += total + beyond_col * begin[fine];
        }
    }
"""
)
def slide_row(
    row: int, bins: Bins, shift: wp.array(dtype=float), filled: wp.array(dtype=float), image_out: wp.array(dtype=float)
): ...


@wp.kernel(enable_backward=False)
def slide_kernel(
    # In:
    bins: Bins,
    shift: wp.array(dtype=float),
    filled: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    """`binning.slide_kernel`, for up to `WIDEST` bins in a pixel: each thread makes a row of pixels. Bins are added up
    along the columns first, as those of a row lie side by side."""
    slide_row(wp.tid(), bins, shift, filled, image_out)


@wp.func_native(
    _EACH
    + """
    const int shared = deposits.sample.shape[0], last = wp::min((block + 1) * each, deposits.bin.shape[0]);
    const int pixels = tangent_out.shape[1];
    for (int i = block * each; i < last; ++i) {
        const int s = shared ? deposits.sample.data[i] : i;
        const auto row = deposits.column.data[deposits.face_material.data[deposits.face.data[s]]];
        const auto slope = deposits.slopes.data[s];
        for (int k = 0; k < 4; ++k)
            if (row.c[k] >= 0)
                tangent_out.data[row.c[k] * pixels + deposits.bin.data[i]] += deposits.weight.data[i] * slope.c[k];
    }
"""
)
def add_slopes(block: int, deposits: Deposits, tangent_out: wp.array2d(dtype=float)): ...


@wp.kernel(enable_backward=False)
def tangent_kernel(
    # In:
    deposits: Deposits,
    # Out:
    tangent_out: wp.array2d(dtype=float),
):
    """`tangents.tangent_kernel`."""
    add_slopes(wp.tid(), deposits, tangent_out)


@wp.func_native(
    """
    const float width = 1.0f / (float)bins.bins_per_pixel;
    for (int i = 0; i < bins.bin_rows + bins.bin_cols; ++i) {
        const bool down = i < bins.bin_rows;
        const int bin = down ? i : i - bins.bin_rows, pixels = down ? bins.rows : bins.cols;
        const int beside = pixels * bins.bins_per_pixel - (down ? bins.bin_rows : bins.bin_cols);
        const float first = (float)(2 * bin + beside) * 0.5f * width + shift.data[down ? 0 : 1];
        const int pixel = (int)wp::floor(first);
        pixel_out.data[i] = pixel;
        for (int a = 0; a < 2; ++a) {
            const int at = pixel + a;
            const float begin = wp::max(first, (float)at), end = wp::min(first + width, (float)(at + 1));
            share_out.data[i].c[a] = at >= 0 && at < pixels ? wp::max(end - begin, 0.0f) / width : 0.0f;
        }
    }
"""
)
def place_bins(
    bins: Bins, shift: wp.array(dtype=float), pixel_out: wp.array(dtype=int), share_out: wp.array(dtype=wp.vec2)
): ...


@wp.kernel(enable_backward=False)
def place_kernel(
    # In:
    bins: Bins,
    shift: wp.array(dtype=float),
    # Out:
    pixel_out: wp.array(dtype=int),
    share_out: wp.array(dtype=wp.vec2),
):
    """Of all rows of bins, then of all columns: the pixel in which one begins once it has moved, and its shares in that
    pixel and the next. By one thread."""
    place_bins(bins, shift, pixel_out, share_out)


@wp.func_native(
    _EACH
    + """
    const int shared = deposits.sample.shape[0], last = wp::min((block + 1) * each, deposits.bin.shape[0]);
    const int pixels = tangent_out.shape[1];
    for (int i = block * each; i < last; ++i) {
        const int s = shared ? deposits.sample.data[i] : i;
        const auto target = deposits.column.data[deposits.face_material.data[deposits.face.data[s]]];
        const auto slope = deposits.slopes.data[s];
        const int row = deposits.bin.data[i] / bins.bin_cols;
        const int col = bins.bin_rows + deposits.bin.data[i] - row * bins.bin_cols;
        const int corner = pixel.data[row] * bins.cols + pixel.data[col];
        for (int a = 0; a < 2; ++a)
            for (int b = 0; b < 2; ++b) {
                const float part = share.data[row].c[a] * share.data[col].c[b] * deposits.weight.data[i];
                if (part > 0.0f)
                    for (int k = 0; k < 4; ++k)
                        if (target.c[k] >= 0)
                            tangent_out.data[target.c[k] * pixels + corner + a * bins.cols + b] += part * slope.c[k];
            }
    }
"""
)
def add_moved_slopes(
    block: int,
    bins: Bins,
    pixel: wp.array(dtype=int),
    share: wp.array(dtype=wp.vec2),
    deposits: Deposits,
    tangent_out: wp.array2d(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def moved_tangent_kernel(
    # In:
    bins: Bins,
    pixel: wp.array(dtype=int),
    share: wp.array(dtype=wp.vec2),
    deposits: Deposits,
    # Out:
    tangent_out: wp.array2d(dtype=float),
):
    """`tangents.moved_tangent_kernel`, by what `place_kernel` gives."""
    add_moved_slopes(wp.tid(), bins, pixel, share, deposits, tangent_out)
