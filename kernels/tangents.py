"""How images change with the nodes of uniform materials: slopes of the hits, added up into one image for each node."""

import warp as wp

from warpsar.kernels.binning import overlap


@wp.kernel(enable_backward=False)
def tangent_kernel(
    # In:
    sample: wp.array(dtype=int),
    bins: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    column: wp.array(dtype=wp.vec4i),
    slopes: wp.array(dtype=wp.vec4),
    # Out:
    tangent_out: wp.array2d(dtype=float),
):
    """The derivative of `deposit_kernel`. `sample` has length 0 where each bin takes its own sample.

    `column`: which rows of `tangent_out` belong to a material's four coordinates, -1 for none.
    """
    i = wp.tid()
    s = i
    if sample.shape[0] > 0:
        s = sample[i]
    rows = column[face_material[face[s]]]
    slope = slopes[s]
    for k in range(4):
        if rows[k] >= 0:
            wp.atomic_add(tangent_out, rows[k], bins[i], weight[i] * slope[k])


@wp.kernel(enable_backward=False)
def moved_tangent_kernel(
    # In:
    bin_rows: int,
    bin_cols: int,
    bins_per_pixel: int,
    rows: int,
    cols: int,
    shift: wp.array(dtype=float),
    sample: wp.array(dtype=int),
    bins: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    face: wp.array(dtype=int),
    face_material: wp.array(dtype=int),
    column: wp.array(dtype=wp.vec4i),
    slopes: wp.array(dtype=wp.vec4),
    # Out:
    tangent_out: wp.array2d(dtype=float),
):
    """The derivative of bins that are filled and slid (`binning.slide_kernel`); the rest as in `tangent_kernel`."""
    i = wp.tid()
    s = i
    if sample.shape[0] > 0:
        s = sample[i]
    targets = column[face_material[face[s]]]
    slope = slopes[s]
    width = 1.0 / float(bins_per_pixel)
    row = bins[i] // bin_cols
    col = bins[i] - row * bin_cols
    first_row = float(2 * row - bin_rows + rows * bins_per_pixel) * 0.5 * width + shift[0]
    first_col = float(2 * col - bin_cols + cols * bins_per_pixel) * 0.5 * width + shift[1]
    r0 = int(wp.floor(first_row))
    c0 = int(wp.floor(first_col))
    for a in range(2):
        for b in range(2):
            r = r0 + a
            c = c0 + b
            if r >= 0 and r < rows and c >= 0 and c < cols:
                share = overlap(first_row, width, r) * overlap(first_col, width, c) * weight[i]
                if share > 0.0:
                    for k in range(4):
                        if targets[k] >= 0:
                            wp.atomic_add(tangent_out, targets[k], r * cols + c, share * slope[k])
