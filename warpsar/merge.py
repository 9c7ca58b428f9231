"""Records of many rays -> hits: those of one face in one pixel differ only in their barycentrics, and are one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import warp as wp


def merge_records(
    key: wp.array, weight: wp.array, moment: wp.array, count: int, key_bits: int, face_bits: int, merge: bool
) -> tuple[wp.array, wp.array, wp.array, wp.array]:
    """(pixel, face, weight, barycentric) of the hits, sorted by pixel, then face.

    `key` holds pixel * 2^face_bits + face in its first `count` of at least 2 * `count` elements (the sort's
    room). The sort is stable, so on the CPU the sums are the same to the bit in every run. With `merge` false
    every record stays a hit of its own.
    """
    import warp as wp

    from warpsar.kernels import merge as kernels

    device: Any = key.device

    def empty(shape: int, dtype: Any) -> wp.array:
        return wp.empty(shape, dtype=dtype, device=device)

    order = empty(2 * count, int)
    wp.launch(kernels.number_kernel, count, outputs=[order], device=device)
    wp.utils.radix_sort_pairs(key, order, count, 0, key_bits)

    start, rank = empty(count, int), empty(count, int)
    wp.launch(kernels.mark_starts_kernel, count, inputs=[key, int(merge)], outputs=[start], device=device)
    wp.utils.array_scan(start, rank, inclusive=True)
    hits = int(rank[count - 1 :].numpy()[0]) if count else 0
    first = empty(hits, int)
    wp.launch(kernels.place_starts_kernel, count, inputs=[start, rank], outputs=[first], device=device)

    pixel, face = empty(hits, int), empty(hits, int)
    total, barycentric = empty(hits, float), empty(hits, wp.vec2)
    wp.launch(
        kernels.reduce_kernel,
        hits,
        inputs=[key, order, weight, moment, first, count, face_bits],
        outputs=[pixel, face, total, barycentric],
        device=device,
    )
    return pixel, face, total, barycentric
