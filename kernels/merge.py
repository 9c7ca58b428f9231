"""Records of one (pixel, face), sorted side by side, become one hit."""

import warp as wp


@wp.kernel(enable_backward=False)
def number_kernel(order_out: wp.array(dtype=int)):
    i = wp.tid()
    order_out[i] = i


@wp.kernel(enable_backward=False)
def mark_starts_kernel(
    key: wp.array(dtype=wp.int64),
    merge: int,
    start_out: wp.array(dtype=int),
):
    """1 where a new (pixel, face) begins."""
    i = wp.tid()
    new = int(1)
    if i > 0 and merge != 0:
        if key[i] == key[i - 1]:
            new = 0
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
def reduce_kernel(
    # In:
    key: wp.array(dtype=wp.int64),
    order: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    moment: wp.array(dtype=wp.vec2),
    first: wp.array(dtype=int),
    total: int,
    face_bits: int,
    # Out:
    pixel_out: wp.array(dtype=int),
    face_out: wp.array(dtype=int),
    weight_out: wp.array(dtype=float),
    barycentric_out: wp.array(dtype=wp.vec2),
):
    """Weights summed, barycentrics averaged with them."""
    i = wp.tid()
    begin = first[i]
    end = total
    if i + 1 < first.shape[0]:
        end = first[i + 1]
    sum_weight = float(0.0)
    sum_moment = wp.vec2(0.0, 0.0)
    for k in range(begin, end):
        sum_weight += weight[order[k]]
        sum_moment += moment[order[k]]
    pixel_out[i] = int(key[begin] >> wp.int64(face_bits))
    face_out[i] = int(key[begin] & ((wp.int64(1) << wp.int64(face_bits)) - wp.int64(1)))
    weight_out[i] = sum_weight
    barycentric_out[i] = sum_moment / sum_weight
