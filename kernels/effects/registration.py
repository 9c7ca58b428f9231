"""The shift of a view's bins before they are dealt to pixels."""

import warp as wp


@wp.kernel
def shift_kernel(
    # In:
    p: wp.array(dtype=float),  # range, azimuth, east, north, up [m]
    d: wp.vec3,
    u: wp.vec3,
    row_spacing: float,
    col_spacing: float,
    shift: wp.array(dtype=float),
    # Out:
    shift_out: wp.array(dtype=float),
):
    """`shift` (rows, columns) in pixels, plus the view's own range and azimuth, and the world's seen along d and u."""
    world = wp.vec3(p[2], p[3], p[4])
    shift_out[0] = shift[0] + (p[0] + wp.dot(d, world)) / row_spacing
    shift_out[1] = shift[1] + (p[1] + wp.dot(u, world)) / col_spacing
