"""Separable convolution with a kernel whose width is a parameter."""

import warp as wp

SINC = wp.constant(0)
TAYLOR = wp.constant(1)
GAUSSIAN = wp.constant(2)

# Full widths at half maximum of the squared transforms of windows of length 1.
SINC_WIDTH = wp.constant(0.8858929413789)
TAYLOR_WIDTH = wp.constant(1.1874775859198)

# Taylor's window for sidelobes at -35 dB, nbar = 5: 1 + 2 sum F_m cos(2 pi m t).
F1 = wp.constant(0.34434990953661)
F2 = wp.constant(-0.01519488855396)
F3 = wp.constant(0.00427830763157)
F4 = wp.constant(-0.00073455164987)

# Narrower than this share of a pixel counts as this: the kernel is 1 and 0 there to float32.
NARROWEST = wp.constant(1.0e-5)


@wp.func
def sinc(x: float) -> float:
    t = wp.pi * x
    value = 1.0 - t * t / 6.0
    if wp.abs(t) > 0.01:
        value = wp.sin(t) / t
    return value


@wp.func
def pair(x: float, m: float) -> float:
    return sinc(x - m) + sinc(x + m)


@wp.func
def power(window: int, x: float) -> float:
    """Point spread of power at `x` full widths at half maximum, 1 at 0."""
    value = float(0.0)
    if window == GAUSSIAN:
        # Beyond: 0 in float32 with its derivative, and no overflow on the way.
        if wp.abs(x) < 8.0:
            value = wp.exp(-2.772588722239781 * x * x)
    elif window == SINC:
        a = sinc(SINC_WIDTH * x)
        value = a * a
    else:
        y = TAYLOR_WIDTH * x
        b = sinc(y) + F1 * pair(y, 1.0) + F2 * pair(y, 2.0) + F3 * pair(y, 3.0) + F4 * pair(y, 4.0)
        value = b * b
    return value


@wp.kernel
def sample_kernel(
    # In:
    window: int,
    spacing: float,
    index: int,  # of the width in p
    p: wp.array(dtype=float),
    # Out:
    weight_out: wp.array(dtype=float),  # by distance in pixels
    total_out: wp.array(dtype=float),  # of both sides
):
    """The kernel at pixel centres."""
    k = wp.tid()
    width = wp.max(p[index] / spacing, NARROWEST)
    w = power(window, float(k) / width)
    weight_out[k] = w
    if k == 0:
        wp.atomic_add(total_out, 0, w)
    else:
        wp.atomic_add(total_out, 0, 2.0 * w)


@wp.kernel
def normalise_kernel(
    # In:
    weight: wp.array(dtype=float),
    total: wp.array(dtype=float),
    # Out:
    weight_out: wp.array(dtype=float),
):
    i = wp.tid()
    weight_out[i] = weight[i] / total[0]


@wp.kernel
def blur_kernel(
    # In:
    window: int,
    spacing: float,
    index: int,
    p: wp.array(dtype=float),
    weight: wp.array(dtype=float),
    image: wp.array(dtype=float),
    count: int,  # pixels along the axis
    stride: int,  # from one to the next
    # Out:
    image_out: wp.array(dtype=float),
):
    """One axis. Outside the image there is nothing; what is spread there is lost.

    The sum must stay bare: reverse mode is wrong where a dynamic loop's result meets more than a sum.
    """
    i = wp.tid()
    at = (i // stride) % count
    reach = count
    if window == GAUSSIAN:
        # exp(-4 ln 2 * 9) = 1.5e-11 is left out
        reach = wp.min(count, int(3.0 * wp.max(p[index] / spacing, 0.0)) + 1)
    value = float(0.0)
    for j in range(wp.max(0, at - reach), wp.min(count, at + reach + 1)):
        value += weight[wp.abs(j - at)] * image[i + (j - at) * stride]
    image_out[i] = value
