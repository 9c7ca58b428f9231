"""The shift of one view's bins before they are dealt to pixels."""

import warp as wp


@wp.kernel
def aim_kernel(
    # In:
    p: wp.array(dtype=float),  # range, azimuth [m]
    row_spacing: float,
    col_spacing: float,
    shift: wp.array(dtype=float),
    # Out:
    shift_out: wp.array(dtype=float),
):
    """`shift` (rows, columns) in pixels, plus the view's own."""
    shift_out[0] = shift[0] + p[0] / row_spacing
    shift_out[1] = shift[1] + p[1] / col_spacing
