"""How images change with the nodes of uniform materials: slopes of the hits, added up into one image for each node."""

import warp as wp

from warpsar.kernels.binning import Bins, overlap


@wp.struct
class Deposits:
    """Power that falls into `bin`, `weight` times that of a `sample`; without samples each bin has its own.

    `slopes` of the samples to their coordinates. `column`: which rows of the tangents belong to a material's four
    coordinates, -1 for none.
    """

    sample: wp.array(dtype=int)
    bin: wp.array(dtype=int)
    weight: wp.array(dtype=float)
    face: wp.array(dtype=int)
    face_material: wp.array(dtype=int)
    column: wp.array(dtype=wp.vec4i)
    slopes: wp.array(dtype=wp.vec4)


@wp.func
def sample_of(deposits: Deposits, i: int) -> int:
    if deposits.sample.shape[0] > 0:
        return deposits.sample[i]
    return i


@wp.func
def rows_of(deposits: Deposits, sample: int) -> wp.vec4i:
    return deposits.column[deposits.face_material[deposits.face[sample]]]


@wp.kernel(enable_backward=False)
def tangent_kernel(
    # In:
    deposits: Deposits,
    # Out:
    tangent_out: wp.array2d(dtype=float),
):
    """The derivative of `deposit_kernel`."""
    i = wp.tid()
    s = sample_of(deposits, i)
    rows = rows_of(deposits, s)
    slope = deposits.slopes[s]
    for k in range(4):
        if rows[k] >= 0:
            wp.atomic_add(tangent_out, rows[k], deposits.bin[i], deposits.weight[i] * slope[k])


@wp.kernel(enable_backward=False)
def moved_tangent_kernel(
    # In:
    bins: Bins,
    shift: wp.array(dtype=float),
    deposits: Deposits,
    # Out:
    tangent_out: wp.array2d(dtype=float),
):
    """The derivative of bins that are filled and slid (`binning.slide_kernel`); the rest as in `tangent_kernel`."""
    i = wp.tid()
    s = sample_of(deposits, i)
    targets = rows_of(deposits, s)
    slope = deposits.slopes[s]
    width = 1.0 / float(bins.bins_per_pixel)
    row = deposits.bin[i] // bins.bin_cols
    col = deposits.bin[i] - row * bins.bin_cols
    first_row = float(2 * row - bins.bin_rows + bins.rows * bins.bins_per_pixel) * 0.5 * width + shift[0]
    first_col = float(2 * col - bins.bin_cols + bins.cols * bins.bins_per_pixel) * 0.5 * width + shift[1]
    r0 = int(wp.floor(first_row))
    c0 = int(wp.floor(first_col))
    for a in range(2):
        for b in range(2):
            r = r0 + a
            c = c0 + b
            if r >= 0 and r < bins.rows and c >= 0 and c < bins.cols:
                share = overlap(first_row, width, r) * overlap(first_col, width, c) * deposits.weight[i]
                if share > 0.0:
                    for k in range(4):
                        if targets[k] >= 0:
                            wp.atomic_add(tangent_out, targets[k], r * bins.cols + c, share * slope[k])
