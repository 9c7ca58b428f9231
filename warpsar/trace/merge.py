"""Records of rays sorted by their keys, and where stretches of one value begin in a sorted array."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpsar.kernels import merge as kernels


def sorted_rows(rows: wp.array, count: wp.array, key_bits: int) -> tuple[int, int, wp.array, wp.array]:
    """(count[0], count[1], key, row) of the rows that are taken, sorted by key.

    `rows` and `count` are those of `kernels.trace.Records`. `key` (int64) and `row` (int) have one element for each row
    taken. The sort is stable: records of one key keep their order. All numbers reach the host in one copy.
    """
    device = rows.device
    capacity = rows.shape[0]
    start, rank = (wp.empty(capacity, dtype=int, device=device) for _ in range(2))
    wp.launch(kernels.mark_rows_kernel, capacity, inputs=[rows], outputs=[start], device=device)
    wp.utils.array_scan(start, rank, inclusive=True)
    known = wp.empty(3, dtype=int, device=device)
    wp.copy(known, count, count=2)
    wp.copy(known, rank, dest_offset=2, src_offset=capacity - 1, count=1)
    lost, taken, n = (int(value) for value in known.numpy())
    if not n:
        return lost, taken, wp.empty(0, dtype=wp.int64, device=device), wp.empty(0, dtype=int, device=device)
    # twice as long as they are: the sort's room
    key, row = wp.empty(2 * n, dtype=wp.int64, device=device), wp.empty(2 * n, dtype=int, device=device)
    wp.launch(kernels.place_starts_kernel, capacity, inputs=[start, rank], outputs=[row], device=device)
    wp.launch(kernels.key_kernel, n, inputs=[rows, row], outputs=[key], device=device)
    wp.utils.radix_sort_pairs(key, row, n, 0, key_bits)
    return lost, taken, key[:n], row[:n]


def rows_by_key(rows: wp.array, n: int, key_bits: int) -> tuple[wp.array, wp.array]:
    """(key, row) of the first `n` of the CPU's `rows`, as `sorted_rows` gives them."""
    device = rows.device
    if not n:
        return wp.empty(0, dtype=wp.int64, device=device), wp.empty(0, dtype=int, device=device)
    # twice as long as they are: the sort's room
    key, row = wp.empty(2 * n, dtype=wp.int64, device=device), wp.empty(2 * n, dtype=int, device=device)
    key.numpy()[:n], row.numpy()[:n] = rows.numpy()[:n, 0], np.arange(n, dtype=np.int32)
    wp.utils.radix_sort_pairs(key, row, n, 0, key_bits)
    return key[:n], row[:n]


def starts(values: wp.array, longest: int = 2**30, whole: int = -1) -> wp.array:
    """Where stretches of one value begin in `values` (int, shape (n,)); int.

    A stretch of more than `longest` elements counts as several, unless its value is `whole`.
    """
    device = values.device
    n = values.shape[0]
    if not n:
        return wp.empty(0, dtype=int, device=device)
    start, rank = (wp.empty(n, dtype=int, device=device) for _ in range(2))
    wp.launch(kernels.mark_starts_kernel, n, inputs=[values, longest, whole], outputs=[start], device=device)
    wp.utils.array_scan(start, rank, inclusive=True)
    first = wp.empty(int(rank[n - 1 :].numpy()[0]), dtype=int, device=device)
    wp.launch(kernels.place_starts_kernel, n, inputs=[start, rank], outputs=[first], device=device)
    return first
