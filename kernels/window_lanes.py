"""The largest and the smallest of weighted sums over windows of images, for eight draws at once, on the CPU.

The largest and the smallest of eight draws stay in registers, where NumPy writes each step to memory.
"""

import warp as wp

LANES = 8  # draws that are worked on at once

_VECTORS = f"typedef float V __attribute__((ext_vector_type({LANES}), aligned(4)));\nconst int lanes = {LANES};\n"


@wp.struct
class Windows:
    """Centred windows of `size` (rows, columns), odd, and the `scale` of each one's sum about each pixel, (windows,
    rows, columns). `inside`, (rows, columns): 1 where an image has a value, 0 elsewhere."""

    size: wp.array(dtype=wp.vec2i)
    scale: wp.array3d(dtype=float)
    inside: wp.array2d(dtype=wp.uint8)


@wp.func_native(
    _VECTORS
    + """
    const int rows = windows.inside.shape[0], cols = windows.inside.shape[1], draws = values.shape[1], wide = cols + 1;
    const int count = windows.size.shape[0];
    V* total = (V*)total_out.data;  // over all rows and columns before
    V* column = total + (rows + 1) * wide;  // over all rows up to this one
    for (int first = 0; first < draws; first += lanes) {
        const int some = wp::min(lanes, draws - first);
        const float* next = values.data + first;
        const wp::uint8* inside = windows.inside.data;
        for (int c = 0; c < wide; ++c)
            total[c] = column[c] = V(0.0f);
        for (int r = 0; r < rows; ++r) {
            V* here = total + (r + 1) * wide;
            here[0] = V(0.0f);
            for (int c = 0; c < cols; ++c) {
                if (*inside++) {
                    V value = V(0.0f);
                    if (some == lanes)
                        value = *(const V*)next;
                    else
                        for (int k = 0; k < some; ++k)
                            value[k] = next[k];
                    column[c] += value;
                    next += draws;
                }
                here[c + 1] = here[c] + column[c];
            }
        }
        for (int w = 0; w < count; ++w) {
            const int up = windows.size.data[w].c[0] / 2, side = windows.size.data[w].c[1] / 2;
            V high = V(-3.4e38f), low = V(3.4e38f);
            const float* scale = windows.scale.data + w * rows * cols;
            for (int r = 0; r < rows; ++r) {
                const V* above = total + wp::max(r - up, 0) * wide;
                const V* below = total + wp::min(r + up + 1, rows) * wide;
                for (int c = 0; c < cols; ++c) {
                    const int left = wp::max(c - side, 0), right = wp::min(c + side + 1, cols);
                    const V sum = (below[right] - above[right]) - (below[left] - above[left]);
                    const V z = sum * V(*scale++);
                    high = __builtin_elementwise_max(high, z);
                    low = __builtin_elementwise_min(low, z);
                }
            }
            for (int k = 0; k < some; ++k) {
                high_out.data[w * draws + first + k] = high[k];
                low_out.data[w * draws + first + k] = low[k];
            }
        }
    }
"""
)
def scan(
    windows: Windows,
    values: wp.array2d(dtype=float),
    total_out: wp.array(dtype=float),
    high_out: wp.array2d(dtype=float),
    low_out: wp.array2d(dtype=float),
): ...


@wp.kernel(enable_backward=False)
def scan_kernel(
    # In:
    windows: Windows,
    values: wp.array2d(dtype=float),
    # Room:
    total: wp.array(dtype=float),
    # Out:
    high_out: wp.array2d(dtype=float),
    low_out: wp.array2d(dtype=float),
):
    """By one thread: `high_out` and `low_out`, (windows, draws), of images whose `values` inside are (pixels, draws),
    row after row. `total`: `LANES` numbers for each pixel, and for one more row and column, and another row.
    """
    scan(windows, values, total, high_out, low_out)
