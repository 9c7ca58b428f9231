"""A receiver that compresses power about the median of its image."""

import warp as wp

DIGITS = wp.constant(256)


@wp.func
def digits(value: float) -> int:
    """The bits of a number that is not negative, as an integer: integers have the order of their numbers."""
    return wp.cast(wp.max(value, 0.0), wp.int32)


@wp.kernel
def count_digit_kernel(
    # In:
    turn: int,  # 0 for the highest eight bits
    lit: wp.array(dtype=int),
    image: wp.array(dtype=float),
    prefix: wp.array(dtype=int),  # higher bits of the number that is sought, by turn
    # Out:
    histogram_out: wp.array2d(dtype=int),
):
    i = wp.tid()
    if lit[i] == 1:
        bits = wp.int64(digits(image[i]))
        shift = wp.int64(24 - 8 * turn)
        if int(bits >> (shift + wp.int64(8))) == prefix[turn]:
            wp.atomic_add(histogram_out, turn, int(bits >> shift) % DIGITS, 1)


@wp.kernel
def pick_digit_kernel(
    # In:
    turn: int,
    rank: int,
    histogram: wp.array2d(dtype=int),
    # In and out, element `turn` to element `turn` + 1:
    prefix: wp.array(dtype=int),
    passed: wp.array(dtype=int),  # numbers known to be smaller
):
    """The digit of the number at `rank` (from 0) in ascending order."""
    below = passed[turn]
    digit = int(0)
    before = below
    for k in range(DIGITS):
        if below <= rank:
            digit = k
            before = below
        below += histogram[turn, k]
    prefix[turn + 1] = prefix[turn] * DIGITS + digit
    passed[turn + 1] = before


@wp.kernel
def count_equal_kernel(
    # In:
    lit: wp.array(dtype=int),
    image: wp.array(dtype=float),
    low: wp.array(dtype=int),
    high: wp.array(dtype=int),
    # Out:
    equal_out: wp.array(dtype=int),
):
    i = wp.tid()
    if lit[i] == 1:
        bits = digits(image[i])
        if bits == low[4]:
            wp.atomic_add(equal_out, 0, 1)
        if bits == high[4]:
            wp.atomic_add(equal_out, 1, 1)


@wp.kernel
def median_kernel(
    # In:
    lit: wp.array(dtype=int),
    image: wp.array(dtype=float),
    low: wp.array(dtype=int),
    high: wp.array(dtype=int),
    equal: wp.array(dtype=int),
    # Out:
    median_out: wp.array(dtype=float),
):
    """Mean of the two middle numbers; equal pixels share its derivative."""
    i = wp.tid()
    if lit[i] == 1:
        bits = digits(image[i])
        share = float(0.0)
        if bits == low[4]:
            share += 0.5 / float(equal[0])
        if bits == high[4]:
            share += 0.5 / float(equal[1])
        if share > 0.0:
            wp.atomic_add(median_out, 0, share * image[i])


@wp.kernel
def compress_kernel(
    # In:
    p: wp.array(dtype=float),  # exponent
    pivot: wp.array(dtype=float),
    image: wp.array(dtype=float),
    # Out:
    image_out: wp.array(dtype=float),
):
    i = wp.tid()
    value = image[i]
    if value > 0.0 and pivot[0] > 0.0:
        value = image[i] * wp.exp((p[0] - 1.0) * wp.log(image[i] / pivot[0]))
    image_out[i] = value
