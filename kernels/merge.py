"""What lies scattered over a table or repeats in a sorted list, numbered side by side."""

import warp as wp


@wp.kernel(enable_backward=False)
def number_kernel(order_out: wp.array(dtype=int)):
    i = wp.tid()
    order_out[i] = i


@wp.kernel(enable_backward=False)
def mark_rows_kernel(rows: wp.array2d(dtype=wp.int64), start_out: wp.array(dtype=int)):
    """1 for a row that is taken, 0 for a free one."""
    i = wp.tid()
    start_out[i] = wp.where(rows[i, 0] == wp.int64(0), 0, 1)


@wp.kernel(enable_backward=False)
def mark_starts_kernel(value: wp.array(dtype=int), longest: int, whole: int, start_out: wp.array(dtype=int)):
    """1 where a stretch of one value begins, and after every `longest` elements but for those of value `whole`."""
    i = wp.tid()
    new = int(0)
    if i % longest == 0 and value[i] != whole:
        new = 1
    if i == 0:
        new = 1
    elif value[i] != value[i - 1]:
        new = 1
    start_out[i] = new


@wp.kernel(enable_backward=False)
def place_starts_kernel(
    start: wp.array(dtype=int),
    rank: wp.array(dtype=int),
    first_out: wp.array(dtype=int),
):
    """`rank` is the inclusive scan of `start`."""
    i = wp.tid()
    if start[i] == 1:
        first_out[rank[i] - 1] = i


@wp.kernel(enable_backward=False)
def key_kernel(
    rows: wp.array2d(dtype=wp.int64),
    row: wp.array(dtype=int),
    key_out: wp.array(dtype=wp.int64),
):
    i = wp.tid()
    key_out[i] = rows[row[i], 0] - wp.int64(1)
